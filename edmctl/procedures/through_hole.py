"""The end of a hole through the sheet: there is no bottom to touch, so the pad tells the wear."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from edmctl.labels import Basis
from edmctl.procedures.codes import RunEvent
from edmctl.procedures.cut import CutEnd
from edmctl.procedures.deciding import Decision, unfinished
from edmctl.procedures.measuring_stop import measured, touch_pad
from edmctl.procedures.tool_length import ToolLength
from edmctl.record.rows import EventLevel

if TYPE_CHECKING:
    from edmctl.procedures.cut import CutResult
    from edmctl.procedures.hole import Hole, Known
    from edmctl.procedures.planning import CutPlan
    from edmctl.procedures.run import Run
    from edmctl.process.wear import DepthAndWear


def end_of_through_hole(run: Run, hole: Hole, known: Known, plan: CutPlan, cut: CutResult) -> Decision:
    """Measure the wear; the depth is how far the tip went below the face, at least the sheet's thickness."""
    anywhere_u_um = hole.goal.completion_um / math.sqrt(
        12.0
    )  # where in the last feed the tool stopped wearing
    pad = touch_pad(run, hole, plan, cut, more_u_um=anywhere_u_um)
    # A bottom lies a working gap below the tip; behind the sheet there is none.
    tip_um = max(cut.end_displacement_um + (0.0 if cut.through else plan.gap_um), hole.surface_um)
    hole.stops += 1
    hole.bottom, hole.pad = hole.z1.shifted(tip_um - hole.z1.z_um), pad
    found = measured(run, hole, hole.bottom, pad)
    known.tool = ToolLength(pad)
    hole.report(run, found, plan.gap_um, through=cut.through, depth_basis=Basis.ESTIMATED)
    decision = _decision(hole, cut, found)
    code = RunEvent.TARGET_MISSED if decision.missed else RunEvent.TARGET_REACHED
    level = EventLevel.WARNING if decision.missed else EventLevel.INFO
    run.decide(code, decision.message, {"depth_um": found.depth_um, "hint": decision.hint}, level=level)
    return decision


def _decision(hole: Hole, cut: CutResult, found: DepthAndWear) -> Decision:
    thickness_um = hole.goal.depth_um
    if cut.through:
        return Decision(
            None,
            f"Through the sheet of {thickness_um:g} µm; the tip went {found.depth_um:.1f} µm below its face.",
        )
    if cut.end is not CutEnd.REACHED:
        return unfinished(hole.goal, cut, found.depth_um, found.feed_um)
    missed = f"The sheet of {thickness_um:g} µm did not break through within {found.depth_um:.1f} µm."
    return Decision(None, missed, missed, "Check work.thickness_um; a thicker sheet needs more stroke.")
