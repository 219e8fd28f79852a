"""One hole: approach, cut, and measure as often as the uncertainty of its depth asks for."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from edmctl.procedures.event_codes import RunEvent
from edmctl.procedures.hole.cut import CutEnd, run_cut
from edmctl.procedures.hole.cut_decision import Decision, out_of_time
from edmctl.procedures.hole.cut_planning import CutPlan, energy_of, first_plan
from edmctl.procedures.hole.first_sparks import check_first_sparks, lying_um
from edmctl.procedures.hole.hole import start_of
from edmctl.procedures.hole.hole_state import keep_cut_begun, keep_cut_ended
from edmctl.procedures.hole.measuring_stop import estimate_hole, measure_hole
from edmctl.procedures.hole.site_result import close_site
from edmctl.procedures.hole.through_hole import end_of_through_hole
from edmctl.procedures.stages import move_to
from edmctl.procedures.touch.approach import approach_bottom
from edmctl.record.rows import EventLevel

if TYPE_CHECKING:
    from edmctl.procedures.hole.cut import CutResult
    from edmctl.procedures.hole.hole import Hole, Known
    from edmctl.procedures.run import Run
    from edmctl.procedures.servo.time_limits import TimeLimits


def machine_hole(run: Run, hole: Hole, known: Known, limits: TimeLimits, *, is_last: bool = True) -> Decision:
    """Machine a hole from its untouched face, and return the last decision.

    The last hole is measured where others before it are not, because it tells of them too. The tally holds the
    hole's result after every cut, so that it is there whatever comes next.
    """
    assert known.tool is not None
    start = start_of(run, hole, known)
    plan = first_plan(run.profile, start, hole.goal, hole.estimate, run.machine.time_s)
    if is_last and not plan.measured:
        plan = replace(plan, measured=True)
    return cut_to_the_end(run, hole, known, plan, limits)


def cut_to_the_end(run: Run, hole: Hole, known: Known, plan: CutPlan, limits: TimeLimits) -> Decision:
    """Cut and measure until a decision plans nothing more."""
    decision = _cut(run, hole, known, plan, limits)
    while decision.plan is not None:
        decision = _cut(run, hole, known, decision.plan, limits)
    close_site(run, settled=not known.unmeasured)
    return decision


def _cut(run: Run, hole: Hole, known: Known, plan: CutPlan, limits: TimeLimits) -> Decision:
    """One planned cut, unless the time is up: looked at before the approach, which sparks, and after it."""
    if limits.left().seconds <= 0.0:
        return _no_time(run, hole, plan, limits)
    move_to(run, hole.site)
    bottom_u_um = plan.start.bottom_u_at(run.machine.time_s)
    sparks = approach_bottom(run, plan.bottom_um, math.hypot(bottom_u_um, 0.5 * lying_um(hole, known.face)))
    plan = check_first_sparks(run, hole, known.face, plan, sparks, bottom_u_um)
    left = limits.left()
    if left.seconds <= 0.0:
        return _no_time(run, hole, plan, limits)
    machined_before_s = run.tally.machining_time_s
    run.tally.unmeasured_site = hole.site.name
    keep_cut_begun(run, hole, plan)
    cut = run_cut(run, plan, left)
    keep_cut_ended(run, hole, cut)
    run.tally.machining_time_s = machined_before_s + cut.time_s
    run.tally.depth_um = plan.depth_at(cut.end_displacement_um)
    if hole.goal.kind == "through":
        decision = end_of_through_hole(run, hole, known, plan, cut)
    elif plan.measured or cut.end is not CutEnd.REACHED or _is_surprising(run, plan, cut):
        decision = measure_hole(run, hole, known, plan, cut)
    else:
        decision = estimate_hole(run, hole, known, plan, cut)
    return decision


def _is_surprising(run: Run, plan: CutPlan, cut: CutResult) -> bool:
    """Whether a cut lost its sparks, or its energy does not go with its feed: then a touch has to tell."""
    if cut.end_displacement_um < plan.z_limit_um:
        return True
    energy = energy_of(run.profile.pulse, cut.counts, cut.energy_j)
    return plan.contradicts(cut.end_displacement_um, energy)


def _no_time(run: Run, hole: Hole, plan: CutPlan, limits: TimeLimits) -> Decision:
    decision = out_of_time(hole.goal, plan, limits.left().limit)
    run.decide(
        RunEvent.TARGET_MISSED,
        decision.message,
        {"cut": plan.number, "depth_um": plan.start.depth_um, "hint": decision.hint},
        level=EventLevel.WARNING,
    )
    return decision
