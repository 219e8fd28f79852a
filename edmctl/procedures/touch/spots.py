"""The pad and the workpiece surface, touched at two spots: debris under the tool lies at only one of them.

The spots are further apart than the tool is wide. If they do not agree further ones decide: debris shortens a
reading, so the longest reading counts as soon as another spot confirms it. The pad shows the length of the tool.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from edmctl import failures
from edmctl.dataclasses import dataclass, replace
from edmctl.procedures.run import JobRun
from edmctl.procedures.stages import move_to
from edmctl.procedures.touch.approach import lower_to
from edmctl.procedures.touch.reading import (
    BEYOND_PREDICTION_UM,
    Search,
    SurfaceReading,
    constant,
    search_near,
    take_reading_in,
)
from edmctl.process.plane import Step
from edmctl.process.rest_drift import mean_rest
from edmctl.process.touches import (
    TOUCH_CHECK_SD_UM,
    TOUCH_U_UM,
    Deviation,
    Drift,
    agreeing_spots,
    has_grown,
    is_constant,
    pooled_reading,
    tilt_uncertainty_um,
)
from edmctl.profile.places import Place
from edmctl.profile.setup import Setup
from edmctl.record.rows import RejectedTouch, RunEvent
from edmctl.wording import duration

SPOT_LEG_UM = 2.0  # at a further spot the fast leg ends this far above the contact before
SPOT_SETTLE_S = 0.2
RAMP_CLEAR_UM = 25.0
"""A blind ramp ends this far above it: a ramp that meets debris is a fault, a touch that does is not."""
WORTH_A_RAMP_UM = 20.0  # a shorter way is left to the fast leg of the touch
OFFSET_U_UM = 3.5
"""Standard uncertainty of the distance to the pad before the first touch, and of a tool set anew to a height."""
PAD_TURNS_DEG = (0.0, 60.0, -60.0)
"""Directions of the further spots of the pad, from the direction away from the holes: all are equally far apart."""


@dataclass(frozen=True, slots=True)
class Spots:
    """Places of one surface, all further apart than the tool is wide; its height is wanted at the first."""

    surface: str
    places: tuple[Place, ...]

    def middle_um(self, touches: int) -> tuple[float, float]:
        """Return x and y, µm, at which a reading of so many touches at the first two places holds."""
        first, second = self.places[:2]
        at_first, later = shared_out(touches)
        share = later / (at_first + later)
        x_um, y_um = first.x_um, first.y_um
        return x_um + share * (second.x_um - x_um), y_um + share * (second.y_um - y_um)


def shared_out(touches: int) -> tuple[int, int]:
    """Return the numbers of touches of a reading at its first place, and at each further one."""
    later = max(1, touches // 3)
    return max(1, touches - later), later


def beside(run: JobRun, place: Place, angle: float) -> Place:
    """Return the spot beside a place in a direction, radians."""
    distance_um = run.job.spot_distance_um
    x_um, y_um = place.x_um + distance_um * math.cos(angle), place.y_um + distance_um * math.sin(angle)
    return replace(place, x_um=x_um, y_um=y_um)


def read_at_spots(
    run: JobRun,
    kind: str,
    place: str,
    spots: Spots,
    predicted_um: float,
    u_um: float,
    deepest_um: float = -math.inf,
) -> SurfaceReading:
    """Touch a surface at two spots, and at further ones if they do not agree.

    Contact is expected at `predicted_um` with a standard uncertainty of `u_um`, and searched to `deepest_um` if that
    is further. There are at least `measure.touches` touches in all. Raises ObjectiveNotReached E7022 if no two spots
    agree on the longest reading, and E7021 if all touches are the same to the last digit, also after the last spot
    is touched again.
    """
    search = search_near(run, predicted_um, u_um, deepest_um)
    at_first, later = shared_out(search.touches)
    move_to(run, spots.places[0])
    found = [take_reading_in(run, kind, place, replace(search, touches=at_first))]

    def further() -> SurfaceReading:
        near_um = max(one.z_um for one in found)
        ramp_um = near_um - RAMP_CLEAR_UM
        if run.setup.sensor.fitted and ramp_um - run.watch.displacement_um > WORTH_A_RAMP_UM:
            lower_to(run, ramp_um)
        z_max_um = max(search.z_max_um, near_um + BEYOND_PREDICTION_UM)
        return take_reading_in(
            run, kind, place, Search(near_um - SPOT_LEG_UM, z_max_um, later, SPOT_SETTLE_S)
        )

    for spot in spots.places[1:]:
        move_to(run, spot)
        found.append(further())
        if is_constant([one.reading for one in found]):
            run.warn(
                RunEvent.TOUCH_DOUBTED,
                f"{kind}: every touch says {found[-1].z_um:.3f} µm to the last digit. It is touched again.",
                {"kind": kind, "z_um": found[-1].z_um},
            )
            _reject(run, found[-1:])
            found[-1] = further()
            if is_constant([one.reading for one in found]):
                _reject(run, found)
                raise constant(found[-1])
        place_u_um = math.hypot(_tilt_u_um(run), _sensed_u_um(run, found))
        agreeing = agreeing_spots([one.reading for one in found], place_u_um)
        if len(agreeing) > 1:
            return _together(run, found, agreeing, spots)
    _reject(run, found)
    message = ", ".join(f"{one.z_um:.2f}" for one in found)
    raise failures.spots_disagree(kind=kind, found_count=len(found), surface=spots.surface, message=message)


def _reject(run: JobRun, readings: Sequence[SurfaceReading]) -> None:
    for one in readings:
        run.recorder.append(RejectedTouch(one.time_s))


def _sensed_u_um(run: JobRun, found: Sequence[SurfaceReading]) -> float:
    sensor_u = run.uncertainty
    return math.hypot(sensor_u.drifted_u_um(found[-1].time_s - found[0].time_s), sensor_u.model_u_um)


def _tilt_u_um(run: JobRun) -> float:
    setup = run.setup
    return tilt_uncertainty_um(
        setup.surface.tilt_u_mrad, run.job.spot_distance_um, setup.stage.repeatability_um
    )


def _together(
    run: JobRun, found: Sequence[SurfaceReading], agreeing: Sequence[int], spots: Spots
) -> SurfaceReading:
    """Return one reading of the spots that agree; other spots than the first two differ a little, by the tilt."""
    used = [found[i] for i in agreeing]
    touches = sum(one.reading.touches for one in used)
    shares = [one.reading.touches / touches for one in used]
    reading = pooled_reading([one.reading for one in used])

    def mean_of(values: Iterable[float]) -> float:
        return math.fsum(share * value for share, value in zip(shares, values, strict=True))

    mean = replace(
        used[-1],
        reading=reading,
        model_um=mean_of(one.model_um for one in used),
        actuator_v=mean_of(one.actuator_v for one in used),
        zero_um=mean_of(one.zero_um for one in used),
        rest=mean_rest([one.rest for one in used], shares),
    )
    if tuple(agreeing) == (0, 1):
        first, second = spots.places[:2]
        step = Step(
            way_um=(second.x_um - first.x_um, second.y_um - first.y_um),
            um=found[1].z_um - found[0].z_um,
            touches=(found[0].reading.touches, found[1].reading.touches),
            sensed_u_um=_sensed_u_um(run, found),
        )
        return replace(mean, doubt_u_um=0.0, debris_um=0.0, step=step)
    left_out = [one for one in found if one not in used]
    _reject(run, left_out)
    counted = " and ".join(f"{one.z_um:.2f}" for one in used)
    run.warn(
        RunEvent.TOUCH_DOUBTED,
        f"{found[0].kind}: {counted} µm at two spots of the {spots.surface} agree. Something lay under the tool at "
        f"the other, {', '.join(f'{one.z_um:.2f}' for one in left_out)} µm, which does not count.",
        {"kind": found[0].kind, "shortest_um": min(one.z_um for one in found), "z_um": used[-1].z_um},
    )
    debris_um = 0.0 if 0 in agreeing else reading.mean_um - found[0].z_um
    return replace(mean, doubt_u_um=_tilt_u_um(run), debris_um=debris_um, step=None)


def read_pad(
    run: JobRun, kind: str, place: str, predicted_um: float, u_um: float, deepest_um: float = -math.inf
) -> SurfaceReading:
    """Touch the pad at two spots, and at up to two more if they do not agree; see `read_at_spots`."""
    return read_at_spots(run, kind, place, Spots("pad", pad_spots(run)), predicted_um, u_um, deepest_um)


def pad_spots(run: JobRun) -> tuple[Place, ...]:
    """Return the pad's place, and those beside it on the side away from the holes."""
    pad, sites = run.job.pad, run.job.sites
    x_um = math.fsum(site.x_um for site in sites) / len(sites) - pad.x_um
    y_um = math.fsum(site.y_um for site in sites) / len(sites) - pad.y_um
    away = math.atan2(-y_um, -x_um)
    return (pad, *(beside(run, pad, away + math.radians(turn)) for turn in PAD_TURNS_DEG))


def pad_u_um(setup: Setup) -> float:
    """Return the standard uncertainty of meeting the pad again: repeatability of the stages, through its tilt."""
    return tilt_uncertainty_um(setup.surface.tilt_u_mrad, 0.0, setup.stage.repeatability_um)


@dataclass(frozen=True, slots=True)
class ToolLength:
    """The last reading of the pad, and the wear estimated since, with its standard uncertainty."""

    pad: SurfaceReading
    wear_um: float = 0.0
    wear_u_um: float = 0.0

    @property
    def pad_um(self) -> float:
        """Displacement at which the tool would meet the pad."""
        return self.pad.z_um + self.wear_um

    def u_um(self, now_s: float, drift_u_um_per_s: float) -> float:
        """Return the standard uncertainty of that, at a moment."""
        drift_um = drift_u_um_per_s * max(0.0, now_s - self.pad.time_s)
        return math.hypot(TOUCH_U_UM, self.pad.doubt_u_um, self.wear_u_um, drift_um)

    def worn(self, wear_um: float, wear_u_um: float) -> ToolLength:
        """Return the length after a hole that was not measured; the errors of such holes have the same sign."""
        return ToolLength(self.pad, self.wear_um + wear_um, self.wear_u_um + wear_u_um)


def refuse_grown_tool(
    run: JobRun, z1_um: float, z3: SurfaceReading, age_s: float, more_u_um: float = 0.0
) -> None:
    """Raise ObjectiveNotReached E7023 if by the pad the tool has become longer.

    `z1_um` is the pad `age_s` ago, with a standard uncertainty of `more_u_um` besides drift and touches.
    """
    drift_um = run.uncertainty.drift_u_um_per_s * age_s
    u_um = math.hypot(TOUCH_CHECK_SD_UM, more_u_um, z3.doubt_u_um, drift_um)
    wear = Deviation(z3.z_um - z1_um, u_um)
    if not has_grown(wear):
        return
    raise failures.tool_grew(z_um=z3.z_um, um=-wear.um, u_um=u_um)


def drift_between(run: JobRun, first: SurfaceReading, last: SurfaceReading) -> Drift | None:
    """Return how much a touch of the pad drifted between two readings, by the rests before them.

    None if no drift was measured on the machine, if a reading has no rest, as one of an earlier run, and if the
    rests leave more uncertainty than the drift of the setup: creep of an unknown use may be in them.
    """
    job = run.job
    if job.drift is None or first.rest is None or last.rest is None:
        return None
    seconds = last.time_s - first.time_s
    found = job.drift.between(first.rest, last.rest, seconds, job.unknown_use_s)
    return found if found.left_u_um < run.uncertainty.drift_u_um_per_s * seconds else None


def rest_before_pad(run: JobRun, first: SurfaceReading) -> None:
    """Rest at 0 V over the pad before it is touched again, if the wear gains more by that than the depth loses.

    A deep cut leaves creep in the rest after it, which adds to the uncertainty of the drift.
    """
    model = run.job.drift
    if model is None or first.rest is None:
        return
    move_to(run, run.job.pad)
    now = run.watch.last_rest
    assert now is not None
    seconds, drift_u_um_per_s = now.time_s - first.time_s, run.uncertainty.drift_u_um_per_s
    more_s = model.rest_that_pays_s(first.rest, now, seconds, run.job.unknown_use_s, drift_u_um_per_s)
    if not more_s:
        return
    message = (
        f"Rests for {duration(more_s)} before the pad: creep of the cut fades, and drift is known better."
    )
    run.decide(RunEvent.CREEP_RESTED_OUT, message, {"rest_s": more_s})
    run.machine.rest(more_s)
