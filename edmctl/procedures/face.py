"""The face of the work as it was touched: at places that were not machined yet, relative to the pad."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from edmctl.procedures.codes import RunEvent
from edmctl.procedures.drift import uncertainty_now
from edmctl.procedures.stages import move_to
from edmctl.procedures.tool_length import TOUCH_U_UM
from edmctl.procedures.touch import take_reading
from edmctl.process.plane import TOUCHES_FOR_A_PLANE, Plane, fitted_plane, unknown_plane
from edmctl.process.tour import spread_out

if TYPE_CHECKING:
    from collections.abc import Sequence

    from edmctl.procedures.job import Site
    from edmctl.procedures.journal import FaceTouch
    from edmctl.procedures.run import Run
    from edmctl.procedures.tool_length import ToolLength

KIND = "Zr"
"""What such a touch is called in the run file: the face at a place that is not machined yet."""
TILT_LIMIT_UM = 2.0 * TOUCH_U_UM
"""A face whose height is known worse than this at a place is touched there before the hole: a touch knows it better,
and at 0.3 mrad it takes a millimetre to get there."""


@dataclass(slots=True, eq=False)
class Face:
    """A plane through everything that was touched of the face; `plane` is level where nothing was.

    `touched` holds x, y, height over the pad, and its standard uncertainty but for the reading of the pad, µm.
    """

    plane: Plane
    tilt_u_mrad: float
    touched: list[FaceTouch] = field(default_factory=list)

    def height_um(self, site: Site) -> float:
        """Height of the face at a place over the pad, positive away from the tool."""
        return self.plane.height_um(site.x_um, site.y_um)

    def height_u_um(self, site: Site) -> float:
        """Standard uncertainty of that."""
        return self.plane.height_u_um(site.x_um, site.y_um)

    def add(self, *touches: FaceTouch) -> None:
        """Take touches, and fit the plane anew."""
        self.touched += touches
        self.plane = fitted_plane(
            self.plane.origin_um,
            [(x_um, y_um) for x_um, y_um, _, _ in self.touched],
            [height for _, _, height, _ in self.touched],
            [u for _, _, _, u in self.touched],
            self.tilt_u_mrad,
        )


def pad_only(run: Run) -> Face:
    """Return the face as the pad's reading alone tells it."""
    pad, tilt_u_mrad = run.job.pad, run.setup.surface.tilt_u_mrad
    return Face(unknown_plane((pad.x_um, pad.y_um), tilt_u_mrad), tilt_u_mrad)


def touch_at(run: Run, site: Site, face: Face, tool: ToolLength) -> None:
    """Touch the untouched face at a place."""
    move_to(run, site)
    predicted_um = tool.pad_um + face.height_um(site)
    drift_u_um_per_s = uncertainty_now(run).drift_u_um_per_s
    u_um = math.hypot(tool.u_um(run.machine.time_s, drift_u_um_per_s), face.height_u_um(site))
    reading = take_reading(run, KIND, site.name, predicted_um, u_um)
    u_um = tool.u_um(reading.time_s, drift_u_um_per_s)
    face.add((site.x_um, site.y_um, reading.z_um - tool.pad_um, u_um))


def touch_where_unknown(run: Run, site: Site, face: Face, tool: ToolLength) -> bool:
    """Touch the face at a place where tilt would limit the depth; whether that was done."""
    if face.height_u_um(site) <= TILT_LIMIT_UM:
        return False
    touch_at(run, site, face, tool)
    return True


def touch_plane(run: Run, sites: Sequence[Site], face: Face, tool: ToolLength) -> None:
    """Touch the face at the sites that lie furthest apart, which tell its slope."""
    pad = run.job.pad
    chosen = spread_out([(site.x_um, site.y_um) for site in sites], (pad.x_um, pad.y_um), TOUCHES_FOR_A_PLANE)
    for i in chosen:
        touch_at(run, sites[i], face, tool)
    slope = face.plane.slope
    run.decide(
        RunEvent.FACE_FITTED,
        f"The face slopes by {1e3 * slope[0]:+.2f} mrad along x and {1e3 * slope[1]:+.2f} mrad along y.",
        {"slope_x": float(slope[0]), "slope_y": float(slope[1])},
    )
