"""Ways of the tool's axis in the plane of the stages, as points on them."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from edmctl.array_types import Array
from edmctl.dataclasses import dataclass

CHORD_UM = 20.0
"""Curves are cut into pieces about so long: at a radius of 300 µm a chord lies 0.2 µm beside its arc."""


def rectangle(x_um: float, y_um: float, width_um: float, height_um: float) -> Array:
    """Closed rectangle about a centre, shape (5, 2), beginning and ending at its lower left corner."""
    half_w, half_h = width_um / 2.0, height_um / 2.0
    corners = [(-half_w, -half_h), (half_w, -half_h), (half_w, half_h), (-half_w, half_h), (-half_w, -half_h)]
    return np.array([(x_um + dx, y_um + dy) for dx, dy in corners])


def circle(x_um: float, y_um: float, radius_um: float) -> Array:
    """Closed circle about a centre, shape (n + 1, 2), beginning and ending on the x axis."""
    n = max(8, math.ceil(2.0 * math.pi * radius_um / CHORD_UM))
    angles = 2.0 * math.pi * np.arange(n + 1) / n
    return np.column_stack([x_um + radius_um * np.cos(angles), y_um + radius_um * np.sin(angles)])


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
