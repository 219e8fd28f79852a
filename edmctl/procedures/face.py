"""The face of the work between the places of an array: a plane through three touches, relative to the pad."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from edmctl.procedures.codes import RunEvent
from edmctl.procedures.stages import move_to
from edmctl.procedures.tool_length import TOUCH_U_UM
from edmctl.procedures.touch import take_reading
from edmctl.process.plane import TOUCHES_FOR_A_PLANE, Plane, fitted_plane, unknown_plane
from edmctl.process.tour import spread_out

if TYPE_CHECKING:
    from collections.abc import Sequence

    from edmctl.procedures.job import Site
    from edmctl.procedures.run import Run
    from edmctl.procedures.tool_length import ToolLength

KIND = "Zr"
"""What such a touch is called in the run file: the face at a place that is not machined yet."""


def pad_only(run: Run) -> Plane:
    """Return the face as the pad's reading alone tells it."""
    pad = run.job.pad
    return unknown_plane((pad.x_um, pad.y_um), run.setup.surface.tilt_u_mrad)


def touch_face(run: Run, sites: Sequence[Site], tool: ToolLength) -> Plane:
    """Touch the untouched face at the sites that lie furthest apart, and fit a plane through them and the pad."""
    pad = run.job.pad
    origin_um = (pad.x_um, pad.y_um)
    places_um = [(site.x_um, site.y_um) for site in sites]
    chosen = spread_out(places_um, origin_um, TOUCHES_FOR_A_PLANE)
    tilt_u = 1e-3 * run.setup.surface.tilt_u_mrad
    heights_um: list[float] = []
    for i in chosen:
        move_to(run, sites[i])
        away_um = math.dist(places_um[i], origin_um)
        reading = take_reading(run, KIND, sites[i].name, tool.pad_um, tilt_u * away_um)
        heights_um.append(reading.z_um - tool.pad_um)
    plane = fitted_plane(
        origin_um, [places_um[i] for i in chosen], heights_um, TOUCH_U_UM, run.setup.surface.tilt_u_mrad
    )
    run.decide(
        RunEvent.FACE_FITTED,
        f"The face slopes by {1e3 * plane.slope[0]:+.2f} mrad along x and {1e3 * plane.slope[1]:+.2f} mrad along y.",
        {"slope_x": float(plane.slope[0]), "slope_y": float(plane.slope[1])},
    )
    return plane
