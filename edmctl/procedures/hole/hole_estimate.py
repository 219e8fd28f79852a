"""What a journal makes the touches of a hole expect, and whether a hole that was touched can be that one.

Three lengths are compared, because each mistake spares one of them. Other work has another depth. Another tool has
another wear and feed. A wear ratio that was believed and is wrong moves depth and wear against each other and leaves
the feed. A found length is refused beyond three standard uncertainties of the difference, 0.3 % of the good ones; on
the deeper side what was cut after the journal was written is added.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from edmctl.dataclasses import dataclass, replace
from edmctl.errors import PreconditionError, stages_by_hand
from edmctl.planning.removal import feed_rate_um_s
from edmctl.procedures.job_state import PERIOD_S, JobState
from edmctl.process.live_erosion import RECIPE_U_REL, Energy
from edmctl.process.next_cut import CLEAR_SIGMAS
from edmctl.process.touches import DepthAndWear, share_u
from edmctl.quantity import Value, half_width
from edmctl.results.job import SiteResult
from edmctl.wording import coordinates, with_u95

if TYPE_CHECKING:
    from edmctl.procedures.hole.cut_planning import CutPlan
    from edmctl.profile.model import Profile
    from edmctl.profile.places import Place

STANDARD_UNCERTAINTIES = 3.0
BELIEF_U_REL = 0.25
"""Standard uncertainty of a wear that no touch has confirmed: three of them hold a tool that wears a third as much
as was believed, and one that wears twice as much."""
FASTER = 2.0
"""The last seconds may have cut so many times as fast as the hole on average."""
FASTEST = 5.0
"""The first seconds of a hole: work that erodes so many times as fast as the recipe believes."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """Depth and wear of a hole as far as they are known, µm, with standard uncertainties of both and of the feed."""

    depth_um: float = 0.0
    depth_u_um: float = 0.0
    wear_um: float = 0.0
    wear_u_um: float = 0.0
    feed_u_um: float = 0.0

    def left(self, unseen_um: float, wear_ratio: float, *, touched: bool) -> Estimate:
        """Return the same of a hole that was left: up to `unseen_um` more may have been fed, any of it as likely.

        Where no hole was `touched` before, the recipe alone says how the feed divides. `wear_ratio` is the wear per
        depth that is believed, for a hole that shows none yet.
        """
        u_um = share_u(unseen_um)
        ratio = self.wear_um / self.depth_um if self.depth_um > 0.0 else wear_ratio
        share, believed_um = ratio / (1.0 + ratio), 0.0
        if not touched:
            share *= 1.0 + CLEAR_SIGMAS * RECIPE_U_REL
            believed_um = RECIPE_U_REL * self.wear_um
        return replace(
            self,
            depth_u_um=math.hypot(self.depth_u_um, u_um, believed_um),
            wear_u_um=math.hypot(self.wear_u_um, min(share, 1.0) * u_um, believed_um),
            feed_u_um=math.hypot(self.feed_u_um, u_um),
        )

    def as_found(self) -> DepthAndWear:
        """Return the same as if it had been measured."""
        return DepthAndWear(
            depth=Value(self.depth_um, self.depth_u_um),
            wear=Value(self.wear_um, self.wear_u_um),
            feed=Value(self.depth_um + self.wear_um, self.feed_u_um),
            depth_noise_um=self.depth_u_um,
        )


@dataclass(frozen=True, slots=True)
class ExpectedHole:
    """An estimate, and how much more may have been cut since it was written down."""

    estimate: Estimate
    unseen_um: float = 0.0

    @property
    def depth_reach_um(self) -> float:
        """How far from the estimate a depth may be, but for the touches that tell it."""
        return STANDARD_UNCERTAINTIES * self.estimate.depth_u_um + self.unseen_um

    @property
    def wear_reach_um(self) -> float:
        """Likewise of a wear."""
        return STANDARD_UNCERTAINTIES * self.estimate.wear_u_um + self.unseen_um

    @property
    def feed_reach_um(self) -> float:
        """Likewise of a feed, depth and wear together."""
        return STANDARD_UNCERTAINTIES * self.estimate.feed_u_um + self.unseen_um

    def depth_fits(self, found: DepthAndWear) -> bool:
        """Return whether this can be the hole."""
        estimate = self.estimate
        return self._fits(found.depth_um - estimate.depth_um, estimate.depth_u_um, found.depth.u)

    def tool_fits(self, found: DepthAndWear) -> bool:
        """Return whether this can be the tool that made it, where it was left."""
        estimate = self.estimate
        more_um = found.feed_um - estimate.depth_um - estimate.wear_um
        return self.wear_fits(found) and self._fits(more_um, estimate.feed_u_um, found.feed.u)

    def wear_fits(self, found: DepthAndWear) -> bool:
        """Return the same by the wear alone, where no bottom tells of the feed."""
        estimate = self.estimate
        return self._fits(found.wear_um - estimate.wear_um, estimate.wear_u_um, found.wear.u)

    def through_at_most(self, thickness_um: float) -> ExpectedHole:
        """Return the same of a hole through a sheet: behind it the tool is fed on and neither cuts nor wears."""
        estimate = self.estimate
        if estimate.depth_um <= thickness_um:
            return self
        wear_um = estimate.wear_um * thickness_um / estimate.depth_um
        return replace(self, estimate=replace(estimate, depth_um=thickness_um, wear_um=wear_um))

    def _fits(self, more_um: float, known_u_um: float, found_u_um: float) -> bool:
        reach_um = STANDARD_UNCERTAINTIES * math.hypot(known_u_um, found_u_um)
        return -reach_um <= more_um <= reach_um + self.unseen_um


def is_untouched(found: DepthAndWear) -> bool:
    """Return whether touches found a face and no hole."""
    return abs(found.depth_um) <= STANDARD_UNCERTAINTIES * found.depth.u


def expected_of_left(state: JobState, profile: Profile) -> ExpectedHole:
    """Return what to expect of the hole that was left."""
    left = estimate_left(state)
    return ExpectedHole(left, PERIOD_S * most_um_s(left, state.machining_time_s, profile))


def most_um_s(estimate: Estimate, machining_time_s: float, profile: Profile) -> float:
    """Return the most that the last seconds may have fed."""
    by_recipe_um_s = feed_rate_um_s(profile, 0.0)
    if machining_time_s < PERIOD_S:
        return FASTEST * by_recipe_um_s
    return FASTER * max((estimate.depth_um + estimate.wear_um) / machining_time_s, by_recipe_um_s)


def expected_of_finished(site: SiteResult) -> ExpectedHole:
    """Return what to expect of a hole that was finished: nothing was cut after its result."""
    believed_um = 0.0
    if site.estimated_um and site.depth_um > 0.0:
        believed_um = BELIEF_U_REL * site.wear_um * site.estimated_um / site.depth_um
    depth_u_um = math.hypot(site.depth_u_um, believed_um)
    return ExpectedHole(Estimate(site.depth_um, depth_u_um))


def estimate_in_cut(plan: CutPlan, displacement_um: float, energy: Energy, now_s: float) -> Estimate:
    """In a cut at a moment, by feed and energy; nothing may have confirmed the ratio that divides the feed."""
    live, start = plan.at(displacement_um, energy, now_s), plan.start
    believed_um = BELIEF_U_REL * (live.wear_um - start.wear_um)
    share = plan.wear_ratio / (1.0 + plan.wear_ratio)
    return Estimate(
        live.depth_um,
        math.hypot(live.depth_u_um, believed_um),
        live.wear_um,
        math.hypot(start.wear_u_um, live.wear_u_um, believed_um, share * start.bottom_u_at(now_s)),
        math.hypot(start.u_at(now_s), plan.start.gap_u_um),
    )


def estimate_touched(found: DepthAndWear) -> Estimate:
    """After the touches of a measuring stop."""
    return Estimate(
        found.depth_um,
        found.depth.u,
        found.wear_um,
        found.wear.u,
        found.feed.u,
    )


def estimate_left(state: JobState) -> Estimate:
    """As the run before wrote it down."""
    return Estimate(state.depth_um, state.depth_u_um, state.wear_um, state.wear_u_um, state.feed_u_um)


def other_work(site: Place, found: DepthAndWear, expected: Estimate, *, begun: bool) -> PreconditionError:
    """Return E8060: the touches found no hole of that depth."""
    if begun:
        otherwise = "On untouched work, --restart-hole makes the hole from its face."
    else:
        otherwise = "For new work, order the places that are left as a job of their own."
    return PreconditionError(
        f"{site.name} at {coordinates(site.x_um, site.y_um)} is "
        f"{with_u95(found.depth_um, found.depth.u95)} µm deep; the journal expects "
        f"{with_u95(expected.depth_um, half_width(expected.depth_u_um))} µm.",
        hint=f"Put the workpiece back as it was. {otherwise} {stages_by_hand()}",
        code="E8060",
    )


def other_tool(found: DepthAndWear, expected: Estimate) -> PreconditionError:
    """Return E8061: the hole is that deep, but the tool is not as long as it was left."""
    return PreconditionError(
        f"The tool is {with_u95(found.wear_um, found.wear.u95)} µm shorter than before the hole; the journal "
        f"expects {with_u95(expected.wear_um, half_width(expected.wear_u_um))} µm.",
        hint="It was changed or seated anew, and only the tool that began a hole can tell its own wear by touching. "
        "Machine another hole, at another place.",
        code="E8061",
    )


def hole_found(site: Place, found: DepthAndWear) -> PreconditionError:
    """Return E8062: there is a hole where one is to be begun."""
    return PreconditionError(
        f"There is no untouched face at {site.name}: it is {with_u95(found.depth_um, found.depth.u95)} µm deep.",
        hint="Go on with the hole without --restart-hole, or put untouched work in.",
        code="E8062",
    )
