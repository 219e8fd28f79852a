"""The face of the work as it was touched: at places that were not machined yet, relative to the pad."""

from __future__ import annotations

import math
from collections.abc import Sequence

from edmctl.dataclasses import dataclass, field, replace
from edmctl.planning.measuring import FACE_LIMIT_UM
from edmctl.procedures.job_state import SurfaceTouch
from edmctl.procedures.run import Args, JobRun
from edmctl.procedures.touch.reading import SurfaceReading
from edmctl.procedures.touch.spots import Spots, ToolLength, beside, pad_middle_um, read_at_spots
from edmctl.process.plane import (
    CONTRADICTION_SDS,
    TOUCHES_FOR_A_PLANE,
    Plane,
    Step,
    fitted_plane,
    spread_out,
    unknown_plane,
)
from edmctl.process.touches import TOUCH_U_UM, Deviation, share_u
from edmctl.profile.places import Place
from edmctl.record.rows import EventLevel, RunEvent
from edmctl.wording import signed

KIND = "Zr"
"""What such a touch is called in the run file: the face at a place that is not machined yet."""
SPOT_TURNS_DEG = (90.0, -90.0, 150.0, -150.0, 30.0, -30.0, 180.0, 0.0, 120.0, -120.0, 60.0, -60.0)
"""Directions of the further spots as seen from a place, from that away from the pad: rows of holes lead away from
it, so beside them comes first."""
MOST_SPOTS = 4
STEEP_SIGMAS = 4.0
"""A touch of the face that is further from what was believed is asked for at another place: 0.006 % of good ones."""
HALFWAY_SIGMAS = 3.0
"""A face that is halfway further from a plane through that touch is no plane, or one of the touches is wrong."""


@dataclass(slots=True, eq=False)
class SurfacePlane:
    """A plane through everything that was touched of the face; `plane` is level where nothing was.

    `touched` holds x, y, height over the pad, and its standard uncertainty but for the reading of the pad, µm;
    `debris_um` by name of the place how high something lies on it; `doubt_u_um` is a standard uncertainty on top,
    since something contradicted it and until it is touched again.
    """

    plane: Plane
    tilt_u_mrad: float
    touched: list[SurfaceTouch] = field(default_factory=list)
    debris_um: dict[str, float] = field(default_factory=dict)
    doubt_u_um: float = 0.0
    _pad_step: Step | None = None

    def height_um(self, site: Place) -> float:
        """Return the height of the face at a place over the pad, positive away from the tool."""
        return self.plane.height_um(site.x_um, site.y_um)

    def height_u_um(self, site: Place) -> float:
        """Return the standard uncertainty of that."""
        return math.hypot(self.plane.height_u_um(site.x_um, site.y_um), self.doubt_u_um)

    def add(self, *touches: SurfaceTouch) -> None:
        """Take touches, and fit the plane anew."""
        self.touched += touches
        self.doubt_u_um = 0.0
        self._fit()

    def doubt(self, u_um: float) -> None:
        """Take the face and all touches of it to be less certain by a standard uncertainty."""
        self.doubt_u_um = math.hypot(self.doubt_u_um, u_um)
        self.touched = [(x_um, y_um, height, math.hypot(u, u_um)) for x_um, y_um, height, u in self.touched]
        if self.touched:
            self._fit()

    def restore(self, touched: Sequence[SurfaceTouch], doubt_u_um: float) -> None:
        """Take the touches and the doubt as they were before, or in an earlier run."""
        self.touched, self.doubt_u_um = list(touched), doubt_u_um
        if self.touched:
            self._fit()

    def set_pad_step(self, step: Step) -> None:
        """Take what two spots of the pad say of the slope, in place of what they said before."""
        self._pad_step = step
        self._fit()

    def _fit(self) -> None:
        self.plane = fitted_plane(
            self.plane.origin_um,
            [(x_um, y_um) for x_um, y_um, _, _ in self.touched],
            [height for _, _, height, _ in self.touched],
            [u for _, _, _, u in self.touched],
            self.tilt_u_mrad,
            [self._pad_step] if self._pad_step else [],
        )


def level_surface(run: JobRun) -> SurfacePlane:
    """Return the face before anything is touched: level around where the readings of the pad hold."""
    tilt_u_mrad = run.setup.surface.tilt_u_mrad
    return SurfacePlane(unknown_plane(pad_middle_um(run), tilt_u_mrad), tilt_u_mrad)


def fit_pad_slope(run: JobRun, surface: SurfacePlane, reading: SurfaceReading) -> SurfaceReading:
    """Take the slope from a reading of the pad whose spots differ by more than anybody believed; return it."""
    step = reading.step
    if step is None:
        return reading
    believed_um = 1e-3 * surface.tilt_u_mrad * math.hypot(*step.way_um)
    if abs(step.um) <= CONTRADICTION_SDS * math.hypot(believed_um, step.u_um()):
        return reading
    surface.set_pad_step(step)
    slope_x, slope_y = (float(1e3 * slope) for slope in surface.plane.slope)
    run.decide(
        RunEvent.FACE_FITTED,
        f"Two spots of the pad differ by {signed(step.um)} µm: the face slopes by {signed(slope_x)} mrad along x "
        f"and {signed(slope_y)} mrad along y, as far as they tell.",
        {"slope_x": 1e-3 * slope_x, "slope_y": 1e-3 * slope_y},
    )
    return reading


def touch_surface(run: JobRun, site: Place, surface: SurfacePlane, tool: ToolLength) -> None:
    """Touch the untouched face at a place; where it is steeper than anybody believed, halfway to the pad too."""
    before_u_um = surface.height_u_um(site)
    off, debris_um = _touch(run, site, surface, tool)
    if debris_um > 0.0:
        surface.debris_um[site.name] = debris_um
    if abs(off.sigmas) <= STEEP_SIGMAS:
        return
    pad = run.job.pad
    away = math.atan2(site.y_um - pad.y_um, site.x_um - pad.x_um)
    middle = Place(site.name, 0.5 * (site.x_um + pad.x_um), 0.5 * (site.y_um + pad.y_um), site.theta_deg)
    halfway, _ = _touch(run, beside(run, middle, away + math.radians(SPOT_TURNS_DEG[0])), surface, tool)
    message = (
        f"Zr at {site.name} is {signed(off.um)} µm from the face as it was known within {before_u_um:.2f} µm"
    )
    args: Args = {"kind": KIND, "off_um": off.um, "halfway_um": halfway.um, "site": site.name}
    if abs(halfway.sigmas) <= HALFWAY_SIGMAS:
        run.decide(RunEvent.FACE_FITTED, f"{message}; a touch halfway to the pad says so too.", args)
        return
    run.decide(
        RunEvent.TOUCH_DOUBTED,
        f"{message}; halfway to the pad the face lies {signed(halfway.um)} µm from that slope. Both stay in doubt.",
        args,
        level=EventLevel.WARNING,
    )
    surface.doubt(share_u(halfway.um))


def touch_beside(run: JobRun, site: Place, surface: SurfacePlane, tool: ToolLength) -> None:
    """Touch the face beside a place, where that itself may be cut into."""
    around = surface_spots(run, site)
    _touch(run, site, surface, tool, replace(around, places=around.places[1:]))


def _touch(
    run: JobRun, site: Place, surface: SurfacePlane, tool: ToolLength, spots: Spots | None = None
) -> tuple[Deviation, float]:
    """Touch the face at a place and take it in; how far it lies from what was known before, and what lies on it."""
    spots = spots or surface_spots(run, site)
    x_um, y_um = spots.middle_um(run.profile.measure.touches)
    predicted_um, face_u_um = (
        tool.pad_um + surface.plane.height_um(x_um, y_um),
        surface.plane.height_u_um(x_um, y_um),
    )
    drift_u_um_per_s = run.uncertainty.drift_u_um_per_s
    u_um = math.hypot(tool.u_um(run.machine.time_s, drift_u_um_per_s), face_u_um)
    reading = read_at_spots(run, KIND, site.name, spots, predicted_um, u_um)
    u_um = math.hypot(tool.u_um(reading.time_s, drift_u_um_per_s), reading.doubt_u_um)
    off = Deviation(reading.z_um - predicted_um, math.hypot(u_um, TOUCH_U_UM, face_u_um))
    surface.add((x_um, y_um, reading.z_um - tool.pad_um, u_um))
    return off, reading.debris_um


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


def touch_where_unknown(run: JobRun, site: Place, surface: SurfacePlane, tool: ToolLength) -> bool:
    """Touch the face at a place where tilt would limit the depth; whether that was done."""
    if surface.height_u_um(site) <= FACE_LIMIT_UM:
        return False
    touch_surface(run, site, surface, tool)
    return True


def touch_plane(run: JobRun, sites: Sequence[Place], surface: SurfacePlane, tool: ToolLength) -> None:
    """Touch the face at the sites that lie furthest apart, which tell its slope."""
    pad = run.job.pad
    chosen = spread_out([(site.x_um, site.y_um) for site in sites], (pad.x_um, pad.y_um), TOUCHES_FOR_A_PLANE)
    for i in chosen:
        touch_surface(run, sites[i], surface, tool)
    slope = surface.plane.slope
    run.decide(
        RunEvent.FACE_FITTED,
        f"The face slopes by {signed(1e3 * slope[0])} mrad along x and {signed(1e3 * slope[1])} mrad along y.",
        {"slope_x": float(slope[0]), "slope_y": float(slope[1])},
    )
