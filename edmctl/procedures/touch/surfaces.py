"""Pad and plane of the workpiece surface, touched at two spots: debris is under the tool at only one of them.

The spots are further apart than the tool is wide. If they do not agree further ones decide: debris shortens a
reading, so the longest reading counts as soon as another spot confirms it. The pad shows the length of the tool, and
the plane is relative to it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from edmctl import failures
from edmctl.dataclasses import dataclass, replace
from edmctl.procedures.job import SurfaceTouch
from edmctl.procedures.run import Args, JobRun
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
from edmctl.process import plane as planes
from edmctl.process.plane import TOUCHES_FOR_A_PLANE, Step
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
    share_u,
    tilt_uncertainty_um,
)
from edmctl.profile.places import Place
from edmctl.profile.setup import Setup
from edmctl.record.rows import RejectedTouch, RunEvent
from edmctl.wording import duration, signed

SPOT_LEG_UM = 2.0  # at a further spot the fast leg ends this far above the contact before
SPOT_SETTLE_S = 0.2
RAMP_CLEAR_UM = 25.0  # a blind ramp ends this far above: one that meets debris is a fault, a touch is not
WORTH_A_RAMP_UM = 20.0  # a shorter way is left to the fast leg of the touch
OFFSET_U_UM = 3.5  # u of the distance to the pad before the first touch, and of a tool set anew to a height
PAD_TURNS_DEG = (0.0, 60.0, -60.0)  # of further spots of the pad, from the direction away from the holes
KIND = "Zr"  # name of such a touch in the run file
SPOT_TURNS_DEG = (90.0, -90.0, 150.0, -150.0, 30.0, -30.0, 180.0, 0.0, 120.0, -120.0, 60.0, -60.0)
"""Directions of the further spots of a place, from the direction away from the pad: rows of holes lead away from it,
so beside them comes first."""
MOST_SPOTS = 4
STEEP_SIGMAS = 4.0  # a touch further from the expected surface is repeated elsewhere: 0.006 % of good ones
HALFWAY_SIGMAS = 3.0  # if the halfway touch is further from that slope, it is no plane, or a touch is wrong


@dataclass(frozen=True, slots=True)
class Spots:
    """Places of one surface, further apart than the tool is wide; its height at the first one is to be measured."""

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
    agree on the longest reading, E7021 if all touches are the same to the last digit, also after another one.
    """
    search = search_near(run, predicted_um, u_um, deepest_um)
    at_first, later = shared_out(search.touches)
    move_to(run, spots.places[0])
    found = [take_reading_in(run, kind, place, replace(search, touches=at_first))]

    def further() -> SurfaceReading:
        near_um = max(z.z_um for z in found)
        ramp_um = near_um - RAMP_CLEAR_UM
        if run.setup.sensor.fitted and ramp_um - run.watch.displacement_um > WORTH_A_RAMP_UM:
            lower_to(run, ramp_um)
        z_max_um = max(search.z_max_um, near_um + BEYOND_PREDICTION_UM)
        near = Search(near_um - SPOT_LEG_UM, z_max_um, later, SPOT_SETTLE_S)
        return take_reading_in(run, kind, place, near)

    for spot in spots.places[1:]:
        move_to(run, spot)
        found.append(further())
        if is_constant([z.reading for z in found]):
            run.warn(
                RunEvent.TOUCH_DOUBTED,
                f"{kind}: every touch reads {found[-1].z_um:.3f} µm to the last digit. It is touched again.",
                {"kind": kind, "z_um": found[-1].z_um},
            )
            _reject(run, found[-1:])
            found[-1] = further()
            if is_constant([z.reading for z in found]):
                _reject(run, found)
                raise constant(found[-1])
        tilt_u_um, sensed_u_um = _spot_u_um(run, found)
        agreeing = agreeing_spots([z.reading for z in found], math.hypot(tilt_u_um, sensed_u_um))
        if len(agreeing) > 1:
            return _together(run, found, agreeing, spots)
    _reject(run, found)
    message = ", ".join(f"{z.z_um:.2f}" for z in found)
    raise failures.spots_disagree(kind=kind, found_count=len(found), surface=spots.surface, message=message)


def _reject(run: JobRun, readings: Sequence[SurfaceReading]) -> None:
    for z in readings:
        run.recorder.append(RejectedTouch(z.time_s))


def _spot_u_um(run: JobRun, found: Sequence[SurfaceReading]) -> tuple[float, float]:
    """Return the standard uncertainties of a difference of two spots, by tilt and by the displacement."""
    sensor_u, setup = run.uncertainty, run.setup
    tilt_mrad, repeatability_um = setup.surface.tilt_u_mrad, setup.stage.repeatability_um
    drifted_um = sensor_u.drifted_u_um(found[-1].time_s - found[0].time_s)
    tilt_u_um = tilt_uncertainty_um(tilt_mrad, run.job.spot_distance_um, repeatability_um)
    return tilt_u_um, math.hypot(drifted_um, sensor_u.model_u_um)


def _together(
    run: JobRun, found: Sequence[SurfaceReading], agreeing: Sequence[int], spots: Spots
) -> SurfaceReading:
    """Return one reading of the spots that agree; other spots than the first two differ a little, by the tilt."""
    used = [found[i] for i in agreeing]
    touches = sum(z.reading.touches for z in used)
    shares = [z.reading.touches / touches for z in used]
    reading = pooled_reading([z.reading for z in used])
    tilt_u_um, sensed_u_um = _spot_u_um(run, found)

    def mean_of(values: Iterable[float]) -> float:
        return math.fsum(share * value for share, value in zip(shares, values, strict=True))

    mean = replace(
        used[-1],
        reading=reading,
        model_um=mean_of(z.model_um for z in used),
        actuator_v=mean_of(z.actuator_v for z in used),
        zero_um=mean_of(z.zero_um for z in used),
        rest=mean_rest([z.rest for z in used], shares),
    )
    if tuple(agreeing) == (0, 1):
        first, second = spots.places[:2]
        step = Step(
            way_um=(second.x_um - first.x_um, second.y_um - first.y_um),
            um=found[1].z_um - found[0].z_um,
            touches=(found[0].reading.touches, found[1].reading.touches),
            sensed_u_um=sensed_u_um,
        )
        return replace(mean, doubt_u_um=0.0, debris_um=0.0, step=step)
    left_out = [z for z in found if z not in used]
    _reject(run, left_out)
    counted = " and ".join(f"{z.z_um:.2f}" for z in used)
    run.warn(
        RunEvent.TOUCH_DOUBTED,
        f"{found[0].kind}: {counted} µm at two spots of the {spots.surface} agree. Something lay under the tool at "
        f"the other, {', '.join(f'{z.z_um:.2f}' for z in left_out)} µm, which does not count.",
        {"kind": found[0].kind, "shortest_um": min(z.z_um for z in found), "z_um": used[-1].z_um},
    )
    debris_um = 0.0 if 0 in agreeing else reading.mean_um - found[0].z_um
    return replace(mean, doubt_u_um=tilt_u_um, debris_um=debris_um, step=None)


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


def refuse_grown_tool(
    run: JobRun, z1_um: float, z3: SurfaceReading, age_s: float, more_u_um: float = 0.0
) -> None:
    """Raise ObjectiveNotReached E7023 if the tool has become longer than `z1_um`, `age_s` ago, shows."""
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
    """Rest over the pad until the creep of a deep cut fades, if the wear gains more by that than the depth loses."""
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


class SurfacePlane:
    """A plane through all touches of the workpiece surface; level around the pad readings before the first.

    `touched` has x, y, height over the pad and its standard uncertainty without that of the pad, µm. `debris_um` is
    the height of debris by name of the place, `doubt_u_um` an additional standard uncertainty until the next touch.
    """

    def __init__(self, run: JobRun) -> None:
        self._run = run
        self._tilt_u_mrad = run.setup.surface.tilt_u_mrad
        middle_um = Spots("pad", pad_spots(run)).middle_um(run.profile.measure.touches)
        self.plane = planes.unknown_plane(middle_um, self._tilt_u_mrad)
        self.touched: list[SurfaceTouch] = []
        self.debris_um: dict[str, float] = {}
        self.doubt_u_um = 0.0
        self._pad_step: Step | None = None

    def height_um(self, site: Place) -> float:
        """Return the height of the surface at a place over the pad, positive away from the tool."""
        return self.plane.height_um(site.x_um, site.y_um)

    def height_u_um(self, site: Place) -> float:
        return math.hypot(self.plane.height_u_um(site.x_um, site.y_um), self.doubt_u_um)

    def doubt(self, u_um: float) -> None:
        """Add a standard uncertainty to that of the plane and of all touches."""
        self.doubt_u_um = math.hypot(self.doubt_u_um, u_um)
        self.touched = [(x_um, y_um, height, math.hypot(u, u_um)) for x_um, y_um, height, u in self.touched]
        if self.touched:
            self._fit()

    def restore(self, touched: Sequence[SurfaceTouch], doubt_u_um: float) -> None:
        """Take the touches and the doubt from before, or from an earlier run."""
        self.touched, self.doubt_u_um = list(touched), doubt_u_um
        if self.touched:
            self._fit()

    def keep(self) -> None:
        keeper = self._run.keeper
        keeper.surface, keeper.surface_doubt_u_um = tuple(self.touched), self.doubt_u_um

    def fit_pad_slope(self, reading: SurfaceReading) -> None:
        """Take the slope from a reading of the pad whose spots differ by more than the expected tilt."""
        step = reading.step
        if step is None:
            return
        expected_um = 1e-3 * self._tilt_u_mrad * math.hypot(*step.way_um)
        if abs(step.um) <= planes.CONTRADICTION_SDS * math.hypot(expected_um, step.u_um()):
            return
        self._pad_step = step
        self._fit()
        slope_x, slope_y = (float(1e3 * slope) for slope in self.plane.slope)
        self._run.decide(
            RunEvent.FACE_FITTED,
            f"Two spots of the pad differ by {signed(step.um)} µm: the face slopes by {signed(slope_x)} mrad along "
            f"x and {signed(slope_y)} mrad along y, as far as they tell.",
            {"slope_x": 1e-3 * slope_x, "slope_y": 1e-3 * slope_y},
        )

    def touch(self, site: Place, tool: ToolLength) -> None:
        """Touch the untouched surface at a place; if it is steeper than expected, halfway to the pad too."""
        run, before_u_um = self._run, self.height_u_um(site)
        off, debris_um = self._touch(surface_spots(run, site), site.name, tool)
        if debris_um > 0.0:
            self.debris_um[site.name] = debris_um
        if abs(off.sigmas) <= STEEP_SIGMAS:
            return
        pad = run.job.pad
        away = math.atan2(site.y_um - pad.y_um, site.x_um - pad.x_um)
        middle = Place(site.name, 0.5 * (site.x_um + pad.x_um), 0.5 * (site.y_um + pad.y_um), site.theta_deg)
        spot = beside(run, middle, away + math.radians(SPOT_TURNS_DEG[0]))
        halfway, _ = self._touch(surface_spots(run, spot), site.name, tool)
        known = f"as it was known within {before_u_um:.2f} µm"
        message = f"Zr at {site.name} is {signed(off.um)} µm from the face {known}"
        args: Args = {"kind": KIND, "off_um": off.um, "halfway_um": halfway.um, "site": site.name}
        if abs(halfway.sigmas) <= HALFWAY_SIGMAS:
            run.decide(RunEvent.FACE_FITTED, f"{message}; a touch halfway to the pad agrees.", args)
            return
        contradiction = f"halfway to the pad the face is {signed(halfway.um)} µm from that slope"
        run.warn(RunEvent.TOUCH_DOUBTED, f"{message}; {contradiction}. Both stay in doubt.", args)
        self.doubt(share_u(halfway.um))

    def touch_beside(self, site: Place, tool: ToolLength) -> None:
        """Touch the surface beside a place that may be machined."""
        around = surface_spots(self._run, site)
        self._touch(replace(around, places=around.places[1:]), site.name, tool)

    def touch_plane(self, sites: Sequence[Place], tool: ToolLength) -> None:
        """Touch the surface at the sites that are furthest apart."""
        pad = self._run.job.pad
        places = [(site.x_um, site.y_um) for site in sites]
        for i in planes.spread_out(places, (pad.x_um, pad.y_um), TOUCHES_FOR_A_PLANE):
            self.touch(sites[i], tool)
        slope = self.plane.slope
        self._run.decide(
            RunEvent.FACE_FITTED,
            f"The face slopes by {signed(1e3 * slope[0])} mrad along x and {signed(1e3 * slope[1])} mrad along y.",
            {"slope_x": float(slope[0]), "slope_y": float(slope[1])},
        )

    def _touch(self, spots: Spots, name: str, tool: ToolLength) -> tuple[Deviation, float]:
        """Touch the surface and fit the plane anew; return the deviation from the plane before, and the debris."""
        run = self._run
        x_um, y_um = spots.middle_um(run.profile.measure.touches)
        predicted_um = tool.pad_um + self.plane.height_um(x_um, y_um)
        face_u_um = self.plane.height_u_um(x_um, y_um)
        drift_u_um_per_s = run.uncertainty.drift_u_um_per_s
        u_um = math.hypot(tool.u_um(run.machine.time_s, drift_u_um_per_s), face_u_um)
        reading = read_at_spots(run, KIND, name, spots, predicted_um, u_um)
        u_um = math.hypot(tool.u_um(reading.time_s, drift_u_um_per_s), reading.doubt_u_um)
        off = Deviation(reading.z_um - predicted_um, math.hypot(u_um, TOUCH_U_UM, face_u_um))
        self.touched.append((x_um, y_um, reading.z_um - tool.pad_um, u_um))
        self.doubt_u_um = 0.0
        self._fit()
        return off, reading.debris_um

    def _fit(self) -> None:
        self.plane = planes.fitted_plane(
            self.plane.origin_um,
            [(x_um, y_um) for x_um, y_um, _, _ in self.touched],
            [height for _, _, height, _ in self.touched],
            [u for _, _, _, u in self.touched],
            self._tilt_u_mrad,
            [self._pad_step] if self._pad_step else [],
        )


def surface_spots(run: JobRun, site: Place) -> Spots:
    """Return a place and spots beside it, apart by more than the tool, those clear of machined places first."""
    pad, distance_um = run.job.pad, run.job.spot_distance_um
    away = math.atan2(site.y_um - pad.y_um, site.x_um - pad.x_um)
    made = [(hole.x_um, hole.y_um) for hole in run.tally.sites.values()]

    def crowded_um(spot: Place) -> float:
        nearest_um = min((math.dist(hole, (spot.x_um, spot.y_um)) for hole in made), default=math.inf)
        return max(0.0, distance_um - nearest_um)

    around = [beside(run, site, away + math.radians(turn)) for turn in SPOT_TURNS_DEG]
    places = [site]
    for spot in sorted(around, key=crowded_um):
        apart_um = min(math.dist((spot.x_um, spot.y_um), (one.x_um, one.y_um)) for one in places)
        if apart_um > run.profile.tool.diameter_um and len(places) < MOST_SPOTS:
            places.append(spot)
    return Spots("face", tuple(places))
