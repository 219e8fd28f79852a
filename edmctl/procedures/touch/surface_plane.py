"""The plane of the workpiece surface, by touches at places that were not machined yet, relative to the pad."""

from __future__ import annotations

import math
from collections.abc import Sequence

from edmctl.dataclasses import replace
from edmctl.procedures.job import SurfaceTouch
from edmctl.procedures.run import Args, JobRun
from edmctl.procedures.touch.reading import SurfaceReading
from edmctl.procedures.touch.spots import Spots, ToolLength, beside, pad_spots, read_at_spots
from edmctl.process.plane import (
    CONTRADICTION_SDS,
    TOUCHES_FOR_A_PLANE,
    Step,
    fitted_plane,
    spread_out,
    unknown_plane,
)
from edmctl.process.touches import TOUCH_U_UM, Deviation, share_u
from edmctl.profile.places import Place
from edmctl.record.rows import RunEvent
from edmctl.wording import signed

KIND = "Zr"  # name of such a touch in the run file
SPOT_TURNS_DEG = (90.0, -90.0, 150.0, -150.0, 30.0, -30.0, 180.0, 0.0, 120.0, -120.0, 60.0, -60.0)
"""Directions of the further spots of a place, from the direction away from the pad: rows of holes lead away from it,
so beside them comes first."""
MOST_SPOTS = 4
STEEP_SIGMAS = 4.0
"""A touch further from the expected surface is repeated at another place: 0.006 % of good ones."""
HALFWAY_SIGMAS = 3.0
"""If the surface halfway is further from a plane through that touch, it is no plane, or a touch is wrong."""


class SurfacePlane:
    """A plane through all touches of the workpiece surface; level around the pad readings before the first.

    `touched` has x, y, height over the pad and its standard uncertainty without that of the pad, µm. `debris_um` is
    the height of what lies on the surface, by name of the place. `doubt_u_um` is a standard uncertainty on top since
    something contradicted the plane, until it is touched again.
    """

    def __init__(self, run: JobRun) -> None:
        self._run = run
        self._tilt_u_mrad = run.setup.surface.tilt_u_mrad
        middle_um = Spots("pad", pad_spots(run)).middle_um(run.profile.measure.touches)
        self.plane = unknown_plane(middle_um, self._tilt_u_mrad)
        self.touched: list[SurfaceTouch] = []
        self.debris_um: dict[str, float] = {}
        self.doubt_u_um = 0.0
        self._pad_step: Step | None = None

    def height_um(self, site: Place) -> float:
        """Return the height of the surface at a place over the pad, positive away from the tool."""
        return self.plane.height_um(site.x_um, site.y_um)

    def height_u_um(self, site: Place) -> float:
        """Return the standard uncertainty of that."""
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
        """Keep the touches in the journal."""
        keeper = self._run.keeper
        keeper.surface, keeper.surface_doubt_u_um = tuple(self.touched), self.doubt_u_um

    def fit_pad_slope(self, reading: SurfaceReading) -> None:
        """Take the slope from a reading of the pad whose spots differ by more than the expected tilt."""
        step = reading.step
        if step is None:
            return
        expected_um = 1e-3 * self._tilt_u_mrad * math.hypot(*step.way_um)
        if abs(step.um) <= CONTRADICTION_SDS * math.hypot(expected_um, step.u_um()):
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
        before_u_um = self.height_u_um(site)
        off, debris_um = self._touch(surface_spots(self._run, site), site.name, tool)
        if debris_um > 0.0:
            self.debris_um[site.name] = debris_um
        if abs(off.sigmas) <= STEEP_SIGMAS:
            return
        pad = self._run.job.pad
        away = math.atan2(site.y_um - pad.y_um, site.x_um - pad.x_um)
        middle = Place(site.name, 0.5 * (site.x_um + pad.x_um), 0.5 * (site.y_um + pad.y_um), site.theta_deg)
        spot = beside(self._run, middle, away + math.radians(SPOT_TURNS_DEG[0]))
        halfway, _ = self._touch(surface_spots(self._run, spot), site.name, tool)
        known = f"as it was known within {before_u_um:.2f} µm"
        message = f"Zr at {site.name} is {signed(off.um)} µm from the face {known}"
        args: Args = {"kind": KIND, "off_um": off.um, "halfway_um": halfway.um, "site": site.name}
        if abs(halfway.sigmas) <= HALFWAY_SIGMAS:
            self._run.decide(
                RunEvent.FACE_FITTED, f"{message}; a touch halfway to the pad says so too.", args
            )
            return
        self._run.warn(
            RunEvent.TOUCH_DOUBTED,
            f"{message}; halfway to the pad the face lies {signed(halfway.um)} µm from that slope. Both stay in "
            "doubt.",
            args,
        )
        self.doubt(share_u(halfway.um))

    def touch_beside(self, site: Place, tool: ToolLength) -> None:
        """Touch the surface beside a place that may be machined."""
        around = surface_spots(self._run, site)
        self._touch(replace(around, places=around.places[1:]), site.name, tool)

    def touch_plane(self, sites: Sequence[Place], tool: ToolLength) -> None:
        """Touch the surface at the sites that are furthest apart."""
        pad = self._run.job.pad
        places = [(site.x_um, site.y_um) for site in sites]
        for i in spread_out(places, (pad.x_um, pad.y_um), TOUCHES_FOR_A_PLANE):
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
        self.plane = fitted_plane(
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
