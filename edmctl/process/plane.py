"""The workpiece surface as a plane through touched places, and the choice of these places."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from edmctl.array_types import Array
from edmctl.dataclasses import dataclass
from edmctl.process.touches import TOUCH_CHECK_SD_UM

TOUCHES_FOR_A_PLANE = 3
CONTRADICTION_SDS = 2.0
"""A face that slopes by more standard deviations than this is not the one that was believed in."""


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """Heights relative to an origin: `slope` (2,) in µm/µm, and the covariance of both slopes.

    `origin_um` is where the height is 0.
    """

    origin_um: tuple[float, float]
    slope: Array
    covariance: Array

    def height_um(self, x_um: float, y_um: float) -> float:
        """Height over the origin's, positive away from the tool, µm."""
        return float(self.slope @ self._way(x_um, y_um))

    def height_u_um(self, x_um: float, y_um: float) -> float:
        """Standard uncertainty of that height, µm."""
        way = self._way(x_um, y_um)
        return float(np.sqrt(way @ self.covariance @ way))

    def _way(self, x_um: float, y_um: float) -> Array:
        return np.array([x_um - self.origin_um[0], y_um - self.origin_um[1]])


@dataclass(frozen=True, slots=True)
class Step:
    """How much further one place of a surface lies than another, µm, with `touches` at the two.

    `way_um` leads to it from the other; `sensed_u_um` is the standard uncertainty beside the scatter of the touches.
    """

    way_um: tuple[float, float]
    um: float
    touches: tuple[int, int]
    sensed_u_um: float = 0.0

    def u_um(self, touch_u_um: float = TOUCH_CHECK_SD_UM) -> float:
        """Standard uncertainty, with that of one touch."""
        return math.hypot(touch_u_um * math.sqrt(math.fsum(1.0 / n for n in self.touches)), self.sensed_u_um)


def unknown_plane(origin_um: tuple[float, float], tilt_u_mrad: float) -> Plane:
    """Return a surface that was touched at one place only: level, with uncertain slopes."""
    return Plane(origin_um, np.zeros(2), np.eye(2) * (1e-3 * tilt_u_mrad) ** 2)


def fitted_plane(
    origin_um: tuple[float, float],
    places_um: Sequence[tuple[float, float]],
    heights_um: Sequence[float],
    touch_u_um: float | Sequence[float],
    tilt_u_mrad: float,
    steps: Sequence[Step] = (),
) -> Plane:
    """Fit a plane to heights of places over that of the origin, with one standard uncertainty or each its own.

    The heights share the error of the origin, which is that of the best place; `steps` have errors of their own. The
    prior of the tilt bounds the slope across a line of places; a slope beyond `CONTRADICTION_SDS` of it widens it.
    """
    ways = np.asarray(places_um, dtype=np.float64).reshape(-1, 2) - np.asarray(origin_um)
    heights = np.asarray(heights_um, dtype=np.float64)
    count = len(heights)
    own_u = np.broadcast_to(np.asarray(touch_u_um, dtype=np.float64), (count,))
    noise = np.diag(own_u**2) + own_u.min(initial=np.inf) ** 2 * np.ones((count, count))
    weights = np.linalg.inv(noise)
    information, sums = ways.T @ weights @ ways, ways.T @ weights @ heights
    for step in steps:
        way = np.asarray(step.way_um) / step.u_um()
        information, sums = information + np.outer(way, way), sums + way * step.um / step.u_um()
    for _ in range(2):
        prior = np.eye(2) / (1e-3 * tilt_u_mrad) ** 2 if tilt_u_mrad > 0.0 else np.eye(2) * 1e18
        covariance = np.linalg.inv(information + prior)
        slope = covariance @ sums
        found_mrad = 1e3 * float(np.hypot(*slope))
        if tilt_u_mrad <= 0.0 or found_mrad <= CONTRADICTION_SDS * tilt_u_mrad:
            break
        tilt_u_mrad = found_mrad
    return Plane(origin_um, slope, covariance)


def spread_out(
    places_um: Sequence[tuple[float, float]], start_um: tuple[float, float], count: int
) -> tuple[int, ...]:
    """Return `count` places far from the start and from each other, as a plane is fitted best through such."""
    chosen: list[int] = []
    known = [start_um]
    while len(chosen) < min(count, len(places_um)):
        left = [i for i in range(len(places_um)) if i not in chosen]
        best = max(left, key=lambda i: min(math.dist(places_um[i], place) for place in known))
        chosen.append(best)
        known.append(places_um[best])
    return tuple(chosen)
