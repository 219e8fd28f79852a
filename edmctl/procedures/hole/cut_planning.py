"""Plan of a cut to a limit of the displacement, and expected lengths of a hole: by feed and energy, or by a journal.

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
from edmctl.planning.measuring import cut_budget, estimate_of
from edmctl.planning.removal import feed_rate_um_s
from edmctl.procedures.job import PERIOD_S, CutSums, CutTotals, HoleTarget, JobState, RunningCut, target_of
from edmctl.process.live_erosion import RECIPE_U_REL, Energy, ErosionEstimate, LiveErosion
from edmctl.process.next_cut import CLEAR_SIGMAS, largest_first_um, next_cut
from edmctl.process.touches import DepthAndWear, share_u
from edmctl.profile.model import Profile, Pulse
from edmctl.profile.places import Place
from edmctl.quantity import Value, half_width
from edmctl.results.job import SiteResult
from edmctl.wording import coordinates, with_u95

ARC_SHARE_OF_DISCHARGE_VOLTAGE = 0.77  # an arc burns at 17 V where a normal discharge burns at 22 V


@dataclass(frozen=True, slots=True)
class CutStart:
    """State at the start of a cut; `*_u_um` are standard uncertainties.

    The tool would touch the bottom at `bottom_um`, as measured at `time_s` and drifting since. `depth_um` and
    `wear_um` are those of the hole so far; `depth_u_um` excludes the bottom. `gap_um` is the expected working gap.
    """

    bottom_um: float
    bottom_u_um: float
    gap_um: float
    gap_u_um: float
    time_s: float = 0.0
    drift_u_um_per_s: float = 0.0
    depth_um: float = 0.0
    depth_u_um: float = 0.0
    wear_um: float = 0.0
    wear_u_um: float = 0.0

    def bottom_u_at(self, now_s: float) -> float:
        """Return the standard uncertainty of where the tool would touch the bottom, at a moment."""
        return math.hypot(self.bottom_u_um, self.drift_u_um_per_s * max(0.0, now_s - self.time_s))

    def u_at(self, now_s: float) -> float:
        """Return the standard uncertainty of a depth counted from the bottom at a moment, without working gap."""
        return math.hypot(self.bottom_u_at(now_s), self.depth_u_um)


@dataclass(frozen=True, slots=True, eq=False)
class CutPlan:
    """One cut of `feed_um` from `start`.

    `target_um` is the target depth of the hole (NaN for a feed), `measured` whether a measurement cycle follows,
    `depth_u_um` the standard uncertainty of the depth at its end.
    """

    number: int
    feed_um: float
    start: CutStart
    estimate: ErosionEstimate
    target_um: float = math.nan
    measured: bool = True
    depth_u_um: float = math.nan

    @property
    def z_limit_um(self) -> float:
        """Displacement at which the cut ends: a working gap above the bottom that it leaves."""
        return self.start.bottom_um + self.feed_um - self.start.gap_um

    def fed_um(self, displacement_um: float) -> float:
        """Return the feed of this cut while sparking at a displacement."""
        return max(0.0, displacement_um + self.start.gap_um - self.start.bottom_um)

    def at(self, displacement_um: float, energy: Energy | None = None, now_s: float = 0.0) -> LiveErosion:
        """Return depth and wear of the hole at a displacement; the uncertainty of the wear is of this cut alone."""
        split = self.estimate.split(self.fed_um(displacement_um), self.start.gap_u_um, energy)
        return LiveErosion(
            self.start.depth_um + split.depth_um,
            math.hypot(self.start.u_at(now_s), split.depth_u_um),
            self.start.wear_um + split.wear_um,
            split.wear_ratio_u_um,
            split.wear_own_u_um,
        )

    def stated(self, live: LiveErosion) -> tuple[Value, Value]:
        """Return depth and wear as displayed in a cut; until a touch confirms the recipe's ratio, with its error."""
        unconfirmed_um = 0.0
        if self.estimate.fits == 0:
            worn_um = live.wear_um - self.start.wear_um
            unconfirmed_um = RECIPE_U_REL * worn_um / (1.0 + self.estimate.wear_ratio)
        depth = Value(live.depth_um, math.hypot(live.depth_u_um, unconfirmed_um))
        wear_u_um = math.hypot(self.start.wear_u_um, live.wear_u_um, unconfirmed_um)
        return depth, Value(live.wear_um, wear_u_um)


def energy_of(pulse: Pulse, done: CutSums) -> Energy:
    """Divide the energy between normal discharges and arcs, which burn from the start of their pulse."""
    arc_uj = done.counts[2] * _full_pulse_uc(pulse, _arc_v(pulse)) * _arc_v(pulse)
    return Energy(max(0.0, 1e6 * done.energy_j - arc_uj), arc_uj)


def discharge_energy_j(pulse: Pulse, counts: tuple[int, int, int, int], charge_c: float) -> float:
    """Return the energy of pulses that passed a charge, J: arcs have a lower voltage, and shorts release none."""
    plateau_v, arc_v = pulse.discharge_voltage_v, _arc_v(pulse)
    excess_uj = counts[2] * _full_pulse_uc(pulse, arc_v) * (plateau_v - arc_v)
    excess_uj += counts[3] * _full_pulse_uc(pulse, 0.0) * plateau_v
    return plateau_v * charge_c - 1e-6 * excess_uj


def _arc_v(pulse: Pulse) -> float:
    return ARC_SHARE_OF_DISCHARGE_VOLTAGE * pulse.discharge_voltage_v


def _full_pulse_uc(pulse: Pulse, plateau_v: float) -> float:
    siemens = pulse.current_a / max(pulse.open_voltage_v - pulse.discharge_voltage_v, 0.1)
    return siemens * (pulse.open_voltage_v - plateau_v) * pulse.burning_time_us


def first_plan(
    profile: Profile,
    start: CutStart,
    target: HoleTarget | None = None,
    estimate: ErosionEstimate | None = None,
    now_s: float = 0.0,
) -> CutPlan:
    """Plan the first cut of a hole at `now_s`: all of a feed or way through, and less than a target depth."""
    target = target or target_of(profile)
    estimate = estimate or estimate_of(profile)
    if target.kind == "feed":
        return CutPlan(1, target.feed_um, start, estimate)
    if target.kind == "through":
        return through_plan(1, start, target, estimate)
    if cut_budget(profile) == 1:
        return CutPlan(1, target.depth_um * (1.0 + estimate.wear_ratio), start, estimate, target.depth_um)
    largest_um = largest_first_um(target.depth_um, profile.wear.first_fraction, estimate)
    return following_plan(profile, target, 1, start, estimate, begin_s=now_s, largest_um=largest_um)


def through_plan(number: int, start: CutStart, target: HoleTarget, estimate: ErosionEstimate) -> CutPlan:
    """Plan the rest of the way through a sheet, with room for a tool that wears more than the recipe expects."""
    worst = estimate.wear_ratio * (1.0 + (0.0 if estimate.fits else CLEAR_SIGMAS * RECIPE_U_REL))
    left_um = max(0.0, target.depth_um - start.depth_um) + target.tolerance_um
    return CutPlan(number, left_um * (1.0 + worst) + target.completion_um, start, estimate, target.depth_um)


def following_plan(
    profile: Profile,
    target: HoleTarget,
    number: int,
    start: CutStart,
    estimate: ErosionEstimate,
    *,
    begin_s: float | None = None,
    largest_um: float = math.inf,
    touch_final: bool = False,
) -> CutPlan:
    """Plan the next cut from `start`, which drifts until its end; `touch_final` measures it however small."""
    remaining_um = target.depth_um - start.depth_um
    cut_s = remaining_um * (1.0 + estimate.wear_ratio) / feed_rate_um_s(profile, target.depth_um)
    cut = next_cut(
        estimate,
        target_um=target.depth_um,
        remaining_um=remaining_um,
        tolerance_um=target.tolerance_um,
        start_u_um=start.u_at((start.time_s if begin_s is None else begin_s) + cut_s),
        gap_u_um=start.gap_u_um,
        largest_um=largest_um,
        begun=number > 1,
    )
    measured = touch_final or cut.measured or profile.wear.remeasure not in ("auto", "sparing")
    return CutPlan(number, cut.feed_um, start, estimate, target.depth_um, measured, cut.depth_u_um)


STANDARD_UNCERTAINTIES = 3.0
BELIEF_U_REL = 0.25  # relative u of an unconfirmed wear: three of them are a third to twice of it
FASTER = 2.0  # the last seconds may have cut this many times as fast as the hole on average
FASTEST = 5.0  # the same for the first seconds of a hole, relative to the recipe


NO_LENGTH = Value(0.0, 0.0)


def lengths(depth: Value = NO_LENGTH, wear: Value = NO_LENGTH, feed_u_um: float = 0.0) -> DepthAndWear:
    """Return estimated lengths; the feed has a standard uncertainty of its own."""
    return DepthAndWear(depth, wear, Value(depth.value + wear.value, feed_u_um), depth_noise_um=depth.u)


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
    depth = Value(known.depth_um, math.hypot(known.depth.u, u_um, unconfirmed_um))
    wear = Value(known.wear_um, math.hypot(known.wear.u, min(share, 1.0) * u_um, unconfirmed_um))
    return lengths(depth, wear, math.hypot(known.feed.u, u_um))


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
    depth, wear = Value(state.depth_um, state.depth_u_um), Value(state.wear_um, state.wear_u_um)
    return lengths(depth, wear, state.feed_u_um)


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
    return ExpectedHole(lengths(Value(site.depth_um, math.hypot(site.depth_u_um, unconfirmed_um))))


def estimate_in_cut(plan: CutPlan, displacement_um: float, energy: Energy, now_s: float) -> DepthAndWear:
    """Return the lengths during a cut, by feed and energy; no touch may have confirmed the wear ratio."""
    live, start = plan.at(displacement_um, energy, now_s), plan.start
    unconfirmed_um = BELIEF_U_REL * (live.wear_um - start.wear_um)
    share = plan.estimate.wear_ratio / (1.0 + plan.estimate.wear_ratio)
    wear_u_um = math.hypot(start.wear_u_um, live.wear_u_um, unconfirmed_um, share * start.bottom_u_at(now_s))
    depth = Value(live.depth_um, math.hypot(live.depth_u_um, unconfirmed_um))
    return lengths(depth, Value(live.wear_um, wear_u_um), math.hypot(start.u_at(now_s), start.gap_u_um))


def other_work(site: Place, found: DepthAndWear, expected: DepthAndWear, *, begun: bool) -> PreconditionError:
    """Return E8060: the touches found no hole of that depth."""
    otherwise = "For new work, order the places that are left as a job of their own."
    if begun:
        otherwise = "On untouched work, --restart-hole makes the hole from its face."
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
