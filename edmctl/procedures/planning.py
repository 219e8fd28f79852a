"""Where a cut ends: from a feed wanted below a known surface to a limit of the tool's displacement."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from edmctl.process.next_cut import first_feed_um

if TYPE_CHECKING:
    from edmctl.process.wear import DepthAndWear
    from edmctl.profile.model import Profile

SMALLEST_GAP_UM = 0.5
LARGEST_GAP_UM = 20.0


@dataclass(frozen=True, slots=True)
class CutPlan:
    """One cut. The tool stops at `z_limit_um`; it would touch the old bottom at `bottom_um`.

    `depth_before_um` and `wear_before_um` are what has been measured so far, `gap_um` the working gap and
    `wear_ratio` the wear per depth that are expected.
    """

    number: int
    feed_um: float
    bottom_um: float
    gap_um: float
    wear_ratio: float
    depth_before_um: float
    wear_before_um: float

    @property
    def z_limit_um(self) -> float:
        """Displacement at which the cut ends: a working gap short of where the tool will touch afterwards."""
        return self.bottom_um + self.feed_um - self.gap_um

    def depth_at(self, displacement_um: float) -> float:
        """Estimated depth while sparking at this displacement, from the expected gap and wear ratio."""
        sunk_um = max(0.0, displacement_um + self.gap_um - self.bottom_um)
        return self.depth_before_um + sunk_um / (1.0 + self.wear_ratio)

    def wear_at(self, displacement_um: float) -> float:
        """Estimated tool wear likewise."""
        return self.wear_before_um + self.wear_ratio * (self.depth_at(displacement_um) - self.depth_before_um)


def first_plan(profile: Profile, surface_um: float) -> CutPlan:
    """The first cut below a surface touched at `surface_um`: all of a feed target, part of a depth."""
    target, wear = profile.target, profile.wear
    if target.kind == "feed":
        feed_um = target.feed_um
    else:
        fraction = 1.0 if cut_budget(profile) == 1 else wear.first_fraction
        feed_um = first_feed_um(target.depth_um, wear.expected_ratio, fraction)
    return CutPlan(
        number=1,
        feed_um=feed_um,
        bottom_um=surface_um,
        gap_um=profile.measure.expected_gap_um,
        wear_ratio=wear.expected_ratio,
        depth_before_um=0.0,
        wear_before_um=0.0,
    )


def following_plan(
    last: CutPlan, feed_um: float, bottom_um: float, gap_um: float, found: DepthAndWear
) -> CutPlan:
    """The next cut, `feed_um` below the bottom just touched, with the gap and wear ratio just learned."""
    return CutPlan(
        number=last.number + 1,
        feed_um=feed_um,
        bottom_um=bottom_um,
        gap_um=gap_um,
        wear_ratio=max(0.0, found.wear_ratio),
        depth_before_um=found.depth_um,
        wear_before_um=found.wear_um,
    )


def learned_gap_um(bottom_um: float, end_displacement_um: float) -> float:
    """The working gap: how much further the tool goes to touch than it went to spark."""
    return min(max(bottom_um - end_displacement_um, SMALLEST_GAP_UM), LARGEST_GAP_UM)


def cut_budget(profile: Profile) -> int:
    """How many cuts the recipe allows: one for a feed target or without remeasuring."""
    wear = profile.wear
    if profile.target.kind == "feed" or wear.remeasure == "never":
        return 1
    if wear.remeasure == "auto":
        return wear.max_cuts
    return min(wear.remeasure + 1, wear.max_cuts)
