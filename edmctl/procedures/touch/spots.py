"""The pad and the face, touched at two spots: a chip under the tool lies at one of them and not at the other.

The spots are further apart than the tool is wide. Where they do not agree further ones decide: what lies under a
tool shortens a reading, so the longest reading counts as soon as another spot confirms it. The pad tells the length
of the tool, and one that cannot have grown.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from edmctl.dataclasses import dataclass, replace
from edmctl.errors import ObjectiveNotReached
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
    agreeing_spots,
    has_grown,
    is_constant,
    pooled_reading,
    tilt_uncertainty_um,
)
from edmctl.profile.places import Place
from edmctl.profile.setup import Setup
from edmctl.record.rows import EventLevel, RejectedTouch, RunEvent

SPOT_LEG_UM = 2.0
"""At a further spot the fast leg ends this far above where contact was before."""
SPOT_SETTLE_S = 0.2
RAMP_CLEAR_UM = 25.0
"""A blind ramp ends this far above it: a ramp that runs into a chip is a fault, a touch that does is not."""
WORTH_A_RAMP_UM = 20.0
"""A shorter way than this is left to the fast leg of the touch."""
OFFSET_U_UM = 3.5
"""Return the standard uncertainty of the distance to the pad before the first touch."""
PAD_TURNS_DEG = (0.0, 60.0, -60.0)
"""Directions of the further spots as seen from the pad, from that away from the holes: all are equally far apart."""


@dataclass(frozen=True, slots=True)
class Spots:
    """Places of one surface, all further apart than the tool is wide: the first is where its height is wanted."""

    surface: str
    places: tuple[Place, ...]

    def middle_um(self, touches: int) -> tuple[float, float]:
        """Return where a reading of so many touches holds that were made at the first two places: x and y, µm."""
        first, second = self.places[:2]
        at_first, later = shared_out(touches)
        share = later / (at_first + later)
        x_um, y_um = first.x_um, first.y_um
        return x_um + share * (second.x_um - x_um), y_um + share * (second.y_um - y_um)


def shared_out(touches: int) -> tuple[int, int]:
    """Return how many of the touches of a reading are made at its first place, and at each further one."""
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
    """Touch a surface at two spots, and at further ones where they do not agree.

    Contact is expected at `predicted_um` with a standard uncertainty of `u_um`, and looked for to `deepest_um` where
    that is further. There are at least `measure.touches` touches in all. Raises ObjectiveNotReached E7022 where no
    two spots agree on the longest reading, and E7021 where all touches are the same to the last digit and stay so
    when the last spot is touched again.
    """
    search = search_near(run, predicted_um, u_um, deepest_um)
    at_first, later = shared_out(search.touches)
    move_to(run, spots.places[0])
    search = replace(search, touches=at_first)
    found = [take_reading_in(run, kind, place, search)]
    for spot in spots.places[1:]:
        move_to(run, spot)
        found.append(_at_further_spot(run, kind, place, found, replace(search, touches=later)))
        if is_constant([one.reading for one in found]):
            _report_constant(run, found[-1])
            _reject(run, [found[-1]])
            found[-1] = _at_further_spot(run, kind, place, found, replace(search, touches=later))
            if is_constant([one.reading for one in found]):
                _reject(run, found)
                raise constant(found[-1])
        place_u_um = math.hypot(_tilt_u_um(run), _sensed_u_um(run, found))
        agreeing = agreeing_spots([one.reading for one in found], place_u_um)
        if len(agreeing) > 1:
            return _together(run, found, agreeing, spots)
    _reject(run, found)
    message = ", ".join(f"{one.z_um:.2f}" for one in found)
    raise ObjectiveNotReached(
        f"{kind}: no two of {len(found)} spots of the {spots.surface} agree on the longest reading: {message} µm.",
        hint=f"Clean tool and work, and look whether the {spots.surface} is flat for a tool's width around there.",
        code="E7022",
    )


def _reject(run: JobRun, readings: Sequence[SurfaceReading]) -> None:
    """Tell the run file that other readings count instead of these, or none."""
    for one in readings:
        run.recorder.append(RejectedTouch(one.time_s))


def _at_further_spot(
    run: JobRun, kind: str, place: str, found: Sequence[SurfaceReading], first: Search
) -> SurfaceReading:
    near_um = max(one.z_um for one in found)
    ramp_um = near_um - RAMP_CLEAR_UM
    if run.setup.sensor.fitted and ramp_um - run.watch.displacement_um > WORTH_A_RAMP_UM:
        lower_to(run, ramp_um)
    z_max_um = max(first.z_max_um, near_um + BEYOND_PREDICTION_UM)
    search = replace(first, fast_to_um=near_um - SPOT_LEG_UM, z_max_um=z_max_um, settle_s=SPOT_SETTLE_S)
    return take_reading_in(run, kind, place, search)


def _report_constant(run: JobRun, found: SurfaceReading) -> None:
    run.decide(
        RunEvent.TOUCH_DOUBTED,
        f"{found.kind}: every touch says {found.z_um:.3f} µm to the last digit. It is touched again.",
        {"kind": found.kind, "z_um": found.z_um},
        level=EventLevel.WARNING,
    )


def _sensed_u_um(run: JobRun, found: Sequence[SurfaceReading]) -> float:
    sensor_u = run.uncertainty
    return math.hypot(
        sensor_u.drifted_u_um(found[-1].time_s - found[0].time_s),
        sensor_u.model_u_um,
    )


def _tilt_u_um(run: JobRun) -> float:
    setup = run.setup
    return tilt_uncertainty_um(
        setup.surface.tilt_u_mrad, run.job.spot_distance_um, setup.stage.repeatability_um
    )


def _together(
    run: JobRun, found: Sequence[SurfaceReading], agreeing: Sequence[int], spots: Spots
) -> SurfaceReading:
    """Return one reading of the spots that agree; unusual ones lie a little differently, by the tilt between."""
    used = [found[i] for i in agreeing]
    touches = sum(one.reading.touches for one in used)
    shares = [one.reading.touches / touches for one in used]
    usual = tuple(agreeing) == (0, 1)
    if not usual:
        _reject(run, [one for one in found if one not in used])
        left_out = ", ".join(f"{one.z_um:.2f}" for one in found if one not in used)
        counted = " and ".join(f"{one.z_um:.2f}" for one in used)
        run.decide(
            RunEvent.TOUCH_DOUBTED,
            f"{found[0].kind}: {counted} µm at two spots of the {spots.surface} agree. Something lay under the tool "
            f"at the other, {left_out} µm, which does not count.",
            {"kind": found[0].kind, "shortest_um": min(one.z_um for one in found), "z_um": used[-1].z_um},
            level=EventLevel.WARNING,
        )
    reading = pooled_reading([one.reading for one in used])
    return replace(
        used[-1],
        reading=reading,
        model_um=math.fsum(share * one.model_um for share, one in zip(shares, used, strict=True)),
        actuator_v=math.fsum(share * one.actuator_v for share, one in zip(shares, used, strict=True)),
        zero_um=math.fsum(share * one.zero_um for share, one in zip(shares, used, strict=True)),
        rest=mean_rest([one.rest for one in used], shares),
        doubt_u_um=0.0 if usual else _tilt_u_um(run),
        debris_um=0.0 if 0 in agreeing else reading.mean_um - found[0].z_um,
        step=_step(run, found, spots) if usual else None,
    )


def _step(run: JobRun, found: Sequence[SurfaceReading], spots: Spots) -> Step:
    first, second = spots.places[:2]
    return Step(
        way_um=(second.x_um - first.x_um, second.y_um - first.y_um),
        um=found[1].z_um - found[0].z_um,
        touches=(found[0].reading.touches, found[1].reading.touches),
        sensed_u_um=_sensed_u_um(run, found),
    )


def read_pad(
    run: JobRun, kind: str, place: str, predicted_um: float, u_um: float, deepest_um: float = -math.inf
) -> SurfaceReading:
    """Touch the pad at two spots, and at up to two more where they do not agree.

    Where contact is expected is told as to `read_at_spots`, and it raises what that raises.
    """
    return read_at_spots(run, kind, place, Spots("pad", pad_spots(run)), predicted_um, u_um, deepest_um)


def pad_middle_um(run: JobRun) -> tuple[float, float]:
    """Return where a reading of the pad holds: x and y of the middle of its two spots, each by its touches, µm."""
    return Spots("pad", pad_spots(run)).middle_um(run.profile.measure.touches)


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
        """Return the length after a hole that was not measured; the errors of such holes go the same way."""
        return ToolLength(self.pad, self.wear_um + wear_um, self.wear_u_um + wear_u_um)


def refuse_grown_tool(
    run: JobRun, z1_um: float, z3: SurfaceReading, age_s: float, more_u_um: float = 0.0
) -> None:
    """Raise ObjectiveNotReached E7023 where the pad says that the tool has become longer.

    `z1_um` is the pad `age_s` ago, with a standard uncertainty of `more_u_um` besides drift and touches.
    """
    drift_um = run.uncertainty.drift_u_um_per_s * age_s
    u_um = math.hypot(TOUCH_CHECK_SD_UM, more_u_um, z3.doubt_u_um, drift_um)
    wear = Deviation(z3.z_um - z1_um, u_um)
    if not has_grown(wear):
        return
    raise ObjectiveNotReached(
        f"Z3 = {z3.z_um:.2f} µm: the tool is {-wear.um:.2f} µm longer than before the cut (standard uncertainty "
        f"{u_um:.2f} µm), which it cannot be.",
        hint="Clean the face of the tool and the reference pad, and look whether the tool has slipped in its chuck.",
        code="E7023",
    )
