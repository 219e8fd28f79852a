"""State of the hole under way for a run that goes on with it: by the cut, the last touches, or the run before."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from edmctl.procedures.hole.cut_planning import energy_of
from edmctl.procedures.hole.hole_estimate import (
    Estimate,
    estimate_in_cut,
    estimate_left,
    estimate_touched,
    expected_of_left,
    most_um_s,
)
from edmctl.procedures.job_state import RunningCut, UnderWay
from edmctl.procedures.state_keeper import MACHINING, MEASURING

if TYPE_CHECKING:
    from edmctl.procedures.hole.cut import CutResult
    from edmctl.procedures.hole.cut_planning import CutPlan
    from edmctl.procedures.hole.hole import OpenHole
    from edmctl.procedures.job_state import JobState
    from edmctl.procedures.run import JobRun


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
