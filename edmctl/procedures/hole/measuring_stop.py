"""A measuring stop: bottom and pad are touched after a cut, and what they teach is kept. Or the cut needs none.

Then the next touch of the pad tells of all cuts since the last one at once, and the results of their holes are
corrected by it.
"""

from __future__ import annotations

import math
from dataclasses import replace

from edmctl.labels import Basis, marked
from edmctl.procedures.hole.cut import CutEnd, CutResult, Decision, decide, refuse_wrong_setup
from edmctl.procedures.hole.cut_planning import (
    CutPlan,
    CutStart,
    energy_of,
    following_plan,
    learned_gap_um,
)
from edmctl.procedures.hole.first_sparks import judge_again
from edmctl.procedures.hole.hole import JobKnowledge, OpenHole, Unmeasured
from edmctl.procedures.hole.regimes import next_regime, regime_text
from edmctl.procedures.run import Args, JobRun
from edmctl.procedures.touch.approach import CLEAR_OF_BOTTOM_UM, ExpectedBottom, raise_by, read_expected
from edmctl.procedures.touch.drift import drift_between, rest_before_pad
from edmctl.procedures.touch.reading import SurfaceReading
from edmctl.procedures.touch.spots import (
    ToolLength,
    pad_u_um,
    read_pad,
    refuse_grown_tool,
)
from edmctl.process.live_erosion import CONTRADICTION_SDS, SCATTER_BETWEEN_HOLES, ErosionEstimate, LiveErosion
from edmctl.process.next_cut import GAP_U_UM
from edmctl.process.shared_wear import SharedWear, WearShare, share_wear
from edmctl.process.touches import TOUCH_U_UM, DepthAndWear, Deviation, measure, share_u
from edmctl.quantity import Value
from edmctl.record.rows import EventLevel, RunEvent
from edmctl.results.job import SiteResult
from edmctl.wording import decimal, length, signed

PAD_U_UM = 0.5
"""Standard uncertainty of the pad's place besides the wear: drift and touch scatter."""
GAP_SETTLES_S = 1.0
"""A cut that is over before teaches no working gap: its first sparks come 1 µm earlier, the servo follows."""
UNFINISHED_GAP_U_UM = 3.0
"""Standard uncertainty of the gap where a cut did not end at its limit: the servo swings, and shorts draw back
[assumed]."""


def measure_hole(
    run: JobRun, hole: OpenHole, knowledge: JobKnowledge, plan: CutPlan, cut: CutResult
) -> Decision:
    """Touch bottom and pad after a cut, learn from them, and decide what follows."""
    end_um = cut.end_displacement_um
    z2 = read_bottom(run, hole.site.name, plan, cut)
    z3 = touch_pad(run, hole, plan, cut)
    gap_um, gap_u_um = plan.start.gap_um, plan.start.gap_u_um
    if cut.time_s >= GAP_SETTLES_S:
        gap_um = learned_gap_um(z2.z_um, end_um)
        gap_u_um = math.hypot(GAP_U_UM, 0.0 if cut.is_at_limit else UNFINISHED_GAP_U_UM)
        if cut.is_at_limit and z2.doubt_u_um == 0.0:
            judge_again(run, hole, knowledge.surface, gap_um)
    settled = None
    if knowledge.unmeasured:
        live = plan.at(end_um, energy_of(run.profile.pulse, cut.counts, cut.energy_j))
        settled = settle_unmeasured(run, hole, knowledge, z3, plan, cut, live)
    found = learn(run, hole, knowledge, z2, z3, (gap_um, gap_u_um), settled)
    if plan.number == 1:
        refuse_wrong_setup(run, hole.touched or found)
    return decide_next(run, hole, knowledge, plan.number, cut, found)


def read_bottom(run: JobRun, place: str, plan: CutPlan, cut: CutResult) -> SurfaceReading:
    """Touch the bottom that a cut has left, more often where it is not where it should be."""
    raise_by(run, CLEAR_OF_BOTTOM_UM)
    gap_u_um = math.hypot(plan.start.gap_u_um, 0.0 if cut.is_at_limit else UNFINISHED_GAP_U_UM)
    return read_expected(
        run, place, ExpectedBottom(cut.end_displacement_um, plan.start.gap_um, gap_u_um, "the last sparks")
    )


def decide_next(
    run: JobRun,
    hole: OpenHole,
    knowledge: JobKnowledge,
    number: int,
    cut: CutResult | None,
    found: DepthAndWear,
) -> Decision:
    """Decide what follows a measuring stop after `number` cuts, of which an earlier run made those without `cut`."""
    decision = decide(
        run.profile,
        hole.target,
        number,
        cut,
        found,
        next_start(run, hole, knowledge),
        knowledge.estimate,
        touch_final=run.job.touches_final,
        broken_cuts=hole.sums.broken_cuts + hole.regime.total.number,
    )
    gap_um = knowledge.gap_um
    if decision.plan is None and (cut is None or cut.end is CutEnd.REACHED):
        decision = _of_next_regime(run, hole, knowledge, number, found) or decision
    _report(run, run.tally.sites[hole.site.name], found, gap_um, decision)
    return decision


def _of_next_regime(
    run: JobRun, hole: OpenHole, knowledge: JobKnowledge, number: int, found: DepthAndWear
) -> Decision | None:
    """Return the first cut of the next regime; None where there is none."""
    recipe = next_regime(run, hole, knowledge, found)
    if recipe is None:
        return None
    start = next_start(run, hole, knowledge)
    plan = following_plan(
        run.profile, hole.target, number + 1, start, hole.estimate, touch_final=run.job.touches_final
    )
    return Decision(plan, f"{regime_text(recipe)} The next cut feeds {plan.feed_um:.2f} µm.")


def touch_pad(
    run: JobRun, hole: OpenHole, plan: CutPlan, cut: CutResult, more_u_um: float = 0.0
) -> SurfaceReading:
    """Touch the pad with the worn tool (Z3). `more_u_um` is a standard uncertainty on top."""
    end_um = cut.end_displacement_um
    live = plan.at(end_um, energy_of(run.profile.pulse, cut.counts, cut.energy_j))
    u_um = math.hypot(PAD_U_UM, live.wear_u_um, hole.z1_u_um, more_u_um)
    expected_um = hole.z1.z_um + live.wear_um + hole.drift_um
    # A recipe that no touch has confirmed may be wrong by more than what it believes itself.
    deepest_um = expected_um + plan.stated(live)[1].u95
    rest_before_pad(run, hole.z1)
    z3 = read_pad(run, "Z3", hole.site.name, expected_um, u_um, deepest_um)
    before_u_um = math.hypot(hole.z1_u_um, hole.z1.doubt_u_um)
    refuse_grown_tool(run, hole.z1.z_um, z3, z3.time_s - hole.z1.time_s, before_u_um)
    return z3


def measured(run: JobRun, hole: OpenHole, z2: SurfaceReading, z3: SurfaceReading) -> DepthAndWear:
    """Return what bottom and pad say of a hole, against where it began."""
    z1 = hole.z1
    return measure(
        z1,
        z2,
        z3,
        run.uncertainty,
        tilt_u_um=hole.face_u_um,
        pad_u_um=pad_u_um(run.setup),
        height_um=hole.face_um,
        z1_u_um=hole.z1_u_um,
        drift=drift_between(run, z1, z3),
    )


def learn(
    run: JobRun,
    hole: OpenHole,
    knowledge: JobKnowledge,
    z2: SurfaceReading,
    z3: SurfaceReading,
    gap: tuple[float, float],
    settled: SharedWear | None = None,
) -> DepthAndWear:
    """Take the readings of a stop into the tally, the tool's length and the estimate of what follows.

    `gap` is the working gap to expect from now on, µm, and its standard uncertainty.
    `settled` is the wear of the hole where the touch tells of several holes at once.
    """
    found = measured(run, hole, z2, z3)
    if settled is not None:
        # How much of the uncertainty is drift the touch of several holes does not tell of one.
        settled_wear = Value(settled.wear_um, settled.wear_u_um)
        found = replace(found, wear=settled_wear, drift_left_u_um=math.nan)
    stated = found if settled is not None else with_doubt_of_wear(run, hole, knowledge.estimate, found)
    hole.stops += 1
    knowledge.pads.append(z3)
    hole.bottom, hole.pad, hole.touched = z2, z3, found
    hole.report(run, stated, gap[0], depth_basis=Basis.ESTIMATED if z2.doubt_u_um > 0.0 else None)
    knowledge.tool, knowledge.gap_um = ToolLength(z3), gap[0]
    knowledge.gap_u_um = math.hypot(gap[1], z2.doubt_u_um)
    if z2.doubt_u_um > 0.0:
        return stated
    learned = hole.estimate.fitted(
        None if hole.interrupted else hole.energy(run),
        found.depth_um - hole.regime.depth_um,
        found.depth.u,
        found.wear_um - hole.regime.wear_um,
        found.wear.u,
    )
    # What one stop has taught against the recipe, the next one may confirm.
    is_confirmed = settled is None and hole.stops - hole.regime.stops > 1 and stated is found
    knowledge.estimate = learned.confirmed() if is_confirmed else learned
    return stated


def with_doubt_of_wear(
    run: JobRun, hole: OpenHole, estimate: ErosionEstimate, found: DepthAndWear
) -> DepthAndWear:
    """Widen what a stop found where its wear is not what was believed, until another stop agrees with it.

    A tool that wears otherwise and something that sticks to it look alike. The truth may lie anywhere between the
    belief and the touch; a tool that seems too long also makes the hole seem too deep. What sticks to the tool at
    every touch, and a surface that lay elsewhere before, shift the feed by as much.
    """
    before_depth_um = before_um = before_u_um = 0.0
    if hole.touched is not None:
        before_depth_um, before_um = hole.touched.depth_um, hole.touched.wear_um
        before_u_um = hole.touched.wear.u
    added_um = estimate.wear_ratio * max(0.0, found.depth_um - before_depth_um)
    off = Deviation(
        found.wear_um - before_um - added_um,
        math.hypot(estimate.wear_ratio_u_rel * added_um, before_u_um, found.wear.u),
    )
    if abs(off.sigmas) <= CONTRADICTION_SDS:
        return found
    doubt_u_um = share_u(off.um)
    run.decide(
        RunEvent.TOUCH_DOUBTED,
        f"The wear is {decimal(found.wear_um)} µm, {signed(off.um)} µm from what was believed: the belief is wrong, "
        "or something sticks to the tool. It takes another stop to tell.",
        {"kind": "wear", "off_um": off.um, "u_um": off.u_um},
        level=EventLevel.WARNING,
    )
    return replace(
        found,
        wear=found.wear.widened(doubt_u_um),
        depth=found.depth.widened(doubt_u_um if off.um < 0.0 else 0.0),
        feed=found.feed.widened(doubt_u_um),
    )


def next_start(run: JobRun, hole: OpenHole, knowledge: JobKnowledge) -> CutStart:
    """Return what a further cut of a measured hole would start from."""
    assert hole.found is not None
    found = hole.found
    return CutStart(
        bottom_um=hole.bottom.z_um,
        bottom_u_um=math.hypot(TOUCH_U_UM, hole.bottom.doubt_u_um),
        gap_um=knowledge.gap_um,
        time_s=hole.bottom.time_s,
        drift_u_um_per_s=run.uncertainty.drift_u_um_per_s,
        depth_um=found.depth_um,
        depth_u_um=found.depth.u,
        wear_um=found.wear_um,
        wear_u_um=found.wear.u,
        gap_u_um=knowledge.gap_u_um,
    )


def estimate_hole(
    run: JobRun, hole: OpenHole, knowledge: JobKnowledge, plan: CutPlan, cut: CutResult
) -> Decision:
    """End a hole whose last cut need not be measured: what it added is known from feed and energy."""
    now_s, sensor_u = run.machine.time_s, run.uncertainty
    energy = energy_of(run.profile.pulse, cut.counts, cut.energy_j)
    live = plan.at(cut.end_displacement_um, energy, now_s)
    worn_um = live.wear_um - plan.start.wear_um
    feed_um = live.depth_um + live.wear_um
    feed_u_um = math.hypot(plan.start.u_at(now_s), plan.start.gap_u_um, sensor_u.length_u_um(feed_um))
    depth, wear = plan.stated(live)
    found = DepthAndWear(
        depth=depth,
        wear=wear,
        feed=Value(feed_um, feed_u_um),
        depth_noise_um=live.depth_u_um,
    )
    assert knowledge.tool is not None
    knowledge.unmeasured.append(unmeasured(run, hole, knowledge.tool.pad.time_s, plan, cut, live))
    knowledge.tool = knowledge.tool.worn(worn_um, live.wear_u_um)
    hole.report(
        run,
        found,
        plan.start.gap_um,
        fed_um=plan.fed_um(cut.end_displacement_um),
        worn_um=worn_um,
        estimated_um=live.depth_um - plan.start.depth_um,
        depth_basis=Basis.ESTIMATED,
        wear_basis=Basis.ESTIMATED,
    )
    run.decide(
        RunEvent.SITE_ESTIMATED,
        f"Depth ~{length(found.depth_um, found.depth.u95)}, "
        f"wear ~{length(found.wear_um, found.wear.u95)} by feed and energy: known well enough without another "
        "touch.",
        {
            "depth_um": found.depth_um,
            "wear_um": found.wear_um,
            "depth_u95_um": found.depth.u95,
            "wear_u95_um": found.wear.u95,
        },
    )
    off_um = found.depth_um - hole.target.depth_um
    message = f"Depth ~{decimal(found.depth_um)} µm, {signed(off_um)} µm from the target."
    run.decide(RunEvent.TARGET_REACHED, message, {"depth_um": found.depth_um})
    return Decision(None, message)


def _report(run: JobRun, site: SiteResult, found: DepthAndWear, gap_um: float, decision: Decision) -> None:
    """Report what a stop has found of a site, and what follows."""
    run.decide(
        RunEvent.SITE_MEASURED,
        f"Depth {marked(length(found.depth_um, found.depth.u95), site.depth_basis)}, "
        f"wear {marked(length(found.wear_um, found.wear.u95), site.wear_basis)}, working gap {gap_um:.2f} µm.",
        {
            "depth_um": found.depth_um,
            "wear_um": found.wear_um,
            "depth_u95_um": found.depth.u95,
            "wear_u95_um": found.wear.u95,
            "wear_ratio": found.wear_ratio,
            "gap_um": gap_um,
        },
    )
    if decision.plan is None:
        code = RunEvent.TARGET_MISSED if decision.missed else RunEvent.TARGET_REACHED
        level = EventLevel.WARNING if decision.missed else EventLevel.INFO
        args: Args = {"depth_um": found.depth_um, "hint": decision.hint}
        run.decide(code, decision.message, args, level=level)
    else:
        run.decide(RunEvent.CUT_DECIDED, decision.message, {"feed_um": decision.plan.feed_um})


def unmeasured(
    run: JobRun, hole: OpenHole, pad_s: float, plan: CutPlan, cut: CutResult, live: LiveErosion
) -> Unmeasured:
    """Return what is to be remembered of a cut just made that no touch follows; the pad was last touched at `pad_s`.

    The ratio of wear to depth errs alike in all cuts of a job; working gap and scatter do not, nor does wear that
    the energy of this cut contradicts.
    """
    start = plan.start
    added_um = live.wear_um - start.wear_um
    energy = energy_of(run.profile.pulse, cut.counts, cut.energy_j)
    off_um = plan.off_by_energy_um(cut.end_displacement_um, energy)
    own_u_um = math.hypot(SCATTER_BETWEEN_HOLES * added_um, live.wear_own_u_um, off_um)
    from_face = hole.stops == 0
    return Unmeasured(
        hole=hole,
        share=WearShare(added_um, live.wear_ratio_u_um, own_u_um, run.machine.time_s - pad_s),
        depth_u_um=math.hypot(
            plan.start.gap_u_um, start.depth_u_um, TOUCH_U_UM, hole.face_u_um if from_face else 0.0
        ),
        wear_before_um=start.wear_um,
        wear_before_u_um=start.wear_u_um,
    )


def settle_unmeasured(
    run: JobRun,
    hole: OpenHole,
    knowledge: JobKnowledge,
    pad: SurfaceReading,
    plan: CutPlan,
    cut: CutResult,
    live: LiveErosion,
) -> SharedWear:
    """Correct the cuts since the last touch of the pad, and where `hole` has begun; what that itself has worn.

    `pad` is the new reading, `live` what was expected of `hole` after `cut`; its Z1 becomes the reading less its own
    wear. The results of the others are replaced; they stay estimates, better ones.
    """
    assert knowledge.tool is not None
    before, sensor_u = knowledge.tool.pad, run.uncertainty
    cuts = [*knowledge.unmeasured, unmeasured(run, hole, before.time_s, plan, cut, live)]
    seconds, drift = pad.time_s - before.time_s, drift_between(run, before, pad)
    worn_um = pad.z_um - before.z_um - (drift.um if drift else 0.0)
    found = share_wear(
        [one.share for one in cuts],
        worn_um,
        seconds,
        # The sensor's gain is left out: it errs in a depth or wear of its own length, which is counted there.
        touch_u_um=math.hypot(TOUCH_U_UM * math.sqrt(2.0), sensor_u.walk_um_per_sqrt_s * math.sqrt(seconds)),
        drift_u_um_per_s=drift.left_u_um / seconds if drift else sensor_u.drift_u_um_per_s,
    )
    shorter_um = 0.0
    for earlier, now in zip(knowledge.unmeasured, found, strict=False):
        own_um = now.wear_um - earlier.share.wear_um
        _correct(run, earlier, own_um, shorter_um, now)
        shorter_um += own_um
    # From here on the hole counts in the frame of the new reading, at its time.
    z1 = hole.z1.shifted(pad.z_um - found[-1].wear_um - hole.z1.z_um)
    hole.z1, hole.z1_u_um = replace(z1, time_s=pad.time_s, rest=pad.rest), found[-1].wear_u_um
    knowledge.unmeasured.clear()
    return found[-1]


def _correct(run: JobRun, cut: Unmeasured, own_um: float, before_um: float, now: SharedWear) -> None:
    """A cut began `before_um` shorter of tool than it was taken to, and wore it by `own_um` more."""
    hole = cut.hole
    result, found = run.tally.sites[hole.site.name], hole.found
    assert found is not None
    z3_um = result.z3_um + before_um + own_um
    feed_um = result.feed_um - now.tip_um + own_um
    gain_u_um = run.uncertainty.gain_u_rel * feed_um
    wear_u_um = math.hypot(cut.wear_before_u_um, now.wear_u_um, run.uncertainty.length_u_um(now.wear_um))
    corrected = replace(
        found,
        depth=Value(result.depth_um - now.tip_um, math.hypot(cut.depth_u_um, now.tip_u_um)),
        wear=Value(cut.wear_before_um + now.wear_um, wear_u_um),
        feed=Value(feed_um, math.hypot(cut.depth_u_um, cut.wear_before_u_um, now.feed_u_um, gain_u_um)),
    )
    run.tally.sites[hole.site.name] = replace(
        result,
        **corrected.columns(),
        z1_um=result.z1_um + before_um,
        z2_um=z3_um + result.face_um + corrected.depth_um,
        z3_um=z3_um,
    )
    hole.found = corrected
