"""The approach to the spark gap from above, and the bottom of a hole, touched and judged by where it should be.

That is where the tool has just sparked, or how deep the hole should be. A bottom at or above that is impossible, and
one that is shorter than the working gap allows has something on it. The tool is lifted high so that oil washes it
away, and touches again; what stays in doubt widens the interval.
"""

from __future__ import annotations

import math

from edmctl.actuator.inverse import ramp_by
from edmctl.dataclasses import dataclass, replace
from edmctl.machine.interface import MachineEvent
from edmctl.planning.removal import approach_speed_um_s
from edmctl.procedures.run import JobRun, rest_and_look
from edmctl.procedures.settings import first_sparks_v
from edmctl.procedures.stages import move_to, retract
from edmctl.procedures.touch.reading import SurfaceReading, take_reading
from edmctl.process.touches import TOUCH_CHECK_SD_UM, Deviation, against_sparks, between, is_long, is_short
from edmctl.profile.places import Place
from edmctl.quantity import half_width
from edmctl.record.rows import EventLevel, RejectedTouch, RunEvent
from edmctl.results.measurements import SurfaceFound
from edmctl.results.progress import Phase

ABOVE_BOTTOM_UM = 15.0
"""A later cut is approached fast to this far above where the last bottom can be, then at the approach speed."""
UNKNOWN_SDS = 4.0
"""Where a surface can be, in standard uncertainties of its height: beyond this once in 16 000 ramps."""
BEYOND_BOTTOM_UM = 15.0
"""No spark this far beyond the last bottom is a fault."""
SURFACE_U_UM = 3.5
"""Standard uncertainty of the gap at 0 V before it is touched."""
_STEEPEST = 1.35
"""Steepest local slope of the actuator over its mean gain, with a margin; so a step never overshoots."""
_SHORT_SHARE = 0.03
"""A step by the actuator model ends short by this share: three times its error, so that it does not overshoot."""
_NEAR_UM = 3.0
_SHORT_UM = 1.5
"""And by this at least: after a long ramp the actuator creeps on by a micrometre."""
_STEPS = 20
_SETTLE_S = 0.2
CLEAR_OF_BOTTOM_UM = 60.0
"""Before the bottom is touched the tool rises by this: clear of 20 µm for the contact check."""
MORE_LOOKS = 2
"""A bottom in doubt is touched so many times more."""
WASHING_STROKES = 3
"""Before each of them the tool is drawn out so many times: what is loose goes with the oil."""


def approach_bottom(run: JobRun, bottom_um: float, bottom_u_um: float) -> MachineEvent:
    """Feed from 0 V to the first sparks at a bottom whose height is known within a standard uncertainty.

    The ramp ends above where the bottom can be, and the search goes on to below that. The first sparks are returned.
    """
    run.begin(Phase.APPROACHING)
    unknown_um = UNKNOWN_SDS * bottom_u_um
    lower_to(run, bottom_um - ABOVE_BOTTOM_UM - unknown_um)
    return _approach(run, bottom_um - run.watch.displacement_um + BEYOND_BOTTOM_UM + unknown_um)


def find_gap(run: JobRun, place: Place) -> SurfaceFound:
    """Go to a place and feed at the approach speed until sparks flow; the tool is held there."""
    move_to(run, place)
    begin_s = run.machine.time_s
    event = _approach(run, run.profile.approach.max_travel_um)
    model_um = run.watch.model_at(event.time_s)
    return SurfaceFound(
        kind="spark gap",
        x_um=place.x_um,
        y_um=place.y_um,
        displacement_um=event.displacement_um,
        model_um=model_um,
        actuator_v=event.actuator_v,
        travel_s=event.time_s - begin_s,
    )


def find_contact(run: JobRun, place: Place) -> SurfaceFound:
    """Go to a place and touch its surface, which is expected at `approach.offset_um` from home."""
    move_to(run, place)
    begin_s = run.machine.time_s
    expected_um = run.tally.home_um + run.profile.approach.offset_um
    found = take_reading(run, "Zr", place.name, expected_um, SURFACE_U_UM)
    return SurfaceFound(
        kind="contact",
        x_um=place.x_um,
        y_um=place.y_um,
        displacement_um=found.z_um,
        model_um=found.model_um,
        actuator_v=found.actuator_v,
        travel_s=found.time_s - begin_s,
        touches=found.reading.touches,
        sd_um=found.reading.sd_um,
    )


def lower_to(run: JobRun, target_um: float) -> None:
    """Ramp towards a displacement, until just above it, in steps that do not overshoot."""
    for _ in range(_STEPS):
        rest_and_look(run, _SETTLE_S)
        left_um = target_um - run.watch.displacement_um
        if left_um <= _NEAR_UM:
            return
        _ramp_by(run, left_um - max(_SHORT_UM, _SHORT_SHARE * left_um), left_um / _STEEPEST)


def raise_by(run: JobRun, distance_um: float) -> None:
    """Ramp up by `distance_um`; without an actuator model by less, as it moves less per volt on the way back."""
    _ramp_by(run, -distance_um, -distance_um)


def _ramp_by(run: JobRun, modelled_um: float, linear_um: float) -> None:
    """Ramp by a distance: by the actuator model's exact inverse, or by the mean gain beyond or without it."""
    actuator, estimator = run.setup.actuator, run.watch.estimator()
    slew_v_s = actuator.conditioning_slew_v_s
    target_v = math.inf if estimator is None else ramp_by(estimator, modelled_um, slew_v_s)
    if estimator is None or target_v >= estimator.model.high_v:
        target_v = run.watch.actuator_v + linear_um / actuator.gain_um_per_v
    run.machine.ramp(min(max(target_v, 0.0), run.profile.limits.stroke_v_max), slew_v_s)


def _approach(run: JobRun, max_travel_um: float) -> MachineEvent:
    run.begin(Phase.APPROACHING)
    speed_um_s = approach_speed_um_s(run.profile)
    event = run.machine.approach(speed_um_s, max_travel_um, first_sparks_v(run.profile))
    run.decide(
        RunEvent.APPROACHED,
        f"Spark gap found at {event.displacement_um:.1f} µm, {event.actuator_v:.1f} V.",
        {"displacement_um": event.displacement_um, "actuator_v": event.actuator_v},
    )
    return event


@dataclass(frozen=True, slots=True)
class ExpectedBottom:
    """Where a bottom is: `way_um`, known within `u_um`, below what it cannot be above, at `above_um`.

    `source` names what says so.
    """

    above_um: float
    way_um: float
    u_um: float
    source: str

    @property
    def z_um(self) -> float:
        """Where the tool is expected to touch it."""
        return self.above_um + self.way_um


def read_expected(run: JobRun, place: str, expected: ExpectedBottom) -> SurfaceReading:
    """Touch a bottom below the tool, more often where it is not where it should be; doubts that stay widen it."""
    above_um, way_um, u_um = expected.above_um, expected.way_um, expected.u_um
    z2 = take_reading(run, "Z2", place, expected.z_um, u_um)
    for look in range(MORE_LOOKS + 1):
        off = against_sparks(z2.z_um, above_um, way_um, u_um)
        short = is_short(off, way_um)
        if not short and (look > 0 or not is_long(off)):
            return z2
        if look == MORE_LOOKS:
            break
        _report_doubt(run, z2, off, expected.source, "It is touched again.")
        wash(run, above_um)
        again = take_reading(run, "Z2", place, expected.z_um, u_um)
        # Nothing under the tool makes a reading longer; of two within their noise the newer one is told.
        used, other = (z2, again) if z2.z_um > again.z_um + TOUCH_CHECK_SD_UM else (again, z2)
        run.recorder.append(RejectedTouch(other.time_s))
        z2 = used
    middle_um, doubt_u_um = between(z2.z_um, above_um, way_um, u_um)
    message = f"It is taken to be at {middle_um:.2f} ± {half_width(doubt_u_um):.2f} µm."
    _report_doubt(run, z2, off, expected.source, message)
    return replace(z2.shifted(middle_um - z2.z_um), doubt_u_um=doubt_u_um)


def wash(run: JobRun, bottom_um: float) -> None:
    """Draw the tool out of the hole and bring it back above the bottom, again and again."""
    for _ in range(WASHING_STROKES):
        retract(run)
        lower_to(run, bottom_um - CLEAR_OF_BOTTOM_UM)


def _report_doubt(run: JobRun, z2: SurfaceReading, off: Deviation, source: str, what_now: str) -> None:
    way = f"{abs(off.um):.2f} ± {half_width(off.u_um):.2f} µm {'short of' if off.um < 0.0 else 'beyond'}"
    chip = " (a chip?)" if off.um < 0.0 else ""
    run.decide(
        RunEvent.TOUCH_DOUBTED,
        f"Z2 = {z2.z_um:.2f} µm is {way} where {source} put the bottom{chip}. {what_now}",
        {"kind": "Z2", "off_um": off.um, "u_um": off.u_um, "z_um": z2.z_um},
        level=EventLevel.WARNING,
    )
