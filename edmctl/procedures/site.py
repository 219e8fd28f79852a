"""One hole: touch, approach, cut, touch again, until the measured depth is the target."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from edmctl.procedures.approach import approach_bottom, approach_surface, raise_by
from edmctl.procedures.codes import RunEvent
from edmctl.procedures.cut import CutResult, run_cut
from edmctl.procedures.deciding import Decision, decide, out_of_time
from edmctl.procedures.feed_error import FeedError
from edmctl.procedures.measuring import Erosion, depth_and_wear, erosion_of
from edmctl.procedures.planning import CutPlan, first_plan, learned_gap_um
from edmctl.procedures.results import SiteResult
from edmctl.procedures.setup_check import refuse_wrong_setup
from edmctl.procedures.stages import move_to
from edmctl.procedures.touch import SurfaceReading, take_reading
from edmctl.process.pulses import pulse_shares
from edmctl.record.rows import EventLevel, SiteRow

if TYPE_CHECKING:
    from collections.abc import Sequence

    from edmctl.procedures.job import Site
    from edmctl.procedures.run import Run
    from edmctl.procedures.time_limits import TimeLimits
    from edmctl.process.wear import DepthAndWear

CLEAR_OF_BOTTOM_UM = 60.0
"""Before the bottom is touched the tool rises by this: clear of 20 µm for the contact check."""
OFFSET_UNCERTAINTY_UM = 10.0
"""How well the distance to the untouched surface is known before the first touch."""
WEAR_UNCERTAINTY_SHARE = 0.05
"""Uncertainty of the wear that is predicted for Z3, as a share of the feed."""


def machine_site(run: Run, site: Site, limits: TimeLimits) -> Decision:
    """Machine one hole and return the last decision.

    The ledger holds the hole's result after every measured cut, so that it is there whatever comes next.
    """
    run.ledger.depth_um, run.ledger.open_site = 0.0, site.name
    run.ledger.depth_target_um = run.depth_target_um
    run.watch.feed_error = FeedError()
    tracker = run.watch.tracker()
    if tracker is not None:
        tracker.learn_noted()
    move_to(run, run.job.pad)
    z1 = take_reading(run, "Z1", site.name, run.profile.approach.offset_um, OFFSET_UNCERTAINTY_UM)
    plan: CutPlan | None = first_plan(run.profile, z1.z_um)
    cuts: list[CutResult] = []
    while plan is not None:
        decision = _cut_and_measure(run, site, plan, cuts, z1, limits)
        plan = decision.plan
    record_open_site(run)
    return decision


def record_open_site(run: Run) -> None:
    """Write the result of the hole under way to the run file, if it has been measured."""
    result = run.ledger.sites.get(run.ledger.open_site)
    if result is not None:
        run.recorder.site_result(_row(result))
    run.ledger.open_site = ""


def _cut_and_measure(
    run: Run,
    site: Site,
    plan: CutPlan,
    cuts: list[CutResult],
    z1: SurfaceReading,
    limits: TimeLimits,
) -> Decision:
    """One planned cut, unless the time is up: looked at before the approach, which sparks, and after it."""
    if limits.left().seconds <= 0.0:
        return _no_time(run, plan, limits)
    move_to(run, site)
    if cuts:
        approach_bottom(run, plan.bottom_um)
    else:
        approach_surface(run)
    left = limits.left()
    if left.seconds <= 0.0:
        return _no_time(run, plan, limits)
    machined_before_s = run.ledger.machining_time_s
    run.ledger.unmeasured_site = site.name
    cuts.append(run_cut(run, plan, left))
    run.ledger.machining_time_s = machined_before_s + cuts[-1].time_s
    run.ledger.depth_um = plan.depth_at(cuts[-1].end_displacement_um)
    decision = _measure_and_decide(run, site, plan, cuts, z1)
    run.ledger.unmeasured_site = ""
    return decision


def _no_time(run: Run, plan: CutPlan, limits: TimeLimits) -> Decision:
    decision = out_of_time(run.profile, plan, limits.left().limit)
    run.decide(
        RunEvent.TARGET_MISSED,
        decision.message,
        {"cut": plan.number, "depth_um": plan.depth_before_um},
        level=EventLevel.WARNING,
    )
    return decision


def _measure_and_decide(
    run: Run, site: Site, plan: CutPlan, cuts: Sequence[CutResult], z1: SurfaceReading
) -> Decision:
    end_um = cuts[-1].end_displacement_um
    raise_by(run, CLEAR_OF_BOTTOM_UM)
    z2 = take_reading(run, "Z2", site.name, end_um + plan.gap_um)
    move_to(run, run.job.pad)
    z3 = take_reading(run, "Z3", site.name, *_predicted_surface(plan, z1, z2))
    found = depth_and_wear(run.job, z1, z2, z3)
    gap_um = learned_gap_um(z2.z_um, end_um)
    run.ledger.depth_um = found.depth_um
    erosion = erosion_of(run.profile, found, sum(cut.time_s for cut in cuts))
    readings, error = (z1, z2, z3), run.watch.feed_error
    run.ledger.sites[site.name] = _site_result(site, found, readings, cuts, gap_um, erosion, error)
    if plan.number == 1:
        refuse_wrong_setup(run, found)
    decision = decide(run.profile, plan, cuts[-1], found, z2.z_um, gap_um)
    _report(run, found, gap_um, decision)
    return decision


def _predicted_surface(plan: CutPlan, z1: SurfaceReading, z2: SurfaceReading) -> tuple[float, float]:
    """Where the worn tool will meet the pad, and how well that is known, µm."""
    feed_um = max(0.0, z2.z_um - plan.bottom_um)
    wear_um = plan.wear_before_um + feed_um * plan.wear_ratio / (1.0 + plan.wear_ratio)
    return z1.z_um + wear_um, WEAR_UNCERTAINTY_SHARE * feed_um


def _report(run: Run, found: DepthAndWear, gap_um: float, decision: Decision) -> None:
    run.decide(
        RunEvent.SITE_MEASURED,
        f"Depth {found.depth_um:.2f} ± {found.depth_u95_um:.2f} µm, wear {found.wear_um:.2f} ± "
        f"{found.wear_u95_um:.2f} µm, working gap {gap_um:.2f} µm.",
        {
            "depth_um": found.depth_um,
            "wear_um": found.wear_um,
            "wear_ratio": found.wear_ratio,
            "gap_um": gap_um,
        },
    )
    if decision.plan is None:
        code = RunEvent.TARGET_MISSED if decision.missed else RunEvent.TARGET_REACHED
        level = EventLevel.WARNING if decision.missed else EventLevel.INFO
        run.decide(code, decision.message, {"depth_um": found.depth_um}, level=level)
    else:
        run.decide(RunEvent.CUT_DECIDED, decision.message, {"feed_um": decision.plan.feed_um})


def _site_result(
    site: Site,
    found: DepthAndWear,
    readings: tuple[SurfaceReading, SurfaceReading, SurfaceReading],
    cuts: Sequence[CutResult],
    gap_um: float,
    erosion: Erosion,
    error: FeedError,
) -> SiteResult:
    z1, z2, z3 = readings
    counts = [sum(column) for column in zip(*(cut.counts for cut in cuts), strict=True)]
    return SiteResult(
        name=site.name,
        x_um=site.x_um,
        y_um=site.y_um,
        depth_um=found.depth_um,
        depth_u95_um=found.depth_u95_um,
        wear_um=found.wear_um,
        wear_u95_um=found.wear_u95_um,
        feed_um=found.feed_um,
        z1_um=z1.z_um,
        z2_um=z2.z_um,
        z3_um=z3.z_um,
        depth_model_um=z2.model_um - z3.model_um,
        wear_model_um=z3.model_um - z1.model_um,
        zero_drift_um=z3.zero_um - z1.zero_um,
        feed_model_error_max_um=error.max_um,
        feed_model_error_rms_um=error.rms_um,
        feed_model_error_max_pct=_percent(error.max_um, found.feed_um),
        feed_model_error_rms_pct=_percent(error.rms_um, found.feed_um),
        machining_time_s=sum(cut.time_s for cut in cuts),
        cuts=len(cuts),
        pulses=sum(counts),
        ratios=pulse_shares(*counts),
        gap_ratio_mean=_gap_ratio_mean(cuts),
        working_gap_um=gap_um,
        energy_j=sum(cut.energy_j for cut in cuts),
        wear_ratio_lin=erosion.wear_ratio_lin,
        wear_ratio_vol=erosion.wear_ratio_vol,
        mrr_mm3_min=erosion.mrr_mm3_min,
    )


def _percent(part: float, whole: float) -> float:
    return 100.0 * part / whole if whole > 0.0 else math.nan


def _gap_ratio_mean(cuts: Sequence[CutResult]) -> float:
    sparking = [cut for cut in cuts if not math.isnan(cut.gap_ratio_mean)]
    time_s = sum(cut.time_s for cut in sparking)
    return sum(cut.time_s * cut.gap_ratio_mean for cut in sparking) / time_s if time_s else math.nan


def _row(result: SiteResult) -> SiteRow:
    return SiteRow(
        site=result.name,
        x_um=result.x_um,
        y_um=result.y_um,
        z1_um=result.z1_um,
        z2_um=result.z2_um,
        z3_um=result.z3_um,
        depth_um=result.depth_um,
        depth_u95_um=result.depth_u95_um,
        wear_um=result.wear_um,
        wear_u95_um=result.wear_u95_um,
        feed_um=result.feed_um,
        depth_model_um=result.depth_model_um,
        wear_model_um=result.wear_model_um,
        zero_drift_um=result.zero_drift_um,
        feed_model_error_max_um=result.feed_model_error_max_um,
        feed_model_error_rms_um=result.feed_model_error_rms_um,
        feed_model_error_max_pct=result.feed_model_error_max_pct,
        feed_model_error_rms_pct=result.feed_model_error_rms_pct,
        machining_time_s=result.machining_time_s,
        cuts=result.cuts,
        pulses=result.pulses,
        ratio_open=result.ratios.open,
        ratio_normal=result.ratios.normal,
        ratio_arc=result.ratios.arc,
        ratio_short=result.ratios.short,
        energy_j=result.energy_j,
        wear_ratio_lin=result.wear_ratio_lin,
        wear_ratio_vol=result.wear_ratio_vol,
        mrr_mm3_min=result.mrr_mm3_min,
        depth_model_error_um=result.depth_model_um - result.depth_um,
        wear_model_error_um=result.wear_model_um - result.wear_um,
    )
