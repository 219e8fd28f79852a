"""One hole: approach, cut, and measure as often as its depth asks for; the end of a hole through the sheet.

At every step its state is kept for a run that goes on with it: by the cut, the last touches, or the run before.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

from edmctl.errors import MachineFault
from edmctl.labels import Basis
from edmctl.procedures.hole.cut import CutEnd, CutResult, Decision, out_of_time, run_cut, unfinished
from edmctl.procedures.hole.cut_planning import CutPlan, energy_of, first_plan
from edmctl.procedures.hole.first_sparks import check_first_sparks, debris_um
from edmctl.procedures.hole.hole import JobKnowledge, OpenHole, start_of
from edmctl.procedures.hole.hole_estimate import (
    Estimate,
    estimate_in_cut,
    estimate_left,
    estimate_touched,
    expected_of_left,
    most_um_s,
)
from edmctl.procedures.hole.measuring_stop import estimate_hole, measure_hole, measured, touch_pad
from edmctl.procedures.hole.site_result import close_site
from edmctl.procedures.job import HoleTarget
from edmctl.procedures.job_state import JobState, RunningCut, UnderWay
from edmctl.procedures.run import MACHINING, MEASURING, JobRun
from edmctl.procedures.servo.limits import TimeLimits
from edmctl.procedures.stages import move_to
from edmctl.procedures.touch.approach import approach_bottom
from edmctl.procedures.touch.reading import NO_CONTACT, SurfaceReading, search_near, take_reading_in
from edmctl.procedures.touch.spots import ToolLength
from edmctl.process.touches import DepthAndWear
from edmctl.record.rows import EventLevel, RunEvent


def machine_hole(
    run: JobRun, hole: OpenHole, knowledge: JobKnowledge, limits: TimeLimits, *, is_last: bool = True
) -> Decision:
    """Machine a hole from its untouched face, and return the last decision.

    The last hole is measured where others before it are not, because it tells of them too. The tally holds the
    hole's result after every cut, so that it is there whatever comes next.
    """
    assert knowledge.tool is not None
    start = start_of(run, hole, knowledge)
    plan = first_plan(run.profile, start, hole.target, hole.estimate, run.machine.time_s)
    if is_last and not plan.measured:
        plan = replace(plan, measured=True)
    return cut_to_the_end(run, hole, knowledge, plan, limits)


def cut_to_the_end(
    run: JobRun, hole: OpenHole, knowledge: JobKnowledge, plan: CutPlan, limits: TimeLimits
) -> Decision:
    """Cut and measure until a decision plans nothing more."""
    decision = _cut(run, hole, knowledge, plan, limits)
    while decision.plan is not None:
        decision = _cut(run, hole, knowledge, decision.plan, limits)
    close_site(run, settled=not knowledge.unmeasured)
    return decision


def _cut(run: JobRun, hole: OpenHole, knowledge: JobKnowledge, plan: CutPlan, limits: TimeLimits) -> Decision:
    """Make one planned cut, unless the time is up before the approach, which sparks, or after it."""
    if limits.left().seconds <= 0.0:
        return _no_time(run, hole, plan, limits)
    move_to(run, hole.site)
    bottom_u_um = plan.start.bottom_u_at(run.machine.time_s)
    sparks = approach_bottom(
        run, plan.start.bottom_um, math.hypot(bottom_u_um, 0.5 * debris_um(hole, knowledge.surface))
    )
    plan = check_first_sparks(run, hole, knowledge.surface, plan, sparks, bottom_u_um)
    left = limits.left()
    if left.seconds <= 0.0:
        return _no_time(run, hole, plan, limits)
    machined_before_s = run.tally.machining_time_s
    run.tally.unmeasured_site = hole.site.name
    keep_cut_begun(run, hole, plan)
    cut = run_cut(run, plan, left)
    keep_cut_ended(run, hole, cut)
    run.tally.machining_time_s = machined_before_s + cut.time_s
    run.tally.depth_um = math.nan if cut.through else plan.depth_at(cut.end_displacement_um)
    if hole.target.kind == "through":
        decision = end_of_through_hole(run, hole, knowledge, plan, cut)
    elif (
        plan.measured or run.regime_follows or cut.end is not CutEnd.REACHED or _is_surprising(run, plan, cut)
    ):
        decision = measure_hole(run, hole, knowledge, plan, cut)
    else:
        decision = estimate_hole(run, hole, knowledge, plan, cut)
    return decision


def _is_surprising(run: JobRun, plan: CutPlan, cut: CutResult) -> bool:
    """Return whether a cut lost its sparks, or its energy does not go with its feed: then a touch has to tell."""
    if cut.end_displacement_um < plan.z_limit_um:
        return True
    energy = energy_of(run.profile.pulse, cut.counts, cut.energy_j)
    return plan.contradicts(cut.end_displacement_um, energy)


def _no_time(run: JobRun, hole: OpenHole, plan: CutPlan, limits: TimeLimits) -> Decision:
    decision = out_of_time(hole.target, plan, limits.left().limit)
    run.decide(
        RunEvent.TARGET_MISSED,
        decision.message,
        {"cut": plan.number, "depth_um": plan.start.depth_um, "hint": decision.hint},
        level=EventLevel.WARNING,
    )
    return decision


def end_of_through_hole(
    run: JobRun, hole: OpenHole, knowledge: JobKnowledge, plan: CutPlan, cut: CutResult
) -> Decision:
    """Measure the wear; the depth is how far the tip went below the face, at least the sheet's thickness."""
    anywhere_u_um = hole.target.completion_um / math.sqrt(
        12.0
    )  # where in the last feed the tool stopped wearing
    pad = touch_pad(run, hole, plan, cut, more_u_um=anywhere_u_um)
    through = cut.through
    if hole.interrupted and not through and cut.end is CutEnd.REACHED:
        # Too near to the back from the start for the feed to tell.
        through = touch_bottom_or_none(run, hole, pad, hole.bottom.z_um) is None
    # A bottom lies a working gap below the tip; behind the sheet there is none.
    tip_um = max(cut.end_displacement_um + (0.0 if through else plan.start.gap_um), hole.surface_um)
    hole.stops += 1
    hole.bottom, hole.pad = hole.z1.shifted(tip_um - hole.z1.z_um), pad
    found = measured(run, hole, hole.bottom, pad)
    knowledge.tool = ToolLength(pad)
    hole.report(run, found, plan.start.gap_um, through=through, depth_basis=Basis.ESTIMATED)
    decision = _decision(hole, cut, found, through=through)
    code = RunEvent.TARGET_MISSED if decision.missed else RunEvent.TARGET_REACHED
    level = EventLevel.WARNING if decision.missed else EventLevel.INFO
    run.decide(code, decision.message, {"depth_um": found.depth_um, "hint": decision.hint}, level=level)
    return decision


def touch_bottom_or_none(
    run: JobRun, hole: OpenHole, pad: SurfaceReading, least_um: float
) -> SurfaceReading | None:
    """Touch the bottom of a hole that may be open, from `least_um` on; None where the tool goes right through.

    That is to beyond the back by as much as the hole is fed on behind it.
    """
    search = search_near(run, least_um, 0.0)
    search = replace(
        search, z_max_um=pad.z_um + hole.face_um + hole.target.depth_um + hole.target.completion_um
    )
    move_to(run, hole.site)
    try:
        return take_reading_in(run, "Z2", hole.site.name, search)
    except MachineFault as fault:
        if fault.code != NO_CONTACT:
            raise
        run.machine.clear_fault(fault.fault)
        run.machine.arm()
    run.decide(
        RunEvent.BREAKTHROUGH,
        f"The tool goes through {hole.site.name} to {search.z_max_um:.1f} µm and meets nothing: the hole is open.",
        {"displacement_um": search.z_max_um},
    )
    return None


def through_message(target: HoleTarget, found: DepthAndWear) -> str:
    """Return the end of a hole that is open, in words."""
    return (
        f"Through the sheet of {target.depth_um:g} µm; the tip went {found.depth_um:.1f} µm below its face."
    )


def _decision(hole: OpenHole, cut: CutResult, found: DepthAndWear, *, through: bool) -> Decision:
    thickness_um = hole.target.depth_um
    if through:
        return Decision(None, through_message(hole.target, found))
    if cut.end is not CutEnd.REACHED:
        return unfinished(hole.target, cut, found.depth_um, found.feed_um)
    missed = f"The sheet of {thickness_um:g} µm did not break through within {found.depth_um:.1f} µm."
    return Decision(None, missed, missed, "Check work.thickness_um; a thicker sheet needs more stroke.")


def keep_hole_begun(run: JobRun, hole: OpenHole, *, begun: bool = False) -> None:
    """Keep a hole whose Z1 is known; `begun` when an earlier run has cut it already."""
    hole.begun = begun
    run.keeper.keep(MEASURING, _under_way(run, hole), run.machine.time_s)


def keep_cut_begun(run: JobRun, hole: OpenHole, plan: CutPlan) -> None:
    """Keep that sparks come next."""
    hole.plan, hole.cut_estimate, hole.begun = plan, None, True
    run.tally.cut = RunningCut(displacement_um=plan.start.bottom_um - plan.start.gap_um)
    run.keeper.keep(MACHINING, _under_way(run, hole))


def keep_cut_ended(run: JobRun, hole: OpenHole, cut: CutResult) -> None:
    """Keep that the cut has ended, and that its sums are the hole's now."""
    assert hole.plan is not None
    energy = energy_of(run.profile.pulse, cut.counts, cut.energy_j)
    hole.cut_estimate = estimate_in_cut(hole.plan, cut.end_displacement_um, energy, run.keeper.time_s)
    hole.sums.cuts.append(cut)
    run.tally.cut = RunningCut(displacement_um=run.tally.cut.displacement_um)
    hole.plan = None
    run.keeper.keep(MEASURING, _under_way(run, hole))


def _under_way(run: JobRun, hole: OpenHole) -> UnderWay:
    return UnderWay(partial(_state, run, hole), partial(_leave, run, hole))


def _leave(run: JobRun, hole: OpenHole) -> None:
    """Report by estimate a hole that nobody has touched since its last cut, where the job ends early."""
    if run.tally.unmeasured_site != hole.site.name:
        return
    estimate, resumed, profile = _estimate(run, hole, run.keeper.time_s), run.job.resumed, run.profile
    unseen_um = 0.0
    if hole.plan is not None:
        unseen_s = run.keeper.samples_late_s + run.setup.controller.watchdog_s
        unseen_um = unseen_s * most_um_s(estimate, hole.sums.total.time_s + run.tally.cut.time_s, profile)
    elif hole.cut_estimate is None and resumed is not None:
        unseen_um = expected_of_left(resumed, profile).unseen_um
    touched = hole.estimate.fits > 0 or hole.stops > 0
    hole.report_left(run, estimate.left(unseen_um, hole.estimate.wear_ratio, touched=touched))


def _state(run: JobRun, hole: OpenHole, state: JobState, now_s: float) -> JobState:
    cut, sums, estimate, z1 = run.tally.cut, hole.sums, _estimate(run, hole, now_s), hole.z1
    total, is_cutting = sums.total.plus(cut.counts, cut.energy_j, cut.time_s), hole.plan is not None
    return replace(
        state,
        done=tuple(site for site in state.done if site["name"] != hole.site.name),
        site=hole.site.name,
        begun=hole.begun,
        z1_um=z1.z_um,
        z1_sd_um=z1.reading.sd_um,
        z1_touches=z1.reading.touches,
        z1_u_um=hole.z1_u_um,
        z1_doubt_u_um=z1.doubt_u_um,
        z1_time_s=run.tally.earlier_time_s + z1.time_s,
        z1_model_um=z1.model_um,
        displacement_um=0.0 if math.isnan(cut.displacement_um) else cut.displacement_um,
        depth_um=estimate.depth_um,
        depth_u_um=estimate.depth_u_um,
        wear_um=estimate.wear_um,
        wear_u_um=estimate.wear_u_um,
        feed_u_um=estimate.feed_u_um,
        regime=run.regime.number,
        regime_depth_um=hole.regime.depth_um,
        regime_wear_um=hole.regime.wear_um,
        cuts=sums.total.number + is_cutting,
        broken_cuts=sums.broken_cuts + is_cutting,
        counts=total.counts,
        energy_j=total.energy_j,
        machining_time_s=total.time_s,
    )


def _estimate(run: JobRun, hole: OpenHole, now_s: float) -> Estimate:
    """Return what is known of the hole at a time of the run."""
    cut = run.tally.cut
    if hole.plan is not None and not math.isnan(cut.displacement_um):
        energy = energy_of(run.profile.pulse, cut.counts, cut.energy_j)
        return estimate_in_cut(hole.plan, cut.displacement_um, energy, now_s)
    if hole.cut_estimate is not None and run.tally.unmeasured_site == hole.site.name:
        return hole.cut_estimate
    if hole.found is not None:
        return estimate_touched(hole.found)
    if hole.interrupted and run.job.resumed is not None:
        return estimate_left(run.job.resumed)
    return Estimate()
