"""A channel by layers: how deep each goes, where the tool is held, and how it wears between two touches.

The tool has no feed of its own while it scans: it is held at a height that sinks as the tool wears, so that the
floor of a layer comes out even (the uniform wear method of milling with round tools, Yu, Masuzawa & Fujino 1998).
A channel wears its tool by as much as it is deep, or more, so a wear per length from the recipe alone would tilt
every floor. Wear follows the discharge energy; how far is learned at every touch of the pad.
"""

from __future__ import annotations

import math

from edmctl.dataclasses import dataclass
from edmctl.process.live_erosion import ARC_REMOVAL, ARC_WEAR, WIDENING_SDS, Energy
from edmctl.process.plane import Plane

LEAST_LAYER_SHARE = 0.05  # a rest below this share of a layer is no layer of its own
SCATTER_U_REL = 0.02  # relative standard deviation of the wear per energy from one stop to the next [assumed]


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


def wearing_uj(energy: Energy) -> float:
    """Energy of normal discharges that would wear the tool as much, µJ."""
    return energy.normal_uj + ARC_REMOVAL * ARC_WEAR * energy.arc_uj


class ToolWear:
    """Length that a scanning tool has lost, µm: measured at the last touch, estimated by energy since then.

    Parameters
    ----------
    per_uj, u_rel : wear length per wearing energy, µm/µJ, and its relative standard uncertainty
    touch_u_um : standard uncertainty of one measured wear
    """

    def __init__(self, per_uj: float, u_rel: float, touch_u_um: float) -> None:
        self.per_uj = per_uj
        self.u_rel = u_rel
        self._touch_u_um = touch_u_um
        self._measured_um = 0.0

    def um(self, since_uj: float) -> float:
        """Wear after `since_uj` of wearing energy since the last touch."""
        return self._measured_um + self.per_uj * since_uj

    def u_um(self, since_uj: float) -> float:
        """Standard uncertainty of that."""
        return math.hypot(self._touch_u_um, self.u_rel * self.per_uj * since_uj)

    def restart(self, wear_um: float) -> None:
        """Begin anew from a measured wear that says nothing of the wear per energy."""
        self._measured_um = wear_um

    def learn(self, since_uj: float, wear_um: float, drift_u_um: float) -> None:
        """Learn from a measured wear: one Kalman step on the wear per energy, and a new start.

        `drift_u_um` is the possible drift since the last one, which makes the rate uncertain. A wear further from
        its expectation than chance allows widens the prior by the excess.
        """
        expected_um = self.per_uj * since_uj
        if expected_um > 0.0:
            grown_um = wear_um - self._measured_um
            noise_um = math.hypot(math.sqrt(2.0) * self._touch_u_um, drift_u_um)
            prior_um = math.hypot(self.u_rel, SCATTER_U_REL) * expected_um
            wrong_um = (grown_um - expected_um) / WIDENING_SDS
            prior_um = max(prior_um, math.sqrt(max(0.0, wrong_um**2 - noise_um**2)))
            gain = prior_um**2 / (prior_um**2 + noise_um**2)
            self.per_uj = max(0.0, self.per_uj * (1.0 + gain * (grown_um - expected_um) / expected_um))
            self.u_rel = math.sqrt(1.0 - gain) * prior_um / expected_um
        self._measured_um = wear_um
