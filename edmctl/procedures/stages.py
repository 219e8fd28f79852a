"""Stage moves: only with the tool retracted, and always arriving from the same side."""

from __future__ import annotations

import math

from edmctl.errors import PreconditionError, stages_by_hand
from edmctl.labels import PAD, PARKING
from edmctl.machine.interface import Axis
from edmctl.procedures.job import REPORT_DELAY_S
from edmctl.procedures.run import JobRun, rest_and_look
from edmctl.procedures.settings import controller_settings, retract_v_s
from edmctl.procedures.touch.home import (
    CLEAR_UM,
    CREEP_LOOK_S,
    CREEP_WAIT_S,
    READING_MARGIN_UM,
    Home,
    home_now,
    most_over_um,
)
from edmctl.profile.places import Place
from edmctl.profile.setup import ARRIVAL_RUN_UM
from edmctl.record.rows import RunEvent
from edmctl.results.progress import Phase
from edmctl.wording import coordinates, duration

ROTARY_REPEATABILITY_DEG = 0.1
"""Repeatability of the rotary table (Muralidhara et al. 2009, §3.1): a smaller turn is not made."""

_SETTLE_S = 0.2
_WORTH_SETTING_UM = 1.0
"""A home nearer than this to that of the controller is not sent."""
_OF_ANOTHER_BENCH = (
    "A virtual controller that is served anew without --bench is another machine, though with the number of the one "
    "before where the seed is the same. Keep its runs in another folder (--out), or serve it with another --seed; "
    "with --bench FILE it stays the same machine."
)
SETTABLE_BELOW_UM = 4.9
"""A home 5 µm beyond the tool at rest is wrong: nothing pulls a tool beyond home."""
SETTABLE_UM = 22.0
"""The controller accepts no home 25 µm from the tool at rest: the host waits for creep. The controller's own reading
is low-passed; it lags by 1 to 2 µm while creep ends."""


def retract(run: JobRun) -> None:
    """Ramp to 0 V, and wait until creep allows the stages to move.

    The height over home counts, where the tool rests without creep: the sensor's own zero drifts.
    """
    run.begin(Phase.RETRACTING)
    run.machine.ramp(0.0, retract_v_s(run.setup))
    rest_and_look(run, _SETTLE_S)
    end_s = run.machine.time_s + CREEP_WAIT_S
    while True:
        home = home_now(run)
        over_um, most_um = run.watch.displacement_um - home.um, most_over_um(run, home)
        if over_um < -SETTABLE_BELOW_UM and run.job.calibration is not None:
            raise _of_another_actuator(over_um)
        if over_um <= most_um and _is_home_set(run, home, over_um):
            break
        if run.machine.time_s > end_s:
            raise _stands_out(run, home, over_um, most_um if over_um > most_um else SETTABLE_UM)
        rest_and_look(run, CREEP_LOOK_S)
    run.tally.home_um, run.tally.home_s = home.um, run.machine.time_s


def _is_home_set(run: JobRun, home: Home, over_um: float) -> bool:
    """Set the controller's home if it would accept that; return whether it then permits stage moves."""
    if over_um <= SETTABLE_UM and abs(home.um - run.machine.zero_um) > _WORTH_SETTING_UM:
        run.machine.set_zero(home.um)
    safe_z_um = controller_settings(run.profile, run.setup).safe_z_um
    return run.watch.displacement_um - run.machine.zero_um <= safe_z_um - READING_MARGIN_UM


def _of_another_actuator(over_um: float) -> PreconditionError:
    return PreconditionError(
        f"The calibration is not this actuator's: at 0 V the sensor shows the tool {-over_um:.0f} µm "
        "nearer than it has home.",
        hint="Run `edmctl calibrate` here, or leave the calibration out.",
        code="E8038",
    )


def _stands_out(run: JobRun, home: Home, over_um: float, most_um: float) -> PreconditionError:
    """Return why no stage may move: the tool is too far out, or may be with the sensor's drift."""
    if home.hidden_um <= CLEAR_UM:
        message = (
            f"The tool stands {over_um:.1f} µm from home at 0 V; the stages may move below {most_um:.1f} µm "
            "only."
        )
        hint = "Check the displacement sensor and the actuator's supply."
    else:
        message = (
            f"The sensor reads {run.watch.displacement_um:.1f} µm at 0 V and may have drifted so far since its zero "
            f"was known that the tool could stand {over_um + home.hidden_um:.0f} µm out; the surface is "
            f"{run.profile.approach.offset_um:.0f} µm from home."
        )
        hint = _zero_the_sensor(run)
    before_the_job_s = run.machine.uptime_s - run.machine.time_s
    if math.isnan(run.tally.home_s) and before_the_job_s < run.job.home_age_s - REPORT_DELAY_S:
        message += (
            f" The controller was started {duration(run.machine.uptime_s)} ago; home was known before that."
        )
        hint = _OF_ANOTHER_BENCH if run.machine.identity.simulated else _zero_the_sensor(run)
    return PreconditionError(message, hint=hint, code="E8020")


def _zero_the_sensor(run: JobRun) -> str:
    """Return the hint for an unknown position at 0 V."""
    has_old_zero = not math.isnan(run.job.home_age_s)
    old = " Use a new folder of run files (--out): this one has the old zero." if has_old_zero else ""
    return (
        "Check that the tool is retracted and free, set the displacement sensor to zero, and restart the "
        f"controller.{old} {stages_by_hand()}"
    )


def move_to(run: JobRun, place: Place) -> None:
    """Retract, then move X and Y to a place; the displacement estimate counts from the rest there.

    Raises PreconditionError E8021 if the tool touches something although it is retracted.
    """
    retract(run)
    run.refuse_contact(
        " with the tool retracted; no stage was moved",
        "Look whether the tool stands on something, and for a shorted continuity wire.",
    )
    run.tally.here = "" if place.name in (PAD, PARKING) else place.name
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
    message = f"At {place.name} {coordinates(place.x_um, place.y_um)}."
    run.decide(RunEvent.STAGE_MOVED, message, {"x_um": place.x_um, "y_um": place.y_um})
    run.watch.rest()
