"""What one hole is to become: a depth, a feed, or a way through the sheet."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from edmctl.labels import Verdict

if TYPE_CHECKING:
    from edmctl.profile.model import Profile
    from edmctl.profile.places import Place

THROUGH_TOLERANCE_UM = 5.0
"""Of the sheet's thickness: a sheet that breaks through so much earlier or later is the sheet that was meant."""


@dataclass(frozen=True, slots=True)
class HoleTarget:
    """The objective of a hole. `depth_um` is NaN for a feed, `feed_um` for a depth.

    Of a way through, `depth_um` is the sheet's thickness and `completion_um` the feed after the breakthrough.
    """

    kind: str
    depth_um: float
    feed_um: float
    tolerance_um: float
    completion_um: float = 0.0

    def __str__(self) -> str:
        if self.kind == "feed":
            return f"a feed of {self.feed_um:g} µm"
        if self.kind == "through":
            return f"a hole through {self.depth_um:g} µm"
        return f"a depth of {self.depth_um:g} µm"

    def reached(self, depth_um: float, feed_um: float) -> str:
        """Return what was reached of it, in words."""
        if self.kind == "feed":
            return f"a feed of {feed_um:.2f} of {self.feed_um:g} µm"
        return f"a depth of {depth_um:.2f} of {self.depth_um:g} µm"


def target_of(profile: Profile, place: Place | None = None) -> HoleTarget:
    """Return the target of a hole: the depth of its own place, or the recipe's."""
    target = profile.target
    if target.kind == "feed":
        return HoleTarget("feed", math.nan, target.feed_um, math.nan)
    if target.kind == "through":
        half_um = profile.tool.diameter_um / 2.0
        completion_um = half_um if target.completion_um is None else target.completion_um
        return HoleTarget("through", profile.work.thickness_um, math.nan, THROUGH_TOLERANCE_UM, completion_um)
    depth_um = target.depth_um if place is None or math.isnan(place.depth_um) else place.depth_um
    return HoleTarget("depth", depth_um, math.nan, target.tolerance_um)


def verdict_of(target: HoleTarget, depth_um: float, depth_u95_um: float, *, through: bool) -> Verdict | None:
    """Judge a depth with half its 95 % interval; a way through by whether it goes `through`, a feed not at all."""
    if target.kind == "feed":
        return None
    if target.kind == "through":
        return Verdict.SHOWN if through else Verdict.MISSED
    if not abs(depth_um - target.depth_um) <= target.tolerance_um:
        return Verdict.MISSED
    return Verdict.SHOWN if depth_u95_um <= target.tolerance_um else Verdict.NOT_SHOWN
