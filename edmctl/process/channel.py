"""A channel by layers: the way along it, the depth of each, the height of the held tool, and its wear.

The tool has no feed of its own while it scans: it is held at a height that sinks as the tool wears, so that the
floor of a layer comes out even (the uniform wear method of milling with round tools, Yu, Masuzawa & Fujino 1998).
A channel wears its tool by as much as it is deep, or more, so a wear per length from the recipe alone would tilt
every floor. Wear follows the discharge energy; how far is learned at every touch of the pad.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from edmctl.array_types import Array
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


@dataclass(slots=True)
class ToolWear:
    """Length that a scanning tool has lost, µm: measured at the last touch, estimated by energy since then.

    per_uj, u_rel : wear length per wearing energy, µm/µJ, and its relative standard uncertainty
    touch_u_um : standard uncertainty of one measured wear
    measured_um : wear at the last touch
    """

    per_uj: float
    u_rel: float
    touch_u_um: float
    measured_um: float = 0.0

    def um(self, since_uj: float) -> float:
        """Wear after `since_uj` of wearing energy since the last touch."""
        return self.measured_um + self.per_uj * since_uj

    def u_um(self, since_uj: float) -> float:
        """Standard uncertainty of that."""
        return math.hypot(self.touch_u_um, self.u_rel * self.per_uj * since_uj)

    def restart(self, wear_um: float) -> None:
        """Start from a measured wear without the wear per energy."""
        self.measured_um = wear_um

    def learn(self, since_uj: float, wear_um: float, drift_u_um: float) -> None:
        """Learn from a measured wear: one Kalman step on the wear per energy, and a new start.

        `drift_u_um` is the possible drift since the last one, which makes the rate uncertain. A wear further from
        its expectation than chance allows widens the prior by the excess.
        """
        expected_um = self.per_uj * since_uj
        if expected_um > 0.0:
            grown_um = wear_um - self.measured_um
            noise_um = math.hypot(math.sqrt(2.0) * self.touch_u_um, drift_u_um)
            prior_um = math.hypot(self.u_rel, SCATTER_U_REL) * expected_um
            wrong_um = (grown_um - expected_um) / WIDENING_SDS
            prior_um = max(prior_um, math.sqrt(max(0.0, wrong_um**2 - noise_um**2)))
            gain = prior_um**2 / (prior_um**2 + noise_um**2)
            self.per_uj = max(0.0, self.per_uj * (1.0 + gain * (grown_um - expected_um) / expected_um))
            self.u_rel = math.sqrt(1.0 - gain) * prior_um / expected_um
        self.measured_um = wear_um


CHORD_UM = 20.0
"""Curves are cut into pieces about so long: at a radius of 300 µm a chord lies 0.2 µm beside its arc."""


def rectangle(x_um: float, y_um: float, width_um: float, height_um: float) -> Array:
    """Closed rectangle about a centre, shape (5, 2), beginning and ending at its lower left corner."""
    signs = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0)])
    return np.array([x_um, y_um]) + signs * (width_um / 2.0, height_um / 2.0)


def circle(x_um: float, y_um: float, radius_um: float) -> Array:
    """Closed circle about a centre, shape (n + 1, 2), beginning and ending on the x axis."""
    return spiral(x_um, y_um, radius_um, pitch_um=0.0, turns=1.0)


def spiral(x_um: float, y_um: float, inner_um: float, pitch_um: float, turns: float) -> Array:
    """Spiral of Archimedes from the inner radius outwards, shape (n + 1, 2), beginning on the x axis."""
    mean_radius_um = inner_um + 0.5 * pitch_um * turns
    n = max(8, math.ceil(2.0 * math.pi * mean_radius_um * turns / CHORD_UM))
    angles = 2.0 * math.pi * turns * np.arange(n + 1) / n
    radii = inner_um + pitch_um * angles / (2.0 * math.pi)
    return np.column_stack([x_um + radii * np.cos(angles), y_um + radii * np.sin(angles)])


def lengths_um(points: Array) -> Array:
    """Way from the first point to each, shape (n,), for points of shape (n, 2)."""
    steps = np.hypot(*np.diff(points, axis=0).T)
    return np.concatenate([[0.0], np.cumsum(steps)])


@dataclass(frozen=True, slots=True, eq=False)
class Way:
    """A way through points of shape (n, 2), with the length up to each, shape (n,), µm."""

    points: Array
    lengths_um: Array

    @property
    def length_um(self) -> float:
        """The whole length."""
        return float(self.lengths_um[-1])

    @property
    def closed(self) -> bool:
        """Whether the end is the beginning."""
        return bool(np.hypot(*(self.points[-1] - self.points[0])) < 1e-6 * self.length_um)

    def at(self, s_um: float) -> tuple[float, float]:
        """Place in the plane after a length from the beginning, µm."""
        x_um = np.interp(s_um, self.lengths_um, self.points[:, 0])
        y_um = np.interp(s_um, self.lengths_um, self.points[:, 1])
        return float(x_um), float(y_um)

    def length_at(self, x_um: float, y_um: float, near_um: float, within_um: float) -> float:
        """Length from the beginning to the nearest place of the way that is within a length of `near_um`.

        A way that comes by the same place twice is so followed on the right lap.
        """
        low_um, high_um = near_um - within_um, near_um + within_um
        first = max(0, int(np.searchsorted(self.lengths_um, low_um, "right")) - 1)
        last = min(len(self.points) - 1, int(np.searchsorted(self.lengths_um, high_um)))
        starts = self.points[first:last]
        steps = self.points[first + 1 : last + 1] - starts
        spans_um = np.diff(self.lengths_um[first : last + 1])
        off = np.array([x_um, y_um]) - starts
        shares = np.clip((off * steps).sum(axis=1) / spans_um**2, 0.0, 1.0)
        found_um = np.clip(self.lengths_um[first:last] + shares * spans_um, low_um, high_um)
        away = off - steps * ((found_um - self.lengths_um[first:last]) / spans_um)[:, None]
        return float(found_um[int(np.argmin(np.hypot(*away.T)))])

    def reversed(self) -> Way:
        """The same way from its end to its beginning."""
        return Way(self.points[::-1], self.length_um - self.lengths_um[::-1])


def way_of(points: Array, longest_um: float) -> Way:
    """Way through points of shape (n, 2), its straight lines cut into equal pieces of at most `longest_um`."""
    pieces = [points[:1]]
    for start, end in pairwise(points):
        n = max(1, math.ceil(float(np.hypot(*(end - start))) / longest_um - 1e-9))
        pieces.append(start + (end - start) * (np.arange(1, n + 1) / n)[:, None])
    whole = np.concatenate(pieces)
    return Way(whole, lengths_um(whole))


def even_places(way: Way, number: int) -> tuple[float, ...]:
    """Lengths along the way of `number` places at equal distances, half of one from both ends."""
    return tuple(way.length_um * (i + 0.5) / number for i in range(number))
