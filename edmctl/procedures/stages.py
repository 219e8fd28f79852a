"""Home of the tool by the sensor, and stage moves: only with the tool retracted, arriving from the same side.

A reading at 0 V does not distinguish a drift of the sensor from a tool that is held out: only the time in which the
zero may have drifted bounds it, and after hours that is more than the clearance of the tool. Then a touch decides,
if the surface under the tool is known: the way to contact includes no drift.
"""

from __future__ import annotations

import math

from edmctl import failures
from edmctl.dataclasses import dataclass, replace
from edmctl.errors import PreconditionError, stages_by_hand
from edmctl.labels import PAD, PARKING
from edmctl.machine.interface import Axis
from edmctl.planning.channel import is_on_way, way_of_path
from edmctl.procedures.hole.cut_planning import (
    STANDARD_UNCERTAINTIES,
    ExpectedHole,
    expected_of_left,
    lengths,
)
from edmctl.procedures.job import REPORT_DELAY_S
from edmctl.procedures.monitoring.drift import DRIFT_SDS, displacement_uncertainty, first_home_um
from edmctl.procedures.run import JobRun, rest_and_look
from edmctl.procedures.settings import controller_settings, retract_v_s
from edmctl.procedures.touch.reading import BEYOND_PREDICTION_UM, Search, take_reading_in
from edmctl.profile.places import Place
from edmctl.profile.setup import ARRIVAL_RUN_UM
from edmctl.record.rows import RunEvent
from edmctl.results.progress import Phase
from edmctl.wording import coordinates, duration

CLEAR_UM = 10.0  # stages move only if the tool is surely this far above the surface: several times the tilt
SOON_S = 600.0  # at its start a job checks that the stages may move this much later too
CREEP_WAIT_S = 60.0  # longest wait for the actuator to creep back below where the stages may move
CREEP_LOOK_S = 1.0
_SETTLED_UM = 0.2  # a rest that falls by less than this in a second has settled
MODEL_ERROR_UM = 12.0  # twice the error of the actuator model in the first second at 0 V after a deep cut
READING_MARGIN_UM = 1.0  # the controller decides by its own reading: more than its noise
_CHECK_TOUCHES = 2


@dataclass(frozen=True, slots=True)
class Home:
    """The sensor reading with the tool at home, and by how much at most that is too far out, µm."""

    um: float
    hidden_um: float = 0.0


def most_over_um(run: JobRun, home: Home) -> float:
    """Return how far from home the tool may read while a stage moves, clear of the workpiece in any case."""
    safe_z_um = controller_settings(run.profile, run.setup).safe_z_um
    return min(
        safe_z_um - READING_MARGIN_UM, run.profile.approach.offset_um - CLEAR_UM - max(0.0, home.hidden_um)
    )


def home_now(run: JobRun) -> Home:
    """Return home by the sensor: the rest at 0 V less the creep by the actuator model.

    Before there is a model it is the rest itself, once that has stopped falling, as far as drift can explain it; if
    drift could hide too much, a touch measures it. Raises PreconditionError E8020 if a rest is further from the
    first or the newest than creep and drift allow: then something else holds the tool.
    """
    if not run.setup.sensor.fitted:
        return Home(0.0)
    zero_um, rests, now_s = run.watch.zero_um(), run.watch.rests, run.machine.time_s
    if math.isnan(zero_um):
        home = _first_home(run)
        rests.first_um, rests.hidden_um, rests.first_s = home.um, home.hidden_um, run.machine.time_s
        return home
    drift_u_um_per_s = displacement_uncertainty(run.job).drift_u_um_per_s
    for before_s, before_um in rests.ends():
        moved_um = abs(zero_um - before_um)
        most_um = MODEL_ERROR_UM + DRIFT_SDS * drift_u_um_per_s * (now_s - before_s)
        if moved_um > most_um:
            raise failures.rest_moved(zero_um=moved_um, time_s=now_s - before_s, most_um=most_um)
    return Home(rests.home_um(zero_um), rests.hidden_um)


def _first_home(run: JobRun) -> Home:
    """Return home by a rest without a model, or by a touch."""
    job, rests = run.job, run.watch.rests
    rest_um = _settled_um(run)
    fastest_um_s = DRIFT_SDS * displacement_uncertainty(job).drift_u_um_per_s
    if math.isnan(rests.first_um):
        expected, soon_um = Home(job.home_um), fastest_um_s * SOON_S
        age_s = run.machine.uptime_s if math.isnan(job.home_age_s) else job.home_age_s
    else:
        expected, soon_um = Home(rests.first_um, rests.hidden_um), 0.0
        age_s = run.machine.time_s - rests.first_s
    drift_um = fastest_um_s * age_s
    home_um = first_home_um(rest_um, expected.um, drift_um)
    home = Home(home_um, home_um - (expected.um - expected.hidden_um - drift_um))
    if rest_um - home.um <= most_over_um(run, replace(home, hidden_um=home.hidden_um + soon_um)):
        return home
    below = _work_below(run)
    if below is None:
        return home
    # Slow all the way: the way to contact includes no drift.
    contact_um, reach_um, hidden_um = below
    search = Search(rest_um, rest_um + contact_um + reach_um + BEYOND_PREDICTION_UM, _CHECK_TOUCHES, 0.0)
    z_um = take_reading_in(run, "Zr", "the present place", search).z_um
    run.begin(Phase.RETRACTING)
    run.machine.ramp(0.0, retract_v_s(run.setup))
    rest_and_look(run, CREEP_LOOK_S)
    return Home(min(_settled_um(run), z_um - contact_um), hidden_um)


def pad_from_home_um(run: JobRun) -> float:
    """Return the distance of the pad from home, µm: by the recipe, or with the tool as an earlier run left it."""
    resumed, done = run.job.resumed, list(run.tally.sites.values())
    if resumed is not None and resumed.site:
        return resumed.z1_um + resumed.wear_um - resumed.home_um
    if resumed is not None and done:
        return done[-1].z3_um + done[-1].drift_correction_um - resumed.home_um
    return run.profile.approach.offset_um


def _work_below(run: JobRun) -> tuple[float, float, float] | None:
    """Return the contact expected under the tool from home, how much further it may be, and the hidden part, µm.

    The surface is known at the pad, at a hole that was left, or at a place that is not cut yet. The bottom of a hole
    is an estimate. The hidden part may bring the tool nearer to the surface than home by the touch.
    """
    status, pad, resumed = run.machine.status(), run.job.pad, run.job.resumed
    here, known_um = (status.x_um, status.y_um), run.setup.stage.repeatability_um
    away_um = math.dist(here, (pad.x_um, pad.y_um))
    is_begun = resumed is not None and resumed.begun
    left = expected_of_left(resumed, run.profile) if resumed and is_begun else ExpectedHole(lengths())
    pad_um, wear_reach_um = pad_from_home_um(run), left.reach_um(left.estimate.wear)
    if away_um <= run.job.spot_distance_um + known_um:
        return pad_um, wear_reach_um, 0.0
    if resumed is None:
        return None
    slope_um = STANDARD_UNCERTAINTIES * 1e-3 * run.setup.surface.tilt_u_mrad * away_um
    if run.profile.path is not None:
        if not is_on_way(way_of_path(run.profile.path), here, known_um):
            return None
        is_left_here = is_begun
    else:
        site = next((s for s in run.job.sites if math.dist(here, (s.x_um, s.y_um)) <= known_um), None)
        if site is None and _is_on_a_spot(run, here):
            return pad_um, wear_reach_um + slope_um, slope_um
        if site is None or site.name in run.tally.sites:
            return None
        is_left_here = site.name == resumed.site
    if not is_left_here:
        return pad_um, slope_um, slope_um
    reach_um = left.reach_um(left.estimate.feed) + slope_um
    return pad_um + resumed.depth_um, reach_um, reach_um


def _is_on_a_spot(run: JobRun, here: tuple[float, float]) -> bool:
    """Return whether the tool is at a second spot of the surface, beside a place and over no hole."""
    known_um = run.setup.stage.repeatability_um
    away_um = [math.dist(here, (site.x_um, site.y_um)) for site in run.job.sites]
    least_um = run.job.spot_distance_um
    return any(abs(um - least_um) <= known_um for um in away_um) and min(away_um) >= least_um - known_um


def _settled_um(run: JobRun) -> float:
    end_s, before_um = run.machine.time_s + CREEP_WAIT_S, math.inf
    while before_um - run.watch.displacement_um > _SETTLED_UM and run.machine.time_s < end_s:
        before_um = run.watch.displacement_um
        rest_and_look(run, CREEP_LOOK_S)
    return run.watch.displacement_um


ROTARY_REPEATABILITY_DEG = 0.1  # a smaller turn is not made (Muralidhara et al. 2009, §3.1)

_SETTLE_S = 0.2
_WORTH_SETTING_UM = 1.0  # a home nearer than this to that of the controller is not sent
_OF_ANOTHER_BENCH = (
    "A virtual controller that is served without --bench is another machine each time, even with the same number: "
    "use another --seed or folder of runs (--out), or serve it with --bench FILE."
)
SETTABLE_BELOW_UM = 4.9  # a home 5 µm beyond the tool at rest is wrong: nothing pulls a tool beyond home
SETTABLE_UM = 22.0  # the controller accepts no home 25 µm from the tool; its own reading lags by 2 µm


def retract(run: JobRun) -> None:
    """Ramp to 0 V, and wait until creep allows the stages to move, by the height over home."""
    run.begin(Phase.RETRACTING)
    run.machine.ramp(0.0, retract_v_s(run.setup))
    rest_and_look(run, _SETTLE_S)
    end_s = run.machine.time_s + CREEP_WAIT_S
    while True:
        home = home_now(run)
        over_um, most_um = run.watch.displacement_um - home.um, most_over_um(run, home)
        if over_um < -SETTABLE_BELOW_UM and run.job.calibration is not None:
            evidence = f"at 0 V the sensor shows the tool {-over_um:.0f} µm nearer than it has home"
            raise failures.calibration_contradicted(evidence=evidence)
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


def _stands_out(run: JobRun, home: Home, over_um: float, most_um: float) -> PreconditionError:
    """Return why no stage may move: the tool is too far out, or may be with the sensor's drift."""
    sensor_remedy = "Check the displacement sensor and the actuator's supply."
    zero_remedy = (
        "Retract and free the tool, set the displacement sensor to zero, and restart the controller. "
    )
    if not math.isnan(run.job.home_age_s):
        zero_remedy += "Use a new folder of run files (--out): this one has the old zero. "
    zero_remedy += stages_by_hand()
    if home.hidden_um <= CLEAR_UM:
        problem, remedy = (
            f"The tool is {over_um:.1f} µm from home at 0 V; the stages may move below {most_um:.1f} µm only.",
            sensor_remedy,
        )
    else:
        problem, remedy = (
            f"The sensor reads {run.watch.displacement_um:.1f} µm at 0 V and may have drifted so far since its zero "
            f"was known that the tool could stand {over_um + home.hidden_um:.0f} µm out; the surface is "
            f"{run.profile.approach.offset_um:.0f} µm from home.",
            zero_remedy,
        )
    before_the_job_s = run.machine.uptime_s - run.machine.time_s
    if math.isnan(run.tally.home_s) and before_the_job_s < run.job.home_age_s - REPORT_DELAY_S:
        problem += (
            f" The controller was started {duration(run.machine.uptime_s)} ago; home was known before that."
        )
        remedy = _OF_ANOTHER_BENCH if run.machine.identity.simulated else zero_remedy
    return failures.tool_not_home(problem=problem, remedy=remedy)


def move_to(run: JobRun, place: Place) -> None:
    """Retract, then move X and Y to a place. Raises PreconditionError E8021 if the retracted tool has contact."""
    retract(run)
    run.refuse_contact(
        " with the tool retracted; no stage was moved",
        "Check whether the tool rests on something, and for a shorted continuity wire.",
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
