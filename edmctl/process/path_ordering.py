"""The way from place to place."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

Point = tuple[float, float]


def nearest_first(places_um: Sequence[Point], start_um: Point) -> tuple[int, ...]:
    """Order of places in which the nearest of those left always comes next; ties go to the one written first."""
    left = list(range(len(places_um)))
    order: list[int] = []
    here = start_um
    while left:
        nearest = min(left, key=lambda i: math.dist(places_um[i], here))
        left.remove(nearest)
        order.append(nearest)
        here = places_um[nearest]
    return tuple(order)


def spread_out(places_um: Sequence[Point], start_um: Point, count: int) -> tuple[int, ...]:
    """Return `count` places far from the start and from each other, as a plane is fitted best through such."""
    chosen: list[int] = []
    known = [start_um]
    while len(chosen) < min(count, len(places_um)):
        left = [i for i in range(len(places_um)) if i not in chosen]
        best = max(left, key=lambda i: min(math.dist(places_um[i], place) for place in known))
        chosen.append(best)
        known.append(places_um[best])
    return tuple(chosen)
