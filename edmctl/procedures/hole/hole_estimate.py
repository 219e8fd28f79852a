"""Expected lengths of a hole by feed and energy, or by a journal.

A resumed hole is compared by three lengths, because each mistake leaves one of them unchanged. Another workpiece has
another depth. Another tool has another wear and feed. A wrong wear ratio moves depth and wear against each other and
leaves the feed. A length is refused beyond three standard uncertainties of the difference, 0.3 % of the good ones;
on the deeper side the cut after the last journal entry is added.
"""

from __future__ import annotations

import math

from edmctl import failures
from edmctl.dataclasses import dataclass, replace
from edmctl.errors import PreconditionError, stages_by_hand
from edmctl.planning.removal import feed_rate_um_s
from edmctl.procedures.hole.cut_planning import CutPlan
from edmctl.procedures.job import PERIOD_S, CutTotals, JobState, RunningCut
from edmctl.process.live_erosion import RECIPE_U_REL, Energy
from edmctl.process.next_cut import CLEAR_SIGMAS
from edmctl.process.touches import DepthAndWear, share_u
from edmctl.profile.model import Profile
from edmctl.profile.places import Place
from edmctl.quantity import Value, half_width
from edmctl.results.job import SiteResult
from edmctl.wording import coordinates, with_u95

STANDARD_UNCERTAINTIES = 3.0
BELIEF_U_REL = 0.25
"""Relative standard uncertainty of a wear that no touch has confirmed: three of them allow from a third to twice the
expected wear."""
FASTER = 2.0  # the last seconds may have cut this many times as fast as the hole on average
FASTEST = 5.0  # the same for the first seconds of a hole, relative to the recipe


def lengths(
    depth_um: float = 0.0,
    depth_u_um: float = 0.0,
    wear_um: float = 0.0,
    wear_u_um: float = 0.0,
    feed_u_um: float = 0.0,
) -> DepthAndWear:
    """Return estimated lengths with their standard uncertainties, µm."""
    return DepthAndWear(
        depth=Value(depth_um, depth_u_um),
        wear=Value(wear_um, wear_u_um),
        feed=Value(depth_um + wear_um, feed_u_um),
        depth_noise_um=depth_u_um,
    )


def with_unseen(
    known: DepthAndWear, unseen_um: float, wear_ratio: float, *, is_confirmed: bool
) -> DepthAndWear:
    """Return the lengths of a hole after up to `unseen_um` more of feed, any part of it as likely.

    Unless a touch `is_confirmed` the recipe alone divides the feed. `wear_ratio` is the expected wear per depth of a
    hole without any depth yet.
    """
    u_um = share_u(unseen_um)
    ratio = known.wear_um / known.depth_um if known.depth_um > 0.0 else wear_ratio
    share, unconfirmed_um = ratio / (1.0 + ratio), 0.0
    if not is_confirmed:
        share *= 1.0 + CLEAR_SIGMAS * RECIPE_U_REL
        unconfirmed_um = RECIPE_U_REL * known.wear_um
    return lengths(
        known.depth_um,
        math.hypot(known.depth.u, u_um, unconfirmed_um),
        known.wear_um,
        math.hypot(known.wear.u, min(share, 1.0) * u_um, unconfirmed_um),
        math.hypot(known.feed.u, u_um),
    )


@dataclass(frozen=True, slots=True)
class ExpectedHole:
    """Estimated lengths, and how much more may have been cut since they were recorded."""

    estimate: DepthAndWear
    unseen_um: float = 0.0

    def reach_um(self, length: Value) -> float:
        """Return how far from its estimate a length may be, before the uncertainty of the touches."""
        return STANDARD_UNCERTAINTIES * length.u + self.unseen_um

    @property
    def depth_reach_um(self) -> float:
        """How far the depth may be from its estimate."""
        return self.reach_um(self.estimate.depth)

    def depth_fits(self, found: DepthAndWear) -> bool:
        """Return whether this can be the hole."""
        return self._fits(self.estimate.depth, found.depth)

    def tool_fits(self, found: DepthAndWear) -> bool:
        """Return whether this can be the tool that made it."""
        return self.wear_fits(found) and self._fits(self.estimate.feed, found.feed)

    def wear_fits(self, found: DepthAndWear) -> bool:
        """Return the same by the wear alone, if the hole has no bottom."""
        return self._fits(self.estimate.wear, found.wear)

    def through_at_most(self, thickness_um: float) -> ExpectedHole:
        """Return the same for a hole through a sheet: behind it the tool neither cuts nor wears."""
        known = self.estimate
        if known.depth_um <= thickness_um:
            return self
        wear_um = known.wear_um * thickness_um / known.depth_um
        depth, wear = replace(known.depth, value=thickness_um), replace(known.wear, value=wear_um)
        return replace(self, estimate=replace(known, depth=depth, wear=wear))

    def _fits(self, expected: Value, found: Value) -> bool:
        reach_um = STANDARD_UNCERTAINTIES * math.hypot(expected.u, found.u)
        return -reach_um <= found.value - expected.value <= reach_um + self.unseen_um


def with_cuts(
    state: JobState, cut: RunningCut, before: CutTotals, cuts: int, estimate: DepthAndWear
) -> JobState:
    """Return the state of a job with a cut or pass under way after others, and the estimated lengths."""
    total = before.plus(cut)
    return replace(
        state,
        displacement_um=0.0 if math.isnan(cut.displacement_um) else cut.displacement_um,
        depth_um=estimate.depth_um,
        depth_u_um=estimate.depth.u,
        wear_um=estimate.wear_um,
        wear_u_um=estimate.wear.u,
        feed_u_um=estimate.feed.u,
        cuts=cuts,
        counts=total.counts,
        energy_j=total.energy_j,
        machining_time_s=total.time_s,
    )


def is_untouched(found: DepthAndWear) -> bool:
    """Return whether the touches found the workpiece surface and no hole."""
    return abs(found.depth_um) <= STANDARD_UNCERTAINTIES * found.depth.u


def estimate_left(state: JobState) -> DepthAndWear:
    """Return the lengths as the journal has them."""
    return lengths(state.depth_um, state.depth_u_um, state.wear_um, state.wear_u_um, state.feed_u_um)


def expected_of_left(state: JobState, profile: Profile) -> ExpectedHole:
    """Return what to expect of the hole that an earlier run left."""
    left = estimate_left(state)
    return ExpectedHole(left, PERIOD_S * most_um_s(left, state.machining_time_s, profile))


def most_um_s(estimate: DepthAndWear, machining_time_s: float, profile: Profile) -> float:
    """Return the highest feed rate that the last seconds may have had."""
    by_recipe_um_s = feed_rate_um_s(profile, 0.0)
    if machining_time_s < PERIOD_S:
        return FASTEST * by_recipe_um_s
    return FASTER * max((estimate.depth_um + estimate.wear_um) / machining_time_s, by_recipe_um_s)


def expected_of_finished(site: SiteResult) -> ExpectedHole:
    """Return what to expect of a finished hole: nothing was cut after its result."""
    unconfirmed_um = 0.0
    if site.estimated_um and site.depth_um > 0.0:
        unconfirmed_um = BELIEF_U_REL * site.wear_um * site.estimated_um / site.depth_um
    return ExpectedHole(lengths(site.depth_um, math.hypot(site.depth_u_um, unconfirmed_um)))


def estimate_in_cut(plan: CutPlan, displacement_um: float, energy: Energy, now_s: float) -> DepthAndWear:
    """Return the lengths during a cut, by feed and energy; no touch may have confirmed the wear ratio."""
    live, start = plan.at(displacement_um, energy, now_s), plan.start
    unconfirmed_um = BELIEF_U_REL * (live.wear_um - start.wear_um)
    share = plan.wear_ratio / (1.0 + plan.wear_ratio)
    return lengths(
        live.depth_um,
        math.hypot(live.depth_u_um, unconfirmed_um),
        live.wear_um,
        math.hypot(start.wear_u_um, live.wear_u_um, unconfirmed_um, share * start.bottom_u_at(now_s)),
        math.hypot(start.u_at(now_s), plan.start.gap_u_um),
    )


def other_work(site: Place, found: DepthAndWear, expected: DepthAndWear, *, begun: bool) -> PreconditionError:
    """Return E8060: the touches found no hole of that depth."""
    if begun:
        otherwise = "On untouched work, --restart-hole makes the hole from its face."
    else:
        otherwise = "For new work, order the places that are left as a job of their own."
    return failures.depth_contradicts_journal(
        site=site.name,
        place=coordinates(site.x_um, site.y_um),
        depth_um=with_u95(found.depth_um, found.depth.u95),
        expected_um=with_u95(expected.depth_um, half_width(expected.depth.u)),
        otherwise=otherwise,
        stages_by_hand=stages_by_hand(),
    )


def other_tool(found: DepthAndWear, expected: DepthAndWear) -> PreconditionError:
    """Return E8061: the hole is that deep, but the tool is not as long as it was left."""
    return failures.wear_contradicts_journal(
        wear_um=with_u95(found.wear_um, found.wear.u95),
        expected_um=with_u95(expected.wear_um, half_width(expected.wear.u)),
    )
