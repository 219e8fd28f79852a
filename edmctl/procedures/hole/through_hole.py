"""The end of a hole through the sheet: there is no bottom to touch, so the pad tells the wear."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from edmctl.errors import MachineFault
from edmctl.labels import Basis
from edmctl.procedures.event_codes import RunEvent
from edmctl.procedures.hole.cut import CutEnd
from edmctl.procedures.hole.cut_decision import Decision, unfinished
from edmctl.procedures.hole.measuring_stop import measured, touch_pad
from edmctl.procedures.stages import move_to
from edmctl.procedures.touch.reading import NO_CONTACT, search_near, take_reading_in
from edmctl.procedures.touch.tool_length import ToolLength
from edmctl.record.rows import EventLevel

if TYPE_CHECKING:
    from edmctl.procedures.hole.cut import CutResult
    from edmctl.procedures.hole.cut_planning import CutPlan
    from edmctl.procedures.hole.hole import Hole, Known
    from edmctl.procedures.hole.target import Goal
    from edmctl.procedures.run import Run
    from edmctl.procedures.touch.reading import SurfaceReading
    from edmctl.process.wear import DepthAndWear


def end_of_through_hole(run: Run, hole: Hole, known: Known, plan: CutPlan, cut: CutResult) -> Decision:
    """Measure the wear; the depth is how far the tip went below the face, at least the sheet's thickness."""
    anywhere_u_um = hole.goal.completion_um / math.sqrt(
        12.0
    )  # where in the last feed the tool stopped wearing
    pad = touch_pad(run, hole, plan, cut, more_u_um=anywhere_u_um)
    through = cut.through
    if hole.interrupted and not through and cut.end is CutEnd.REACHED:
        # Too near to the back from the start for the feed to tell.
        through = touch_bottom_or_none(run, hole, pad, hole.bottom.z_um) is None
    # A bottom lies a working gap below the tip; behind the sheet there is none.
    tip_um = max(cut.end_displacement_um + (0.0 if through else plan.gap_um), hole.surface_um)
    hole.stops += 1
    hole.bottom, hole.pad = hole.z1.shifted(tip_um - hole.z1.z_um), pad
    found = measured(run, hole, hole.bottom, pad)
    known.tool = ToolLength(pad)
    hole.report(run, found, plan.gap_um, through=through, depth_basis=Basis.ESTIMATED)
    decision = _decision(hole, cut, found, through=through)
    code = RunEvent.TARGET_MISSED if decision.missed else RunEvent.TARGET_REACHED
    level = EventLevel.WARNING if decision.missed else EventLevel.INFO
    run.decide(code, decision.message, {"depth_um": found.depth_um, "hint": decision.hint}, level=level)
    return decision


def touch_bottom_or_none(run: Run, hole: Hole, pad: SurfaceReading, least_um: float) -> SurfaceReading | None:
    """Touch the bottom of a hole that may be open, from `least_um` on; None where the tool goes right through.

    That is to beyond the back by as much as the hole is fed on behind it.
    """
    search = search_near(run, least_um, 0.0)
    search = replace(search, z_max_um=pad.z_um + hole.face_um + hole.goal.depth_um + hole.goal.completion_um)
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


def told_through(goal: Goal, found: DepthAndWear) -> str:
    """The end of a hole that is open, in words."""
    return f"Through the sheet of {goal.depth_um:g} µm; the tip went {found.depth_um:.1f} µm below its face."


def _decision(hole: Hole, cut: CutResult, found: DepthAndWear, *, through: bool) -> Decision:
    thickness_um = hole.goal.depth_um
    if through:
        return Decision(None, told_through(hole.goal, found))
    if cut.end is not CutEnd.REACHED:
        return unfinished(hole.goal, cut, found.depth_um, found.feed_um)
    missed = f"The sheet of {thickness_um:g} µm did not break through within {found.depth_um:.1f} µm."
    return Decision(None, missed, missed, "Check work.thickness_um; a thicker sheet needs more stroke.")
