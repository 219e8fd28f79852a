"""The way of the tool's axis along a channel."""

from __future__ import annotations

import math

from edmctl.process import path as ways
from edmctl.process.path import Way
from edmctl.profile.model import PathTable

PIECE_UM = 25.0
"""Longest line sent to the stages: the height of its end is planned anew for each."""


def way_of_path(path: PathTable) -> Way:
    """Way of the tool's axis of a `[path]` table, whose sizes the rules have found complete."""
    if path.kind == "rectangle":
        points = ways.rectangle(path.x_um, path.y_um, path.width_um or 0.0, path.height_um or 0.0)
    elif path.kind == "circle":
        points = ways.circle(path.x_um, path.y_um, path.radius_um or 0.0)
    else:
        inner_um, pitch_um = path.radius_um or 0.0, path.pitch_um or 0.0
        points = ways.spiral(path.x_um, path.y_um, inner_um, pitch_um, path.turns or 0.0)
    return ways.way_of(points, PIECE_UM)


def is_on_way(way: Way, here: tuple[float, float], within_um: float) -> bool:
    """Return whether a place of the stages is on the way, as exactly as its pieces tell."""
    nearest_um = min(math.dist(here, (float(x_um), float(y_um))) for x_um, y_um in way.points)
    return nearest_um <= 0.5 * PIECE_UM + within_um
