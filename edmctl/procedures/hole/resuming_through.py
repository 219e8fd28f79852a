"""A hole through a sheet that an earlier run left in the middle: it may be open, or have a bottom still.

The pad tells the wear, as for any hole ([0022]). Then the tool itself is the gauge: it is let down to where the hole
would have been fed to, and either meets a bottom or goes right through.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.labels import Basis
from edmctl.procedures.event_codes import RunEvent
from edmctl.procedures.hole.cut_decision import Decision
from edmctl.procedures.hole.cut_planning import through_plan
from edmctl.procedures.hole.expected_touches import expected_of_left
from edmctl.procedures.hole.measuring_stop import learn, measured, next_start
from edmctl.procedures.hole.resume_refusals import other_tool, other_work
from edmctl.procedures.hole.resuming import BEYOND_UM, refuse_other, refused, tell_taken_up, touch_pad_left
from edmctl.procedures.hole.site import cut_to_the_end
from edmctl.procedures.hole.site_result import close_site
from edmctl.procedures.hole.target import goal_of
from edmctl.procedures.hole.through_hole import told_through, touch_bottom_or_none
from edmctl.procedures.touch.tool_length import ToolLength

if TYPE_CHECKING:
    from edmctl.procedures.hole.expected_touches import Expected
    from edmctl.procedures.hole.hole import Hole, Known
    from edmctl.procedures.job import Site
    from edmctl.procedures.run import Run
    from edmctl.procedures.servo.time_limits import TimeLimits
    from edmctl.procedures.touch.reading import SurfaceReading


def take_up_through_hole(run: Run, site: Site, known: Known, limits: TimeLimits) -> Decision:
    """Measure what an earlier run has left of a hole through the sheet, and cut on where it is not open.

    A hole is open when the tool goes through it, as far below the face as it would have been fed, and meets nothing.
    Raises PreconditionError E8060, E8061 where it is not the hole, or the tool, that was left.
    """
    state, goal = run.job.resumed, goal_of(run.profile, site)
    assert state is not None
    expected = expected_of_left(state, run.profile)
    opened = expected.through_at_most(goal.depth_um)
    # Behind the sheet a tool does not wear, although its feed was divided as if it did.
    not_worn_um = expected.estimate.wear_um - opened.estimate.wear_um
    hole, pad = touch_pad_left(run, site, known, opened, not_worn_um)
    least_um = max(0.0, expected.estimate.depth_um - expected.depth_reach_um - BEYOND_UM)
    bottom = touch_bottom_or_none(run, hole, pad, pad.z_um + hole.face_um + least_um)
    if bottom is None:
        return _open(run, hole, known, pad, opened)
    found = measured(run, hole, bottom, pad)
    refuse_other(run, site, expected, found)
    found = learn(run, hole, known, bottom, pad, (known.gap_um, known.gap_u_um))
    tell_taken_up(run, expected.estimate, found.depth_um, found.wear_um)
    start = next_start(run, hole, known.gap_um, known.gap_u_um)
    plan = through_plan(max(1, hole.sums.number) + 1, start, goal, known.estimate)
    return cut_to_the_end(run, hole, known, plan, limits)


def _open(run: Run, hole: Hole, known: Known, pad: SurfaceReading, expected: Expected) -> Decision:
    """The end of a hole that was open when it was looked at again."""
    goal = hole.goal
    tip_um = pad.z_um + hole.face_um + goal.depth_um + goal.completion_um
    hole.stops += 1
    hole.bottom, hole.pad = hole.z1.shifted(tip_um - hole.z1.z_um), pad
    found = measured(run, hole, hole.bottom, pad)
    if expected.estimate.depth_um + expected.depth_reach_um < goal.depth_um - goal.tolerance_um:
        raise refused(run, other_work(hole.site, found, expected.estimate, begun=True))
    if not expected.wear_fits(found):
        raise refused(run, other_tool(found, expected.estimate))
    known.tool = ToolLength(pad)
    # The tip went further than the sheet is thick: what is taken up is an open hole.
    tell_taken_up(run, expected.estimate, goal.depth_um, found.wear_um)
    hole.report(run, found, known.gap_um, through=True, depth_basis=Basis.ESTIMATED)
    decision = Decision(None, told_through(goal, found))
    run.decide(RunEvent.TARGET_REACHED, decision.message, {"depth_um": found.depth_um})
    close_site(run, settled=True)
    return decision
