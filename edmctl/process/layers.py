"""A channel by layers: how deep each goes, how many passes it takes, where the tool is held.

The tool has no feed of its own while it scans: it is held at a height that sinks as the tool wears, so that the
floor of a layer comes out even (the uniform wear method of milling with round tools, Yu, Masuzawa & Fujino 1998).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from edmctl.process.plane import Plane

LEAST_LAYER_SHARE = 0.05
"""A rest below this share of a layer is no layer of its own."""


@dataclass(frozen=True, slots=True)
class HeldTool:
    """Where the tool is held to leave a floor `depth_um` below the face.

    `pad_um` is where the unworn tool met the face at the plane's origin, `gap_um` the gap that a scan leaves
    between the held tool and the floor.
    """

    pad_um: float
    plane: Plane
    depth_um: float
    gap_um: float

    def z_um(self, place_um: tuple[float, float], wear_um: float) -> float:
        """Displacement at a place of the stages, of a tool that lost `wear_um` of its length."""
        return self.floor_um(place_um, wear_um) - self.gap_um

    def floor_um(self, place_um: tuple[float, float], wear_um: float) -> float:
        """Displacement at which that tool would touch the floor."""
        return self.pad_um + self.plane.height_um(*place_um) + wear_um + self.depth_um


def layer_depths_um(from_um: float, to_um: float, layer_um: float) -> tuple[float, ...]:
    """Depths of equal layers of at most `layer_um` between two depths, the last being `to_um`; none upwards."""
    rest_um = to_um - from_um
    if rest_um <= 0.0:
        return ()
    n = max(1, math.ceil(rest_um / layer_um - LEAST_LAYER_SHARE))
    return tuple(from_um + rest_um * i / n for i in range(1, n + 1))


def channel_width_um(diameter_um: float, side_gap_um: float) -> float:
    """Width of the channel that a round tool makes, µm: the side gap on both sides."""
    return diameter_um + 2.0 * side_gap_um


def passes_needed(layer_um: float, width_um: float, speed_um_s: float, removal_um3_s: float) -> int:
    """Passes at this speed in which the sparks can remove a layer."""
    return max(1, math.ceil(layer_um * width_um * speed_um_s / removal_um3_s))
