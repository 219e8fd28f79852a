"""The result of a hole, for people, scripts and the run file."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from edmctl.procedures.actuator.tracker import FeedError
from edmctl.procedures.hole.target import goal_of
from edmctl.procedures.hole.verdict import judged
from edmctl.process.erosion import hole_area_um2, mrr_mm3_min, tool_area_um2
from edmctl.record.rows import SiteRow
from edmctl.results.job import SiteResult
from edmctl.results.pulses import pulse_shares

if TYPE_CHECKING:
    from edmctl.labels import Basis
    from edmctl.procedures.hole.cut import CutResult
    from edmctl.procedures.job import Site
    from edmctl.procedures.job_state import RunningCut
    from edmctl.procedures.run import Run
    from edmctl.process.wear import DepthAndWear
    from edmctl.profile.model import Profile

Counts = tuple[int, int, int, int]


@dataclass(frozen=True, slots=True)
class Heights:
    """Displacements at contact: `z1` and `z3` with the pad before and after, `z2` with the bottom; sensor or model.

    `height_um` is how much further than the pad the face lies at the site.
    """

    z1_um: float
    z2_um: float
    z3_um: float
    height_um: float = 0.0

    @property
    def depth_um(self) -> float:
        """Z2 - Z3, from the site's own face."""
        return self.z2_um - self.z3_um - self.height_um


@dataclass(slots=True)
class CutSums:
    """What the cuts of a hole add up to. `before_*` are those of an earlier run, and one that was broken off."""

    cuts: list[CutResult] = field(default_factory=list)
    before_counts: Counts = (0, 0, 0, 0)
    before_energy_j: float = 0.0
    before_time_s: float = 0.0
    before_cuts: int = 0
    broken_cuts: int = 0
    """So many of them came to no end: they do not use up what a hole may still take."""

    def add_broken_off(self, cut: RunningCut) -> None:
        """Add a cut that came to no end."""
        if not cut.time_s > 0.0:
            return
        opens, normals, arcs, shorts = self.before_counts
        more = cut.counts
        self.before_counts = (opens + more[0], normals + more[1], arcs + more[2], shorts + more[3])
        self.before_energy_j += cut.energy_j
        self.before_time_s += cut.time_s
        self.before_cuts += 1
        self.broken_cuts += 1

    @property
    def number(self) -> int:
        """Cuts made."""
        return self.before_cuts + len(self.cuts)

    @property
    def counts(self) -> Counts:
        """Pulses by class: open, normal, arc, short."""
        rows = [self.before_counts, *(cut.counts for cut in self.cuts)]
        sums = [sum(column) for column in zip(*rows, strict=True)]
        return (sums[0], sums[1], sums[2], sums[3])

    @property
    def energy_j(self) -> float:
        """Energy of all cuts."""
        return self.before_energy_j + sum(cut.energy_j for cut in self.cuts)

    @property
    def time_s(self) -> float:
        """Machining time."""
        return self.before_time_s + sum(cut.time_s for cut in self.cuts)

    @property
    def gap_ratio_mean(self) -> float:
        """Normalised gap voltage while sparking; NaN where no cut sparked."""
        sparking = [cut for cut in self.cuts if not math.isnan(cut.gap_ratio_mean)]
        time_s = sum(cut.time_s for cut in sparking)
        return sum(cut.time_s * cut.gap_ratio_mean for cut in sparking) / time_s if time_s else math.nan


@dataclass(frozen=True, slots=True)
class Erosion:
    """Volumes of a hole as ratios and a rate; NaN where there is no depth or no time to refer to."""

    wear_ratio_lin: float
    wear_ratio_vol: float
    mrr_mm3_min: float


def erosion_of(
    profile: Profile, found: DepthAndWear, machining_time_s: float, *, through: bool = False
) -> Erosion:
    """Relative wear, linear and volumetric, and material removal rate of a measured hole.

    Volumes are lengths times the tool's face and the hole's section, a side gap wider all round. A hole `through`
    the sheet is as long as that is thick, however far the tip came out of it.
    """
    length_um = profile.work.thickness_um if through else found.depth_um
    tool_um2 = tool_area_um2(profile.tool.diameter_um)
    hole_um2 = hole_area_um2(profile.tool.diameter_um, profile.work.side_gap_um)
    ratio = found.wear_um / length_um if length_um > 0.0 else math.nan
    removed_um3 = length_um * hole_um2
    return Erosion(
        wear_ratio_lin=ratio,
        wear_ratio_vol=ratio * tool_um2 / hole_um2,
        mrr_mm3_min=mrr_mm3_min(removed_um3 / machining_time_s) if machining_time_s > 0.0 else math.nan,
    )


def site_result(
    profile: Profile,
    site: Site,
    found: DepthAndWear,
    sensor: Heights,
    model: Heights,
    sums: CutSums,
    *,
    gap_um: float,
    stops: int,
    estimated_um: float,
    zero_drift_um: float,
    error: FeedError,
    depth_basis: Basis,
    wear_basis: Basis,
    through: bool = False,
    in_doubt: bool = False,
) -> SiteResult:
    """Put together what is known of a hole."""
    erosion = erosion_of(profile, found, sums.time_s, through=through)
    counts = sums.counts
    return SiteResult(
        name=site.name,
        x_um=site.x_um,
        y_um=site.y_um,
        theta_deg=site.theta_deg,
        depth_um=found.depth_um,
        depth_u95_um=found.depth_u95_um,
        wear_um=found.wear_um,
        wear_u95_um=found.wear_u95_um,
        feed_um=found.feed_um,
        z1_um=sensor.z1_um,
        z2_um=sensor.z2_um,
        z3_um=sensor.z3_um,
        face_um=sensor.height_um,
        measuring_stops=stops,
        estimated_um=estimated_um,
        depth_model_um=model.depth_um,
        wear_model_um=model.z3_um - model.z1_um,
        zero_drift_um=zero_drift_um,
        feed_model_error_max_um=error.max_um,
        feed_model_error_rms_um=error.rms_um,
        feed_model_error_max_pct=_percent(error.max_um, found.feed_um),
        feed_model_error_rms_pct=_percent(error.rms_um, found.feed_um),
        machining_time_s=sums.time_s,
        cuts=sums.number,
        pulses=sum(counts),
        ratios=pulse_shares(*counts),
        gap_ratio_mean=sums.gap_ratio_mean,
        working_gap_um=gap_um,
        energy_j=sums.energy_j,
        wear_ratio_lin=erosion.wear_ratio_lin,
        wear_ratio_vol=erosion.wear_ratio_vol,
        mrr_mm3_min=erosion.mrr_mm3_min,
        through=through,
        depth_basis=depth_basis,
        wear_basis=wear_basis,
        in_doubt=in_doubt,
    )


def site_row(result: SiteResult) -> SiteRow:
    """The same as a row of the run file."""
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
        face_um=result.face_um,
        measuring_stops=result.measuring_stops,
        estimated_um=result.estimated_um,
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
        through=result.through,
        depth_basis=result.depth_basis,
        wear_basis=result.wear_basis,
        verdict=result.verdict or "",
    )


def _percent(part: float, whole: float) -> float:
    return 100.0 * part / whole if whole > 0.0 else math.nan


def open_site(run: Run, site: Site) -> None:
    """Begin the account of a site; the readings of the one before may teach the actuator's estimator now."""
    tally = run.tally
    tally.depth_um, tally.open_site = 0.0, site.name
    tally.depth_target_um = goal_of(run.profile, site).depth_um
    run.watch.feed_error = FeedError()
    tracker = run.watch.tracker()
    if tracker is not None:
        tracker.learn_noted()


def close_site(run: Run, *, settled: bool) -> None:
    """End the account of a site; its result goes into the run file once it is settled, or with the next that is."""
    tally = run.tally
    if tally.open_site in tally.sites:
        tally.unwritten.append(tally.open_site)
    tally.open_site = ""
    if settled:
        record_results(run)


def record_results(run: Run) -> None:
    """Judge and write the results that are not in the run file yet."""
    tally = run.tally
    for name in tally.unwritten:
        tally.sites[name] = judged(run.job, tally.sites[name])
        run.recorder.site_result(site_row(tally.sites[name]))
    tally.unwritten.clear()


def record_left(run: Run) -> None:
    """Write what is known of all holes where the job ends early; the one under way is not judged: it may go on."""
    record_results(run)
    tally = run.tally
    if tally.open_site in tally.sites:
        tally.sites[tally.open_site] = replace(tally.sites[tally.open_site], finished=False)
        run.recorder.site_result(site_row(tally.sites[tally.open_site]))
