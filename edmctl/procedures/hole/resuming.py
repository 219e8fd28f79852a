"""A hole that an earlier run left in the middle: pad and bottom are touched again, then it goes on.

Retraction is certain, because the tool comes back to 0 V without power. So the pad tells how much tool is left, and
the bottom how deep the hole is. What was estimated before the interruption enters no result, but it has to agree:
otherwise work, place or tool are not those that were left, and nothing is machined.
"""

from __future__ import annotations

import math

from edmctl.errors import MachineFault, PreconditionError
from edmctl.procedures.hole.breakthrough import is_near_back
from edmctl.procedures.hole.cut import Decision
from edmctl.procedures.hole.cut_planning import through_plan
from edmctl.procedures.hole.hole import JobKnowledge, OpenHole, hole_at, touch_pad_first
from edmctl.procedures.hole.hole_estimate import (
    STANDARD_UNCERTAINTIES,
    Estimate,
    ExpectedHole,
    expected_of_finished,
    expected_of_left,
    hole_found,
    is_untouched,
    other_tool,
    other_work,
)
from edmctl.procedures.hole.measuring_stop import decide_next, learn, measured, next_start
from edmctl.procedures.hole.running_cut import NO_SPARK
from edmctl.procedures.hole.site import cut_to_the_end, keep_hole_begun, through_message, touch_bottom_or_none
from edmctl.procedures.hole.site_result import close_site
from edmctl.procedures.job_state import CutTotals, JobState, RegimeBegun
from edmctl.procedures.monitoring.drift import counted_pause_s, pause_drift_u_um
from edmctl.procedures.run import JobRun
from edmctl.procedures.servo.limits import TimeLimits
from edmctl.procedures.stages import move_to
from edmctl.procedures.touch.approach import MORE_LOOKS, wash
from edmctl.procedures.touch.reading import BEYOND_SIGMAS, NO_CONTACT, SurfaceReading, take_reading
from edmctl.procedures.touch.spots import ToolLength, read_pad
from edmctl.procedures.touch.surface_plane import fit_pad_slope, level_surface, touch_beside
from edmctl.process.touches import DepthAndWear, Reading
from edmctl.profile.places import Place
from edmctl.record.rows import EventLevel, RejectedTouch, RunEvent
from edmctl.wording import decimal, length

BEYOND_UM = 12.0
"""A touch looks so much further than what would be accepted: a mistake is to be found, not missed."""


def resume_hole(run: JobRun, site: Place, knowledge: JobKnowledge, limits: TimeLimits) -> Decision | None:
    """Measure what the earlier run has left, and cut what is missing; None where the hole is to be made anew.

    Raises PreconditionError: E8060 this is not the hole that was left, E8061 the tool is not, E8062 there is no
    untouched face for a hole that is to be made anew.
    """
    state = run.job.resumed
    assert state is not None
    expected = expected_of_left(state, run.profile)
    hole, z3 = touch_pad_left(run, site, knowledge, expected)
    z2 = _touch(run, "Z2", site, site.name, z3.z_um + hole.face_um + state.depth_um, expected.depth_reach_um)
    found = measured(run, hole, z2, z3)
    for _ in range(0 if run.job.restart_hole else MORE_LOOKS):
        if found.depth_um >= expected.estimate.depth_um or expected.depth_fits(found):
            break
        z2 = _touch_washed(run, site, z2, expected.depth_reach_um)
        found = measured(run, hole, z2, z3)
    if not run.tally.sites and run.profile.target.kind != "through":
        found = _on_its_own_surface(run, hole, knowledge, z2, z3, found)
    if run.job.restart_hole:
        _start_again(run, site, knowledge, z3, found)
        return None
    refuse_other(run, site, expected, found, untouched=is_untouched(found))
    # No cut of this run has shown the working gap yet: it stays as it was believed.
    found = learn(run, hole, knowledge, z2, z3, (knowledge.gap_um, knowledge.gap_u_um))
    report_resumed(run, expected.estimate, found.depth_um, found.wear_um)
    decision = decide_next(run, hole, knowledge, max(1, hole.sums.total.number), None, found)
    if decision.plan is None:
        close_site(run, settled=True)
        return decision
    return cut_to_the_end(run, hole, knowledge, decision.plan, limits)


def check_last_hole(run: JobRun, knowledge: JobKnowledge) -> None:
    """Touch the bottom of the hole that was finished last, where none was begun after it: is this that work?

    A hole through the sheet has no bottom, and a job that has finished none nothing to look at. What the touch of
    the pad tells of the tool needs no comparison: the next hole counts from it. Raises PreconditionError E8060.
    """
    state = run.job.resumed
    if state is None or not run.tally.sites or run.profile.target.kind == "through":
        return
    _begin(run, knowledge, state)
    pad = touch_pad_first(run, run.job.pad.name, knowledge)
    knowledge.tool = ToolLength(pad)
    _check_finished(run, knowledge, pad)


def touch_pad_left(
    run: JobRun, site: Place, knowledge: JobKnowledge, expected: ExpectedHole, more_um: float = 0.0
) -> tuple[OpenHole, SurfaceReading]:
    """Take the hole as the journal tells of it, and touch the pad (Z3), which may lie `more_um` further."""
    state = run.job.resumed
    assert state is not None
    _begin(run, knowledge, state)
    hole = _hole(run, site, knowledge, state)
    run.tally.depth_um, run.tally.unmeasured_site = state.depth_um, site.name
    keep_hole_begun(run, hole, begun=True)
    z3_um = hole.z1.z_um + expected.estimate.wear_um
    reach_um = expected.wear_reach_um + STANDARD_UNCERTAINTIES * pause_drift_u_um(run.job) + more_um
    z3 = _touch(run, "Z3", run.job.pad, site.name, z3_um, reach_um)
    _update_surface(run, hole, knowledge, z3)
    return hole, z3


def report_resumed(run: JobRun, expected: Estimate, depth_um: float, wear_um: float) -> None:
    """Say from where the job goes on."""
    run.decide(
        RunEvent.RESUMED,
        f"Taken up again at {decimal(depth_um)} µm depth and {decimal(wear_um)} µm wear; the journal expected "
        f"{decimal(expected.depth_um, 1)} and {decimal(expected.wear_um, 1)} µm.",
        {"depth_um": depth_um, "wear_um": wear_um, "expected_um": expected.depth_um},
    )


def refuse_other(
    run: JobRun,
    site: Place,
    expected: ExpectedHole,
    found: DepthAndWear,
    *,
    untouched: bool = False,
    begun: bool = True,
) -> None:
    """Raise PreconditionError E8060, E8061 where the touches found other work than was left, or another tool.

    An untouched face under a tool that does not fit either is other work: there a hole can be made anew.
    """
    tool_fits = expected.tool_fits(found)
    if not expected.depth_fits(found) or (untouched and not tool_fits):
        raise refused(run, other_work(site, found, expected.estimate, begun=begun))
    if not tool_fits:
        raise refused(run, other_tool(found, expected.estimate))


def refused(run: JobRun, error: PreconditionError) -> PreconditionError:
    """Return the error, after clearing what the journal estimates: it is no result of this run then."""
    run.tally.depth_um, run.tally.unmeasured_site = math.nan, ""
    return error


def _update_surface(run: JobRun, hole: OpenHole, knowledge: JobKnowledge, pad: SurfaceReading) -> None:
    """Take what the pad tells of the face, and with it where the face is at the hole."""
    fit_pad_slope(run, knowledge.surface, pad)
    hole.face_um, hole.face_u_um = (
        knowledge.surface.height_um(hole.site),
        knowledge.surface.height_u_um(hole.site),
    )


def _on_its_own_surface(
    run: JobRun,
    hole: OpenHole,
    knowledge: JobKnowledge,
    z2: SurfaceReading,
    z3: SurfaceReading,
    found: DepthAndWear,
) -> DepthAndWear:
    """Return what was found, with the face as it is beside the hole where this may be other work, of another slope.

    A hole that is hardly begun shows nothing: what the earlier run has touched of the face counts no more then.
    """
    hole_found, knowledge.surface = knowledge.surface, level_surface(run)
    _update_surface(run, hole, knowledge, z3)
    if hole_found.touched and is_untouched(measured(run, hole, z2, z3)):
        touch_beside(run, hole.site, knowledge.surface, ToolLength(z3))
        run.keeper.set_surface(tuple(knowledge.surface.touched), knowledge.surface.doubt_u_um)
        _update_surface(run, hole, knowledge, z3)
        return measured(run, hole, z2, z3)
    knowledge.surface = hole_found
    _update_surface(run, hole, knowledge, z3)
    return found


def _check_finished(run: JobRun, knowledge: JobKnowledge, pad: SurfaceReading) -> None:
    result = list(run.tally.sites.values())[-1]
    site = Place(result.name, result.x_um, result.y_um, result.theta_deg)
    expected = expected_of_finished(result)
    hole = hole_at(run, site, knowledge, pad, 0.0)
    predicted_um = pad.z_um + hole.face_um + result.depth_um
    bottom = _touch(run, "Z2", site, site.name, predicted_um, expected.depth_reach_um)
    found = measured(run, hole, bottom, pad)
    if not expected.depth_fits(found):
        raise refused(run, other_work(site, found, expected.estimate, begun=False))
    run.decide(
        RunEvent.RESUMED,
        f"{site.name}, finished before, is {found.depth_um:.2f} µm deep; {result.depth_um:.2f} µm were expected.",
        {"depth_um": found.depth_um, "expected_um": result.depth_um},
    )


def _start_again(
    run: JobRun, site: Place, knowledge: JobKnowledge, pad: SurfaceReading, found: DepthAndWear
) -> None:
    """Begin the hole anew where its face is untouched, beside the finished holes that belong to it."""
    if not is_untouched(found):
        raise refused(run, hole_found(site, found))
    if run.tally.sites:
        _check_finished(run, knowledge, pad)
    knowledge.tool = ToolLength(pad)
    run.tally.depth_um, run.tally.unmeasured_site = 0.0, ""
    run.decide(
        RunEvent.RESUMED,
        f"The face at {site.name} is untouched ({length(found.depth_um, found.depth.u95)}): the hole is "
        "made from the start.",
        {"depth_um": found.depth_um},
    )


def _touch(
    run: JobRun, kind: str, place: Place, name: str, predicted_um: float, reach_um: float
) -> SurfaceReading:
    """Touch a surface that was left; where none is in reach, say what that may mean."""
    u_um = (reach_um + BEYOND_UM) / BEYOND_SIGMAS
    try:
        if place == run.job.pad:
            return read_pad(run, kind, name, predicted_um, u_um)
        move_to(run, place)
        return take_reading(run, kind, name, predicted_um, u_um)
    except MachineFault as fault:
        if fault.code == NO_CONTACT:
            fault.hint += (
                f" The journal expects contact at {predicted_um:.1f} µm, {place.name}: work, place or tool may not "
                "be those that were left."
            )
        raise


def _touch_washed(run: JobRun, site: Place, short: SurfaceReading, reach_um: float) -> SurfaceReading:
    """Touch a bottom again that seems too near: what lay on it while the job stood still may go with the oil."""
    run.decide(
        RunEvent.TOUCH_DOUBTED,
        f"Z2 = {short.z_um:.2f} µm is nearer than the journal expects (a chip?). It is touched again.",
        {"kind": "Z2", "z_um": short.z_um},
        level=EventLevel.WARNING,
    )
    run.recorder.append(RejectedTouch(short.time_s))
    wash(run, short.z_um)
    return _touch(run, "Z2", site, site.name, short.z_um, reach_um)


def _begin(run: JobRun, knowledge: JobKnowledge, state: JobState) -> None:
    """Take over what was touched of the face, and say what an unknown pause means."""
    if not knowledge.surface.touched:
        knowledge.surface.restore(state.face, state.face_doubt_u_um)
    report_unknown_pause(run)


def report_unknown_pause(run: JobRun) -> None:
    """Say what it means that nobody knows how long the job stood still."""
    if math.isfinite(run.job.pause_s):
        return
    drift_um = 2.0 * pause_drift_u_um(run.job)
    run.decide(
        RunEvent.RESUMED,
        "Nobody knows how long the job stood still: a clock was set back, or was not told. Depth is touched anew; "
        f"the wear's interval holds a drift of ± {drift_um:.0f} µm.",
        {"drift_um": drift_um},
        level=EventLevel.WARNING,
    )


def z1_left_by(run: JobRun, state: JobState) -> SurfaceReading:
    """Return Z1 as the journal tells it; times before this run are negative."""
    return SurfaceReading(
        kind="Z1",
        reading=Reading(state.z1_um, state.z1_sd_um, state.z1_touches),
        model_um=state.z1_model_um,
        actuator_v=math.nan,
        time_s=state.z1_time_s - state.time_s - counted_pause_s(run.job),
        zero_um=math.nan,
        doubt_u_um=state.z1_doubt_u_um,
    )


def _hole(run: JobRun, site: Place, knowledge: JobKnowledge, state: JobState) -> OpenHole:
    """Return the hole as the journal left it."""
    z1 = z1_left_by(run, state)
    knowledge.tool = ToolLength(z1, state.wear_um)
    hole = hole_at(run, site, knowledge, z1, state.z1_u_um)
    hole.interrupted = True
    hole.sums.before = CutTotals(state.cuts, state.counts, state.energy_j, state.machining_time_s)
    hole.sums.broken_cuts = state.broken_cuts
    if run.profile.regimes:
        hole.regime = RegimeBegun(state.regime_depth_um, state.regime_wear_um, hole.sums.before)
    return hole


def resume_through_hole(run: JobRun, site: Place, knowledge: JobKnowledge, limits: TimeLimits) -> Decision:
    """Measure what an earlier run has left of a hole through the sheet, and cut on where it is not open.

    A hole is open when the tool goes through it, as far below the face as it would have been fed, and meets nothing;
    and a rim that the first touch has met is gone after an approach without sparks.
    Raises PreconditionError E8060, E8061 where it is not the hole, or the tool, that was left.
    """
    state, target = run.job.resumed, run.target_at(site)
    assert state is not None
    expected = expected_of_left(state, run.profile)
    opened = expected.through_at_most(target.depth_um)
    # Behind the sheet a tool does not wear, although its feed was divided as if it did.
    not_worn_um = expected.estimate.wear_um - opened.estimate.wear_um
    hole, pad = touch_pad_left(run, site, knowledge, opened, not_worn_um)
    least_um = max(0.0, expected.estimate.depth_um - expected.depth_reach_um - BEYOND_UM)
    bottom = touch_bottom_or_none(run, hole, pad, pad.z_um + hole.face_um + least_um)
    if bottom is None:
        return _open(run, hole, knowledge, pad, opened)
    found = measured(run, hole, bottom, pad)
    refuse_other(run, site, expected, found)
    found = learn(run, hole, knowledge, bottom, pad, (knowledge.gap_um, knowledge.gap_u_um))
    report_resumed(run, expected.estimate, found.depth_um, found.wear_um)
    start = next_start(run, hole, knowledge)
    plan = through_plan(max(1, hole.sums.total.number) + 1, start, target, knowledge.estimate)
    try:
        return cut_to_the_end(run, hole, knowledge, plan, limits)
    except MachineFault as fault:
        is_in_approach = hole.plan is None
        is_near = is_near_back(found.depth_um, found.depth.u, target.depth_um)
        if fault.code != NO_SPARK or not is_in_approach or not is_near:
            raise
        run.machine.clear_fault(fault.fault)
        run.machine.arm()
        if touch_bottom_or_none(run, hole, pad, bottom.z_um) is not None:
            raise
    return _open(run, hole, knowledge, pad, opened)


def _open(
    run: JobRun, hole: OpenHole, knowledge: JobKnowledge, pad: SurfaceReading, expected: ExpectedHole
) -> Decision:
    """Return the end of a hole that was open when it was looked at again."""
    target = hole.target
    tip_um = pad.z_um + hole.face_um + target.depth_um + target.completion_um
    hole.stops += 1
    hole.bottom, hole.pad = hole.z1.shifted(tip_um - hole.z1.z_um), pad
    found = measured(run, hole, hole.bottom, pad)
    if expected.estimate.depth_um + expected.depth_reach_um < target.depth_um - target.tolerance_um:
        raise refused(run, other_work(hole.site, found, expected.estimate, begun=True))
    if not expected.wear_fits(found):
        raise refused(run, other_tool(found, expected.estimate))
    knowledge.tool = ToolLength(pad)
    # The tip went further than the sheet is thick: what is taken up is an open hole.
    report_resumed(run, expected.estimate, target.depth_um, found.wear_um)
    hole.report(run, found, knowledge.gap_um, through=True)
    decision = Decision(None, through_message(target, found))
    run.decide(RunEvent.TARGET_REACHED, decision.message, {"depth_um": found.depth_um})
    close_site(run, settled=True)
    return decision
