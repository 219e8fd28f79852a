"""A hole that an earlier run left in the middle: pad and bottom are touched again, then it goes on.

Retraction is certain, because the tool comes back to 0 V without power. So the pad tells how much tool is left, and
the bottom how deep the hole is; nothing that was estimated before the interruption enters the result.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from edmctl.procedures.codes import RunEvent
from edmctl.procedures.deciding import Decision, decide
from edmctl.procedures.hole import Hole, Known, close_site, hole_at
from edmctl.procedures.measuring_stop import learn, next_start, report
from edmctl.procedures.pad import read_pad
from edmctl.procedures.planning import CutPlan
from edmctl.procedures.site import cut_to_the_end
from edmctl.procedures.stages import move_to
from edmctl.procedures.tool_length import ToolLength
from edmctl.procedures.touch import SurfaceReading, take_reading
from edmctl.process.plane import Plane
from edmctl.process.wear import Reading

if TYPE_CHECKING:
    from edmctl.procedures.job import Site
    from edmctl.procedures.journal import JobState
    from edmctl.procedures.run import Run
    from edmctl.procedures.time_limits import TimeLimits

UNKNOWN_U_UM = 4.0
"""Standard uncertainty of where the journal says that pad and bottom are: some seconds of a cut, a fault's retreat,
drift."""
UNKNOWN_U_SHARE = 0.02
"""And so much of the feed, because the journal's depth is an estimate."""


def take_up_hole(run: Run, site: Site, known: Known, limits: TimeLimits) -> Decision:
    """Measure what the earlier run has left, and cut what is missing."""
    state = run.job.resumed
    assert state is not None
    if state.slope is not None:
        known.face = _face(run, state.slope)
    hole = _hole(run, site, known, state)
    run.ledger.depth_um = state.depth_um
    run.journal.begin_hole(hole, run.machine.time_s, begun=True)
    u_um = UNKNOWN_U_UM + UNKNOWN_U_SHARE * (state.depth_um + state.wear_um)
    z3 = read_pad(run, "Z3", site.name, hole.z1.z_um + state.wear_um, u_um)
    move_to(run, site)
    z2 = take_reading(run, "Z2", site.name, z3.z_um + hole.face_um + state.depth_um, u_um)
    gap_u_um = known.gap_u_um
    found = learn(run, hole, known, z2, z3, known.gap_um)
    known.gap_u_um = gap_u_um  # no cut of this run has shown it yet
    run.ledger.unmeasured_site = ""
    run.decide(
        RunEvent.RESUMED,
        f"Taken up again at {found.depth_um:.2f} µm depth and {found.wear_um:.2f} µm wear; the journal expected "
        f"{state.depth_um:.1f} and {state.wear_um:.1f} µm.",
        {"depth_um": found.depth_um, "wear_um": found.wear_um, "expected_um": state.depth_um},
    )
    start = next_start(hole, known.gap_um, known.gap_u_um)
    last = CutPlan(max(1, hole.sums.number), 0.0, start, known.estimate, hole.goal.depth_um)
    decision = decide(run.profile, hole.goal, last, None, found, start, known.estimate)
    report(run, found, known.gap_um, decision)
    if decision.plan is None:
        close_site(run, settled=True)
        return decision
    return cut_to_the_end(run, hole, known, decision.plan, limits)


def _hole(run: Run, site: Site, known: Known, state: JobState) -> Hole:
    """Return the hole as the journal left it; times before this run are negative."""
    z1 = SurfaceReading(
        kind="Z1",
        reading=Reading(state.z1_um, state.z1_sd_um, state.z1_touches),
        model_um=state.z1_model_um,
        actuator_v=math.nan,
        time_s=state.z1_time_s - state.time_s - run.job.pause_s,
        zero_um=math.nan,
    )
    known.tool = ToolLength(z1, state.wear_um)
    hole = hole_at(run, site, known, z1, 0.0)
    hole.interrupted = True
    sums = hole.sums
    sums.before_counts, sums.before_cuts = state.counts, state.cuts
    sums.before_energy_j, sums.before_time_s = state.energy_j, state.machining_time_s
    return hole


def _face(run: Run, slope: tuple[float, float]) -> Plane:
    import numpy as np

    pad = run.job.pad
    return Plane((pad.x_um, pad.y_um), np.array(slope), np.zeros((2, 2)))
