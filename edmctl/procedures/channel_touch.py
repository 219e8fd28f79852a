"""The touches of a channel: the face before it, floor and pad at every measuring stop, and what they teach."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from edmctl.procedures.channel_result import FloorPlace, FloorReading
from edmctl.procedures.face import pad_only, touch_plane
from edmctl.procedures.job import Site
from edmctl.procedures.pad import read_pad
from edmctl.procedures.planning import LARGEST_GAP_UM, SMALLEST_GAP_UM
from edmctl.procedures.stages import move_to
from edmctl.procedures.tool_length import ToolLength
from edmctl.procedures.touch import SurfaceReading, take_reading
from edmctl.process.path import Way, even_places

if TYPE_CHECKING:
    from edmctl.procedures.channel_scan import PassPlan, PassResult
    from edmctl.procedures.run import Run
    from edmctl.process.channel_wear import ToolWear
    from edmctl.process.plane import Plane

FACE_CANDIDATES = 24
"""Places of the path among which those for the plane are chosen."""
OFFSET_U_UM = 3.5
"""Standard uncertainty of the distance to the untouched face before the first touch."""
FLOOR_U_UM = 1.0
"""The same of the floor before it is touched: gap and unevenness."""
PAD_U_SHARE = 0.15
"""Of the wear since the last touch of the pad."""


@dataclass(frozen=True, slots=True, eq=False)
class Face:
    """The untouched face: the pad before the channel, and a plane through it and places of the path."""

    z1: SurfaceReading
    plane: Plane


def touch_untouched(run: Run, way: Way) -> Face:
    """Z1 at the pad, then the face at places of the path: its tilt would otherwise enter the floor."""
    expected_um = run.ledger.home_um + run.profile.approach.offset_um
    z1 = read_pad(run, "Z1", run.profile.meta.name, expected_um, OFFSET_U_UM)
    candidates = [_place(run, way, s_um) for s_um in even_places(way, FACE_CANDIDATES)]
    face = pad_only(run)
    touch_plane(run, candidates, face, ToolLength(z1))
    return Face(z1, face.plane)


def measure_floor(
    run: Run, face: Face, plan: PassPlan, _done: PassResult, wear: ToolWear, since_uj: float, places: int
) -> FloorReading:
    """Touch the pad, the floor at places along the path of the pass just done, and the pad again.

    `since_uj` is the wearing energy since the pad was touched last. Between the two readings of the pad its height
    is interpolated: the sensor drifts by as much in these minutes as the floor may be uneven.
    """
    wear_um = wear.um(since_uj)
    pad_u_um = PAD_U_SHARE * wear.per_uj * since_uj
    before = _touch_pad(run, face.z1.z_um + wear_um, pad_u_um)
    touched: list[tuple[float, Site, SurfaceReading]] = []
    for s_um in even_places(plan.way, places):
        place = _place(run, plan.way, s_um)
        height_um = plan.held.floor_um((place.x_um, place.y_um), 0.0) - plan.held.pad_um
        predicted_um = before.z_um + height_um
        move_to(run, place)
        touched.append((s_um, place, take_reading(run, "Z2", place.name, predicted_um, FLOOR_U_UM)))
    after = _touch_pad(run, before.z_um, 0.0)
    floor = tuple(
        FloorPlace(s_um, place.x_um, place.y_um, z2.z_um - _face_at(place, z2, before, after, face))
        for s_um, place, z2 in touched
    )
    return FloorReading(floor, tuple(z2 for _, _, z2 in touched), before, after)


def _touch_pad(run: Run, predicted_um: float, pad_u_um: float) -> SurfaceReading:
    return read_pad(run, "Z3", run.profile.meta.name, predicted_um, pad_u_um)


def _face_at(
    place: Site, z2: SurfaceReading, before: SurfaceReading, after: SurfaceReading, face: Face
) -> float:
    """Where the tool would have met the untouched face at a place, when it touched there."""
    share = (z2.time_s - before.time_s) / (after.time_s - before.time_s)
    pad_um = before.z_um + share * (after.z_um - before.z_um)
    return pad_um + face.plane.height_um(place.x_um, place.y_um)


def learned_gap_um(plan: PassPlan, done: PassResult, found: FloorReading, wear: ToolWear) -> float:
    """Mean gap that a pass left between the held tool and the floor, by the wear per energy as now known.

    The tool that touches is shorter than the one that scanned there, by the wear of the rest of the pass.
    """
    gaps_um = []
    for place, z2 in zip(found.places, found.floor, strict=True):
        held_um = float(np.interp(place.s_um, plan.way.lengths_um, done.limits_um))
        used_uj = float(np.interp(place.s_um, plan.way.lengths_um, done.used_uj))
        gaps_um.append(z2.z_um - held_um - wear.per_uj * (done.wearing_uj - used_uj))
    return min(max(math.fsum(gaps_um) / len(gaps_um), SMALLEST_GAP_UM), LARGEST_GAP_UM)


def _place(run: Run, way: Way, s_um: float) -> Site:
    x_um, y_um = way.at(s_um)
    return Site(f"{s_um:.0f} µm along the path", x_um, y_um)
