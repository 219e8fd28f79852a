"""One hole: approach, cut, and measure as often as its target requires; the end of a hole through the sheet."""

from __future__ import annotations

import math
from dataclasses import replace

from edmctl.errors import MachineFault
from edmctl.labels import Basis, marked
from edmctl.planning.measuring import estimate_of
from edmctl.planning.removal import recipes_of
from edmctl.procedures.hole import decision as decisions
from edmctl.procedures.hole.cut import Cut, CutEnd, CutResult
from edmctl.procedures.hole.cut_planning import CutPlan, energy_of, first_plan, following_plan
from edmctl.procedures.hole.decision import Decision
from edmctl.procedures.hole.hole import Hole
from edmctl.procedures.hole.knowledge import FirstSparkCheck, JobKnowledge, first_gap
from edmctl.procedures.job import RegimeBegun
from edmctl.procedures.run import Args, JobRun
from edmctl.procedures.servo.limits import TimeLimits
from edmctl.procedures.settings import pulse_settings
from edmctl.procedures.stages import move_to
from edmctl.procedures.touch.approach import CLEAR_OF_BOTTOM_UM, approach_bottom, raise_by, read_expected
from edmctl.procedures.touch.reading import NO_CONTACT, SurfaceReading, search_near, take_reading_in
from edmctl.procedures.touch.surfaces import ToolLength, read_pad, refuse_grown_tool, rest_before_pad
from edmctl.process.live_erosion import CONTRADICTION_SDS, LEAST_RATIO, Energy, ErosionEstimate
from edmctl.process.next_cut import GAP_U_UM
from edmctl.process.shared_wear import SharedWear
from edmctl.process.touches import DepthAndWear, Deviation, share_u
from edmctl.profile.model import Profile
from edmctl.quantity import Value
from edmctl.record.rows import RunEvent
from edmctl.wording import decimal, length, signed

PAD_U_UM = 0.5  # standard uncertainty of the pad's place besides the wear: drift and touch scatter
GAP_SETTLES_S = 1.0  # a shorter cut shows no working gap: its first sparks come 1 µm earlier
UNFINISHED_GAP_U_UM = 3.0  # u of the gap of a cut that did not reach its limit: the servo swings [assumed]


class HoleProcedure:
    """Machines one hole: cuts, measures and decides. `knowledge` is shared by the holes of a job."""

    def __init__(self, run: JobRun, hole: Hole, knowledge: JobKnowledge, limits: TimeLimits) -> None:
        self._run, self._hole, self._knowledge, self._limits = run, hole, knowledge, limits
        self._sparks = FirstSparkCheck(run, hole, knowledge)

    def machine(self, *, is_last: bool = True) -> Decision:
        """Machine the hole from its untouched surface; the last hole of a job also measures those before it."""
        run, hole = self._run, self._hole
        start = self._knowledge.first_start(hole)
        plan = first_plan(run.profile, start, hole.target, hole.estimate, run.machine.time_s)
        return self.cut_to_the_end(replace(plan, measured=True) if is_last else plan)

    def cut_to_the_end(self, plan: CutPlan) -> Decision:
        """Cut and measure until a decision plans nothing more."""
        decision = self._cut(plan)
        while decision.plan is not None:
            decision = self._cut(decision.plan)
        decisions.close_site(self._run, settled=not self._knowledge.unmeasured)
        return decision

    def _cut(self, plan: CutPlan) -> Decision:
        run, hole = self._run, self._hole
        if self._limits.left().seconds <= 0.0:
            return self._no_time(plan)
        move_to(run, hole.site)
        bottom_u_um = plan.start.bottom_u_at(run.machine.time_s)
        reach_u_um = math.hypot(bottom_u_um, 0.5 * self._sparks.debris_um)
        sparks = approach_bottom(run, plan.start.bottom_um, reach_u_um)
        plan = self._sparks.checked(plan, sparks.displacement_um, bottom_u_um)
        left = self._limits.left()
        if left.seconds <= 0.0:  # the approach sparks too
            return self._no_time(plan)
        machined_before_s = run.tally.machining_time_s
        run.tally.unmeasured_site = hole.site.name
        hole.start_cut(plan)
        cut = Cut(run, plan, left).run()
        hole.end_cut(cut)
        end_um = cut.end_displacement_um
        run.tally.machining_time_s = machined_before_s + cut.time_s
        run.tally.depth_um = math.nan if cut.through else plan.at(end_um).depth_um
        if hole.target.kind == "through":
            return self._end_through(plan, cut)
        is_early = cut.end is not CutEnd.REACHED or end_um < plan.z_limit_um
        # The feed may not explain the energy either.
        energy = self._energy(cut)
        is_surprising = plan.estimate.contradicts(plan.fed_um(end_um), plan.start.gap_u_um, energy)
        # Another regime begins from a measured bottom.
        regime_follows = run.regime + 1 < len(run.job.profile.regimes)
        if plan.measured or regime_follows or is_early or is_surprising:
            return self._measure(plan, cut)
        return self._estimate(plan, cut)

    def _no_time(self, plan: CutPlan) -> Decision:
        start, limit = plan.start, self._limits.left().limit
        reached = self._hole.target.reached(start.depth_um, start.depth_um + start.wear_um)
        message = f" No time is left for cut {plan.number}: {limit}; the job ends at {reached}."
        decision = decisions.missed_by_fault("TIMEOUT", message)
        args: Args = {"cut": plan.number, "depth_um": start.depth_um, "hint": decision.hint}
        self._run.warn(RunEvent.TARGET_MISSED, decision.message, args)
        return decision

    def _energy(self, cut: CutResult) -> Energy:
        return energy_of(self._run.profile.pulse, cut)

    def _measure(self, plan: CutPlan, cut: CutResult) -> Decision:
        knowledge, hole = self._knowledge, self._hole
        raise_by(self._run, CLEAR_OF_BOTTOM_UM)
        unfinished_u_um = 0.0 if cut.is_at_limit else UNFINISHED_GAP_U_UM
        gap = Value(plan.start.gap_um, plan.start.gap_u_um)
        gap_u_um = math.hypot(gap.u, unfinished_u_um)
        end_um, source = cut.end_displacement_um, "the last sparks"
        z2 = read_expected(self._run, hole.site.name, end_um, gap.value, gap_u_um, source)
        z3 = self._read_pad(plan, cut)
        if cut.time_s >= GAP_SETTLES_S:
            gap = Value(z2.z_um - cut.end_displacement_um, math.hypot(GAP_U_UM, unfinished_u_um))
            if cut.is_at_limit and z2.doubt_u_um == 0.0:
                self._sparks.judge_again(gap.value)
        shared = None
        if knowledge.unmeasured:
            live = plan.at(cut.end_displacement_um, self._energy(cut))
            shared = knowledge.share_wear(hole, z3, plan, cut, live)
        found = self._learn(z2, z3, gap, shared)
        if plan.number == 1:
            decisions.refuse_wrong_setup(self._run, hole.touched or found)
        return self._decide(plan.number, cut, found)

    def _read_pad(self, plan: CutPlan, cut: CutResult, more_u_um: float = 0.0) -> SurfaceReading:
        """Touch the pad with the worn tool (Z3). `more_u_um` is an additional standard uncertainty."""
        run, hole = self._run, self._hole
        live = plan.at(cut.end_displacement_um, self._energy(cut))
        u_um = math.hypot(PAD_U_UM, live.wear_u_um, hole.z1_u_um, more_u_um)
        expected_um = hole.z1.z_um + live.wear_um + hole.drift_um
        # A recipe that no touch has confirmed may be wrong by more than it states.
        deepest_um = expected_um + plan.stated(live)[1].u95
        rest_before_pad(run, hole.z1)
        z3 = read_pad(run, "Z3", hole.site.name, expected_um, u_um, deepest_um)
        before_u_um = math.hypot(hole.z1_u_um, hole.z1.doubt_u_um)
        refuse_grown_tool(run, hole.z1.z_um, z3, z3.time_s - hole.z1.time_s, before_u_um)
        return z3

    def _learn(
        self, z2: SurfaceReading, z3: SurfaceReading, gap: Value, shared: SharedWear | None = None
    ) -> DepthAndWear:
        """Take the readings of a measurement cycle; return the lengths. `shared` is the wear of several holes."""
        hole, knowledge = self._hole, self._knowledge
        touched = hole.measured(z2, z3)
        if shared is None:
            stated = self._with_doubt_of_wear(touched)
        else:
            # The part of the drift in the uncertainty is unknown for one of several holes.
            wear = Value(shared.wear_um, shared.wear_u_um)
            stated = touched = replace(touched, wear=wear, drift_left_u_um=math.nan)
        hole.take_stop(z2, z3, touched)
        is_doubted = z2.doubt_u_um > 0.0
        hole.report(stated, gap.value, depth_basis=Basis.ESTIMATED if is_doubted else None)
        knowledge.pads.append(z3)
        knowledge.tool = ToolLength(z3)
        knowledge.gap = Value(gap.value, math.hypot(gap.u, z2.doubt_u_um))
        if is_doubted:
            return stated
        learned = hole.learned()
        # A first stop that contradicts the recipe may be confirmed by the next one.
        is_confirmed = shared is None and hole.stops - hole.regime.stops > 1 and stated is touched
        knowledge.estimate = learned.confirmed() if is_confirmed else learned
        return stated

    def _with_doubt_of_wear(self, found: DepthAndWear) -> DepthAndWear:
        """Widen a result whose wear is unexpected, until another measurement cycle agrees with it.

        A tool that wears differently and debris on the tool look alike. The truth may be anywhere between
        expectation and touch; a tool that seems too long also makes the hole seem too deep. Debris that stays on the
        tool, and a surface that was misread before, shift the feed by as much.
        """
        estimate, before = self._knowledge.estimate, self._hole.touched
        before_depth_um, before_wear = (before.depth_um, before.wear) if before else (0.0, Value(0.0, 0.0))
        added_um = estimate.wear_ratio * max(0.0, found.depth_um - before_depth_um)
        off = Deviation(
            found.wear_um - before_wear.value - added_um,
            math.hypot(estimate.wear_ratio_u_rel * added_um, before_wear.u, found.wear.u),
        )
        if abs(off.sigmas) <= CONTRADICTION_SDS:
            return found
        u_um = share_u(off.um)
        self._run.warn(
            RunEvent.TOUCH_DOUBTED,
            f"The wear is {decimal(found.wear_um)} µm, {signed(off.um)} µm from the expected one: that is wrong, or "
            "debris sticks to the tool. Another measurement cycle will show which.",
            {"kind": "wear", "off_um": off.um, "u_um": off.u_um},
        )
        depth = found.depth.widened(u_um if off.um < 0.0 else 0.0)
        return replace(found, depth=depth, wear=found.wear.widened(u_um), feed=found.feed.widened(u_um))

    def _decide(self, number: int, cut: CutResult | None, found: DepthAndWear) -> Decision:
        """Decide what follows a measurement cycle after `number` cuts; an earlier run made those without `cut`."""
        run, hole, knowledge = self._run, self._hole, self._knowledge
        gap_um, start = knowledge.gap.value, hole.next_start(knowledge.gap)
        decision = decisions.decide(
            run.profile,
            hole.target,
            number,
            cut,
            found,
            start,
            knowledge.estimate,
            touch_final=run.job.touches_final,
            broken_cuts=hole.broken_cuts + hole.regime.total.number,
        )
        if decision.plan is None and (cut is None or cut.end is CutEnd.REACHED):
            decision = self._next_regime(number, found) or decision
        site = run.tally.sites[hole.site.name]
        depth = marked(length(found.depth_um, found.depth.u95), site.depth_basis)
        wear = marked(length(found.wear_um, found.wear.u95), site.wear_basis)
        run.decide(
            RunEvent.SITE_MEASURED,
            f"Depth {depth}, wear {wear}, working gap {gap_um:.2f} µm.",
            {**_figures(found), "wear_ratio": found.wear_ratio, "gap_um": gap_um},
        )
        if decision.plan is None:
            decisions.report_end(run, decision, found.depth_um)
        else:
            run.decide(RunEvent.CUT_DECIDED, decision.message, {"feed_um": decision.plan.feed_um})
        return decision

    def _next_regime(self, number: int, found: DepthAndWear) -> Decision | None:
        """Begin the regime that the depth requires after this one; None if this was the last."""
        run, hole, knowledge = self._run, self._hole, self._knowledge
        recipes, following = recipes_of(run.job.profile), run.regime + 1
        if following >= len(recipes):
            return None
        while following + 1 < len(recipes) and found.depth_um >= recipes[following].to_um:
            following += 1
        before, recipe = run.profile, recipes[following]
        run.use_regime(following)
        run.machine.set_pulses(pulse_settings(recipe.profile))
        knowledge.estimate = _estimate_in_next(before, knowledge.estimate, recipe.profile)
        knowledge.gap = first_gap(recipe.profile)
        hole.target, hole.estimate = run.target_at(hole.site), knowledge.estimate
        hole.regime = RegimeBegun(found.depth_um, found.wear_um, hole.total, hole.stops)
        start, final = hole.next_start(knowledge.gap), run.job.touches_final
        plan = following_plan(run.profile, hole.target, number + 1, start, hole.estimate, touch_final=final)
        pulse = run.profile.pulse
        return Decision(
            f"Regime {recipe.name}: to {recipe.to_um:.1f} µm with {pulse.current_a:g} A for "
            f"{pulse.on_time_us:.3g} µs, {pulse.off_time_us:.3g} µs off, servo reference "
            f"{run.profile.servo.reference:g}. The next cut feeds {plan.feed_um:.2f} µm.",
            plan,
        )

    def _estimate(self, plan: CutPlan, cut: CutResult) -> Decision:
        """End a hole whose last cut need not be measured: feed and energy show what it added."""
        run, hole = self._run, self._hole
        now_s, estimated = run.machine.time_s, Basis.ESTIMATED
        live = plan.at(cut.end_displacement_um, self._energy(cut), now_s)
        depth, wear = plan.stated(live)
        feed_um = live.depth_um + live.wear_um
        length_u_um = run.uncertainty.length_u_um(feed_um)
        feed = Value(feed_um, math.hypot(plan.start.u_at(now_s), plan.start.gap_u_um, length_u_um))
        found = DepthAndWear(depth, wear, feed, depth_noise_um=live.depth_u_um)
        self._knowledge.add_unmeasured(hole, plan, cut, live)
        hole.report(
            found,
            plan.start.gap_um,
            fed_um=plan.fed_um(cut.end_displacement_um),
            worn_um=live.wear_um - plan.start.wear_um,
            estimated_um=live.depth_um - plan.start.depth_um,
            depth_basis=estimated,
            wear_basis=estimated,
        )
        run.decide(
            RunEvent.SITE_ESTIMATED,
            f"Depth ~{length(depth.value, depth.u95)}, wear ~{length(wear.value, wear.u95)} by feed and energy: "
            "known well enough without another touch.",
            _figures(found),
        )
        off_um = found.depth_um - hole.target.depth_um
        message = f"Depth ~{decimal(found.depth_um)} µm, {signed(off_um)} µm from the target."
        run.decide(RunEvent.TARGET_REACHED, message, {"depth_um": found.depth_um})
        return Decision(message)

    def _end_through(self, plan: CutPlan, cut: CutResult) -> Decision:
        """Measure the wear; the depth is how far the tip went below the surface, at least the sheet's thickness."""
        run, hole = self._run, self._hole
        # The tool stopped wearing anywhere in the last feed.
        pad = self._read_pad(plan, cut, more_u_um=hole.target.completion_um / math.sqrt(12.0))
        through = cut.through
        if hole.interrupted and not through and cut.end is CutEnd.REACHED:
            # It began too near to the back for the feed to show the breakthrough.
            through = self.touch_bottom_or_none(pad, hole.bottom.z_um) is None
        # A bottom is a working gap below the tip; behind the sheet there is none.
        tip_um = cut.end_displacement_um + (0.0 if through else plan.start.gap_um)
        tip_um = max(tip_um, hole.z1.z_um + hole.face_um)
        found = hole.take_tip(tip_um, pad)
        self._knowledge.tool = ToolLength(pad)
        hole.report(found, plan.start.gap_um, through=through, depth_basis=Basis.ESTIMATED)
        if through:
            decision = self.through(found)
        elif cut.end is not CutEnd.REACHED:
            decision = decisions.unfinished(hole.target, cut, found.depth_um, found.feed_um)
        else:
            sheet = f"The sheet of {hole.target.depth_um:g} µm did not break through"
            message = f"{sheet} within {found.depth_um:.1f} µm."
            decision = decisions.missed(
                message, "Check work.thickness_um; a thicker sheet needs more stroke."
            )
        decisions.report_end(run, decision, found.depth_um)
        return decision

    def through(self, found: DepthAndWear) -> Decision:
        sheet = f"Through the sheet of {self._hole.target.depth_um:g} µm"
        return Decision(f"{sheet}; the tip went {found.depth_um:.1f} µm below its face.")

    def touch_bottom_or_none(self, pad: SurfaceReading, least_um: float) -> SurfaceReading | None:
        """Touch the bottom from `least_um` on; None if the tool goes through as far as it is fed there."""
        run, hole, name = self._run, self._hole, self._hole.site.name
        z_max_um = pad.z_um + hole.face_um + hole.target.depth_um + hole.target.completion_um
        move_to(run, hole.site)
        try:
            return take_reading_in(
                run, "Z2", name, replace(search_near(run, least_um, 0.0), z_max_um=z_max_um)
            )
        except MachineFault as fault:
            if fault.code != NO_CONTACT:
                raise
            run.machine.clear_fault(fault.fault)
            run.machine.arm()
        message = f"The tool goes through {name} to {z_max_um:.1f} µm and meets nothing: the hole is open."
        run.decide(RunEvent.BREAKTHROUGH, message, {"displacement_um": z_max_um})
        return None


def _figures(found: DepthAndWear) -> dict[str, float]:
    return {
        "depth_um": found.depth_um,
        "wear_um": found.wear_um,
        "depth_u95_um": found.depth.u95,
        "wear_u95_um": found.wear.u95,
    }


def _estimate_in_next(before: Profile, learned: ErosionEstimate, after: Profile) -> ErosionEstimate:
    """Return the estimate of a recipe, corrected like that of the pulses before: the materials are the same."""
    removal = ratio = 1.0
    if learned.fits > 0 and not learned.contradicted:
        expected = estimate_of(before)
        removal = learned.removal_um3_per_uj / expected.removal_um3_per_uj
        ratio = learned.wear_ratio / max(expected.wear_ratio, LEAST_RATIO)
    work, wear = after.work, after.wear
    changed = {
        "work": work.model_copy(update={"removal_um3_per_uj": removal * work.removal_um3_per_uj}),
        "wear": wear.model_copy(update={"expected_ratio": ratio * wear.expected_ratio}),
    }
    return estimate_of(after.model_copy(update=changed))
