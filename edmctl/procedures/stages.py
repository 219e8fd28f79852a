"""Stage moves: only with the tool retracted, and always arriving from the same side."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.errors import PreconditionError
from edmctl.machine.port import Axis
from edmctl.procedures.codes import RunEvent
from edmctl.procedures.resting import rest_and_look
from edmctl.procedures.results import Phase
from edmctl.procedures.settings import controller_settings

if TYPE_CHECKING:
    from edmctl.procedures.job import Site
    from edmctl.procedures.run import Run

ARRIVAL_RUN_UM = 50.0
"""A move that would arrive against the positive direction goes this far beyond and comes back, so that the
play of the drive always lies on the same side."""

ROTARY_REPEATABILITY_DEG = 0.1
"""Of the rotary table (Muralidhara et al. 2009, §3.1): a smaller turn is no turn."""

_SETTLE_S = 0.2
_CREEP_WAIT_S = 60.0
"""Longest wait for the actuator to creep back below the height at which the stages may move."""
_CREEP_LOOK_S = 1.0
_READING_MARGIN_UM = 1.0
"""The controller judges by a reading of its own, so the height must be clear by more than noise."""


def retract(run: Run) -> None:
    """Ramp to 0 V, and wait while creep still holds the tool lower than the stages may move at."""
    run.begin(Phase.RETRACTING)
    settings = controller_settings(run.profile, run.setup)
    run.machine.ramp(0.0, settings.retract_v_s)
    rest_and_look(run, _SETTLE_S)
    end_s = run.machine.time_s + _CREEP_WAIT_S
    while run.watch.displacement_um > settings.safe_z_um - _READING_MARGIN_UM:
        if run.machine.time_s > end_s:
            raise PreconditionError(
                f"The tool stands at {run.watch.displacement_um:.1f} µm at 0 V; the stages may move below "
                f"{settings.safe_z_um:.1f} µm only.",
                hint="Check the zero of the displacement sensor and the actuator's supply.",
                code="E8020",
            )
        rest_and_look(run, _CREEP_LOOK_S)


def move_to(run: Run, place: Site) -> None:
    """Retract, then move X and Y to a place; the estimate of the displacement counts from the rest there."""
    retract(run)
    run.begin(Phase.MOVING)
    status = run.machine.status()
    speed_um_s = run.setup.stage.speed_um_s
    for axis, here_um, target_um in ((Axis.X, status.x_um, place.x_um), (Axis.Y, status.y_um, place.y_um)):
        if abs(target_um - here_um) <= run.setup.stage.repeatability_um:
            continue
        if target_um < here_um:
            run.machine.move_stage(axis, target_um - ARRIVAL_RUN_UM, speed_um_s)
        run.machine.move_stage(axis, target_um, speed_um_s)
    if abs(place.theta_deg - status.theta_deg) > ROTARY_REPEATABILITY_DEG:
        run.machine.move_stage(Axis.THETA, place.theta_deg, run.setup.stage.rotary_deg_s)
    message = f"At {place.name} ({place.x_um:.0f}, {place.y_um:.0f}) µm."
    run.decide(RunEvent.STAGE_MOVED, message, {"x_um": place.x_um, "y_um": place.y_um})
    run.watch.rest()
