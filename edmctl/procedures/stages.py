"""Stage moves: only with the tool retracted, and always arriving from the same side."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from edmctl.errors import PreconditionError
from edmctl.machine.port import Axis
from edmctl.procedures.codes import RunEvent
from edmctl.procedures.drift import DRIFT_SDS, first_home_um
from edmctl.procedures.measuring import displacement_uncertainty
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
_WORTH_TELLING_UM = 1.0
"""A home nearer than this to the sensor's zero need not be told to the controller."""
_SETTLED_UM = 0.2
"""A rest that falls by less than this in a second has settled."""
MODEL_ERROR_UM = 12.0
"""The actuator model is wrong by up to 6 µm in the first second at 0 V after a deep cut; twice that."""


def retract(run: Run) -> None:
    """Ramp to 0 V, and wait while creep still holds the tool lower than the stages may move at.

    What counts is the height over home, where the tool rests without creep: the sensor's own zero drifts.
    """
    run.begin(Phase.RETRACTING)
    settings = controller_settings(run.profile, run.setup)
    run.machine.ramp(0.0, settings.retract_v_s)
    rest_and_look(run, _SETTLE_S)
    end_s = run.machine.time_s + _CREEP_WAIT_S
    while True:
        home_um = _home_um(run)
        over_um = run.watch.displacement_um - home_um
        if over_um <= settings.safe_z_um - _READING_MARGIN_UM:
            break
        if run.machine.time_s > end_s:
            raise PreconditionError(
                f"The tool stands {over_um:.1f} µm from home at 0 V; the stages may move below "
                f"{settings.safe_z_um:.1f} µm only.",
                hint="Check the displacement sensor and the actuator's supply.",
                code="E8020",
            )
        rest_and_look(run, _CREEP_LOOK_S)
    run.ledger.home_um = home_um
    if abs(home_um) > _WORTH_TELLING_UM:
        run.machine.set_zero(home_um)


def _home_um(run: Run) -> float:
    """What the sensor shows of a tool at home: the rest at 0 V less what the actuator model says of creep.

    Before there is a model it is the rest itself, once that has stopped falling, as far as drift can explain it.
    Raises PreconditionError E8020 where a rest lies further from the first or the newest than creep and drift go:
    then the tool is held by something else.
    """
    if not run.setup.sensor.fitted:
        return 0.0
    zero_um, rests = run.watch.zero_um(), run.watch.rests
    drift_u_um_per_s = displacement_uncertainty(run.job).drift_u_um_per_s
    if math.isnan(zero_um):
        job, up_s = run.job, run.machine.uptime_s
        age_s = up_s if math.isnan(job.home_age_s) else job.home_age_s
        rests.first_um = first_home_um(_settled_um(run), job.home_um, drift_u_um_per_s, age_s)
        return rests.first_um
    for before_s, before_um in rests.ends():
        most_um = MODEL_ERROR_UM + DRIFT_SDS * drift_u_um_per_s * (run.machine.time_s - before_s)
        if abs(zero_um - before_um) > most_um:
            raise PreconditionError(
                f"The rest at 0 V has moved by {abs(zero_um - before_um):.1f} µm in "
                f"{run.machine.time_s - before_s:.0f} s; creep and drift account for {most_um:.1f} µm.",
                hint="Check the displacement sensor, the actuator's supply, and whether something holds the tool.",
                code="E8020",
            )
    return rests.home_um(zero_um)


def _settled_um(run: Run) -> float:
    """The rest at 0 V, after a wait for what creeps there."""
    end_s, before_um = run.machine.time_s + _CREEP_WAIT_S, math.inf
    while before_um - run.watch.displacement_um > _SETTLED_UM and run.machine.time_s < end_s:
        before_um = run.watch.displacement_um
        rest_and_look(run, _CREEP_LOOK_S)
    return run.watch.displacement_um


def move_to(run: Run, place: Site) -> None:
    """Retract, then move X and Y to a place; the estimate of the displacement counts from the rest there.

    Raises PreconditionError E8021 where the tool touches something although it is retracted.
    """
    retract(run)
    if run.watch.in_contact:
        raise PreconditionError(
            f"The contact sensor reads closed at {run.watch.displacement_um:.1f} µm with the tool retracted; "
            "no stage was moved.",
            hint="Look whether the tool stands on something, and for a shorted continuity wire.",
            code="E8021",
        )
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
    message = f"At {place.name} ({round(place.x_um)}, {round(place.y_um)}) µm."
    run.decide(RunEvent.STAGE_MOVED, message, {"x_um": place.x_um, "y_um": place.y_um})
    run.watch.rest()
