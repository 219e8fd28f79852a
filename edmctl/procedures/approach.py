"""From above to the spark gap."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from edmctl.actuator.moves import ramp_by
from edmctl.procedures.codes import RunEvent
from edmctl.procedures.results import Phase
from edmctl.procedures.settings import first_sparks_v

if TYPE_CHECKING:
    from edmctl.procedures.run import Run

ABOVE_BOTTOM_UM = 15.0
"""A later cut is approached fast to this far above the last bottom, then at the approach speed."""
BEYOND_BOTTOM_UM = 15.0
"""No spark this far beyond the last bottom is a fault."""
_STEEPEST = 1.35
"""Steepest local slope of the actuator over its mean gain, with a margin; so a step never overshoots."""
_SHORT_SHARE = 0.03
"""A step by the actuator model ends short by this share: three times its error, so that it does not overshoot."""
_NEAR_UM = 3.0
_SHORT_UM = 1.0
_STEPS = 20
_SETTLE_S = 0.2


def approach_surface(run: Run) -> None:
    """Feed from 0 V to the first sparks at the surface (Muralidhara et al. 2009, §3.2)."""
    _approach(run, run.profile.approach.max_travel_um)


def approach_bottom(run: Run, bottom_um: float) -> None:
    """Feed from 0 V to the first sparks at a bottom of known height."""
    run.begin(Phase.APPROACHING)
    lower_to(run, bottom_um - ABOVE_BOTTOM_UM)
    _approach(run, bottom_um - run.watch.displacement_um + BEYOND_BOTTOM_UM)


def lower_to(run: Run, target_um: float) -> None:
    """Ramp towards a displacement, until just above it, in steps that do not overshoot."""
    for _ in range(_STEPS):
        run.machine.rest(_SETTLE_S)
        left_um = target_um - run.watch.displacement_um
        if left_um <= _NEAR_UM:
            return
        _ramp_by(run, left_um - max(_SHORT_UM, _SHORT_SHARE * left_um), left_um / _STEEPEST)


def raise_by(run: Run, distance_um: float) -> None:
    """Ramp up by `distance_um`; without an actuator model by less, as it moves less per volt on the way back."""
    _ramp_by(run, -distance_um, -distance_um)


def _ramp_by(run: Run, modelled_um: float, linear_um: float) -> None:
    """Ramp by a distance: by the actuator model's exact inverse, or by the mean gain beyond or without it."""
    actuator, estimator = run.setup.actuator, run.watch.estimator()
    slew_v_s = actuator.conditioning_slew_v_s
    goal_v = math.inf if estimator is None else ramp_by(estimator, modelled_um, slew_v_s)
    if estimator is None or goal_v >= estimator.model.high_v:
        goal_v = run.watch.actuator_v + linear_um / actuator.gain_um_per_v
    run.machine.ramp(min(max(goal_v, 0.0), run.profile.limits.stroke_v_max), slew_v_s)


def _approach(run: Run, max_travel_um: float) -> None:
    run.begin(Phase.APPROACHING)
    event = run.machine.approach(run.profile.approach.speed_um_s, max_travel_um, first_sparks_v(run.profile))
    run.decide(
        RunEvent.APPROACHED,
        f"Spark gap found at {event.displacement_um:.1f} µm, {event.actuator_v:.1f} V.",
        {"displacement_um": event.displacement_um, "actuator_v": event.actuator_v},
    )
