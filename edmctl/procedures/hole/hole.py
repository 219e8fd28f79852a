"""A hole under way: its readings and cuts, what is known of its depth and wear, and its result."""

from __future__ import annotations

import math

from edmctl.dataclasses import replace
from edmctl.labels import Basis
from edmctl.planning.measuring import FACE_LIMIT_UM
from edmctl.procedures.hole import cut_planning as planning
from edmctl.procedures.hole.cut import CutResult
from edmctl.procedures.hole.cut_planning import CutPlan, CutStart
from edmctl.procedures.job import CutTotals, JobState, RegimeBegun, RunningCut
from edmctl.procedures.run import MACHINING, MEASURING, JobRun
from edmctl.procedures.touch.reading import SurfaceReading
from edmctl.procedures.touch.surfaces import SurfacePlane, drift_between, pad_u_um
from edmctl.process.erosion import hole_area_um2, mrr_mm3_min, tool_area_um2
from edmctl.process.live_erosion import ErosionEstimate
from edmctl.process.shared_wear import SharedWear
from edmctl.process.touches import TOUCH_U_UM, DepthAndWear, measure
from edmctl.profile.places import Place
from edmctl.quantity import Value
from edmctl.results.job import SiteResult

NO_DEPTH = Value(math.nan, math.nan)  # depth of a hole through the sheet


class Hole:
    """The hole under way.

    `z1` is where the tool would have met the pad when the hole began, `z1_u_um` its uncertainty if not touched right
    before; `face_um`, `face_u_um` the height of the surface over the pad. `total` are the sums of its cuts with
    those of an earlier run, of which `broken_cuts` came to no end. `bottom` and `pad` are the readings of the last
    of `stops` measurement cycles, derived from `z1` before the first one; `touched` and `found` depth and wear as
    measured, and with the doubts about them. `interrupted`: an earlier run made discharges that are in no sum;
    `begun`: a cut was started; `plan` is the cut under way, `cut_estimate` the lengths at the end of the last one.
    """

    def __init__(
        self,
        run: JobRun,
        site: Place,
        surface: SurfacePlane,
        estimate: ErosionEstimate,
        z1: SurfaceReading,
        z1_u_um: float = 0.0,
    ) -> None:
        self._run = run
        self.site, self.target = site, run.target_at(site)
        self.z1, self.z1_u_um = z1, z1_u_um
        self.locate_surface(surface)
        self.estimate = estimate if estimate.fits == 0 else estimate.next_hole(self.target.depth_um)
        self.bottom, self.pad = z1.shifted(self.face_um), z1
        self.total, self.regime = CutTotals(), RegimeBegun()
        self.broken_cuts = self.stops = 0
        self._gap_ratios: list[tuple[float, float]] = []
        self.found: DepthAndWear | None = None
        self.touched: DepthAndWear | None = None
        self.interrupted = self.begun = False
        self.plan: CutPlan | None = None
        self.cut_estimate: DepthAndWear | None = None

    @property
    def drift_um(self) -> float:
        """Correction of the last pad reading to the frame of Z1."""
        return self.touched.drift_um if self.touched else 0.0

    def locate_surface(self, surface: SurfacePlane) -> None:
        """Take the height of the workpiece surface at the hole from the plane."""
        self.face_um, self.face_u_um = surface.height_um(self.site), surface.height_u_um(self.site)

    def resume(self, state: JobState) -> None:
        """Take the cuts of an earlier run."""
        self.interrupted = True
        self.total = CutTotals(state.cuts, state.counts, state.energy_j, state.machining_time_s)
        self.broken_cuts = state.broken_cuts
        if self._run.profile.regimes:
            self.regime = RegimeBegun(state.regime_depth_um, state.regime_wear_um, self.total)

    def restart_from(self, pad: SurfaceReading, wear: SharedWear) -> None:
        """Count the hole from a new reading of the pad, which includes its own wear."""
        z1 = self.z1.shifted(pad.z_um - wear.wear_um - self.z1.z_um)
        self.z1, self.z1_u_um = replace(z1, time_s=pad.time_s, rest=pad.rest), wear.wear_u_um

    def measured(self, bottom: SurfaceReading, pad: SurfaceReading) -> DepthAndWear:
        """Return depth and wear by a bottom and a pad, relative to where the hole began."""
        z1 = self.z1
        return measure(
            z1,
            bottom,
            pad,
            self._run.uncertainty,
            tilt_u_um=self.face_u_um,
            pad_u_um=pad_u_um(self._run.setup),
            height_um=self.face_um,
            z1_u_um=self.z1_u_um,
            drift=drift_between(self._run, z1, pad),
        )

    def take_stop(
        self, bottom: SurfaceReading, pad: SurfaceReading, touched: DepthAndWear | None = None
    ) -> None:
        """Take the readings of a measurement cycle, and the lengths if they come from touches of both."""
        self.stops += 1
        self.bottom, self.pad = bottom, pad
        self.touched = touched or self.touched

    def take_tip(self, tip_um: float, pad: SurfaceReading) -> DepthAndWear:
        """Take a pad reading and the end of a way through, where the tip came to `tip_um`; return the lengths."""
        self.take_stop(self.z1.shifted(tip_um - self.z1.z_um), pad)
        return self.measured(self.bottom, pad)

    def learned(self) -> ErosionEstimate:
        """Return the estimate after the last stop, in the regime in use."""
        assert self.touched is not None
        energy = planning.energy_of(self._run.profile.pulse, self.total.since(self.regime.total))
        return self.estimate.fitted(
            None if self.interrupted else energy,
            self.touched.depth_um - self.regime.depth_um,
            self.touched.depth.u,
            self.touched.wear_um - self.regime.wear_um,
            self.touched.wear.u,
        )

    def next_start(self, gap: Value) -> CutStart:
        """Return where another cut of a measured hole would begin, with a working gap to expect."""
        assert self.found is not None
        return CutStart(
            bottom_um=self.bottom.z_um,
            bottom_u_um=math.hypot(TOUCH_U_UM, self.bottom.doubt_u_um),
            gap_um=gap.value,
            time_s=self.bottom.time_s,
            drift_u_um_per_s=self._run.uncertainty.drift_u_um_per_s,
            depth_um=self.found.depth_um,
            depth_u_um=self.found.depth.u,
            wear_um=self.found.wear_um,
            wear_u_um=self.found.wear.u,
            gap_u_um=gap.u,
        )

    def report(
        self,
        found: DepthAndWear,
        gap_um: float,
        *,
        fed_um: float = 0.0,
        worn_um: float = 0.0,
        estimated_um: float = 0.0,
        through: bool = False,
        depth_basis: Basis | None = None,
        wear_basis: Basis | None = None,
    ) -> None:
        """Put its result into the tally: based on the touches, or `fed_um` and `worn_um` further on by estimate."""
        run, site, profile, total = self._run, self.site, self._run.profile, self.total
        z1, z2, z3, touch_basis = self.z1, self.bottom, self.pad, run.job.touch_basis
        bottom_drift_um = self.touched.drift_to_bottom_um if self.touched else 0.0
        self.found = found
        run.tally.depth_um = math.nan if through else found.depth_um
        run.tally.unmeasured_site = ""
        # A hole through the sheet is as long as that is thick, however far the tip came out of it.
        thickness_um = profile.work.thickness_um
        length_um = thickness_um if through else found.depth_um
        hole_um2 = hole_area_um2(profile.tool.diameter_um, profile.work.side_gap_um)
        ratio = found.wear_um / length_um if length_um > 0.0 else math.nan
        sparked_s = sum(time_s for time_s, _ in self._gap_ratios)
        gap_ratio = sum(time_s * ratio for time_s, ratio in self._gap_ratios)
        pad_model_um = z3.model_um + worn_um - self.drift_um
        depth_model_um = z2.model_um + fed_um - bottom_drift_um - pad_model_um - self.face_um
        depth_u95_um, wear_u95_um = model_u95_um(run, found, z2.creep_um - z3.creep_um)
        max_um, rms_um = run.watch.feed_error.figures_um()
        run.tally.sites[site.name] = SiteResult(
            name=site.name,
            x_um=site.x_um,
            y_um=site.y_um,
            theta_deg=site.theta_deg,
            **replace(found, depth=NO_DEPTH if through else found.depth).columns(),
            beyond_exit_um=found.depth_um - thickness_um if through else math.nan,
            beyond_exit_u95_um=found.depth.u95 if through else math.nan,
            z1_um=z1.z_um,
            z2_um=z2.z_um + fed_um - bottom_drift_um,
            z3_um=z3.z_um + worn_um - self.drift_um,
            face_um=self.face_um,
            measuring_stops=self.stops,
            estimated_um=estimated_um,
            depth_model_um=math.nan if through else depth_model_um,
            depth_model_u95_um=math.nan if through else depth_u95_um,
            wear_model_um=pad_model_um - z1.model_um,
            wear_model_u95_um=wear_u95_um,
            zero_drift_um=z3.zero_um - z1.zero_um,
            feed_model_error_max_um=max_um,
            feed_model_error_rms_um=rms_um,
            feed_model_error_max_pct=100.0 * max_um / found.feed_um if found.feed_um > 0.0 else math.nan,
            feed_model_error_rms_pct=100.0 * rms_um / found.feed_um if found.feed_um > 0.0 else math.nan,
            **total.columns(),
            cuts=total.number,
            gap_ratio_mean=gap_ratio / sparked_s if sparked_s else math.nan,
            working_gap_um=gap_um,
            wear_ratio_lin=ratio,
            wear_ratio_vol=ratio * tool_area_um2(profile.tool.diameter_um) / hole_um2,
            mrr_mm3_min=mrr_mm3_min(length_um * hole_um2 / total.time_s) if total.time_s else math.nan,
            through=through,
            depth_basis=None if through else depth_basis or touch_basis,
            wear_basis=wear_basis or (Basis.ESTIMATED if self.z1_u_um > 0.0 else touch_basis),
            in_doubt=(self.stops > 0 and z2.doubt_u_um > 0.0) or self.face_u_um > FACE_LIMIT_UM,
            drift_correction_um=self.drift_um,
            drift_left_u_um=found.drift_left_u_um,
            drift_by_rests=found.drift_by_rests,
        )

    def correct(self, found: DepthAndWear, shorter_um: float, z3_um: float) -> None:
        """Replace its result after a later touch: the tool was `shorter_um` shorter when it began."""
        result = self._run.tally.sites[self.site.name]
        z1_um, z2_um = result.z1_um + shorter_um, z3_um + result.face_um + found.depth_um
        corrected = replace(result, **found.columns(), z1_um=z1_um, z2_um=z2_um, z3_um=z3_um)
        self._run.tally.sites[self.site.name], self.found = corrected, found

    def start_cut(self, plan: CutPlan) -> None:
        self.plan, self.cut_estimate, self.begun = plan, None, True
        self._run.tally.cut = RunningCut(displacement_um=plan.start.bottom_um - plan.start.gap_um)
        self._run.keeper.keep(MACHINING, self)

    def end_cut(self, cut: CutResult) -> None:
        assert self.plan is not None
        run, energy = self._run, planning.energy_of(self._run.profile.pulse, cut)
        self.cut_estimate = planning.estimate_in_cut(
            self.plan, cut.end_displacement_um, energy, run.keeper.time_s
        )
        self.total = self.total.plus(cut)
        if not math.isnan(cut.gap_ratio_mean):
            self._gap_ratios.append((cut.time_s, cut.gap_ratio_mean))
        run.tally.cut = RunningCut(displacement_um=run.tally.cut.displacement_um)
        self.plan = None
        run.keeper.keep(MEASURING, self)

    def keep(self, *, begun: bool = False) -> None:
        """Keep in the journal a hole whose Z1 is known; `begun` if an earlier run has cut it already."""
        self.begun = begun
        self._run.keeper.keep(MEASURING, self, self._run.machine.time_s)

    def add_to(self, state: JobState, now_s: float) -> JobState:
        """Return the state of the job with that of the hole at a time of the run."""
        run, estimate, is_cutting = self._run, self._estimate_at(now_s), self.plan is not None
        state = replace(
            self.z1.as_z1(state, run.tally.earlier_time_s, self.z1_u_um),
            done=tuple(site for site in state.done if site["name"] != self.site.name),
            site=self.site.name,
            begun=self.begun,
            regime=run.regime,
            regime_depth_um=self.regime.depth_um,
            regime_wear_um=self.regime.wear_um,
            broken_cuts=self.broken_cuts + is_cutting,
        )
        return planning.with_cuts(state, run.tally.cut, self.total, self.total.number + is_cutting, estimate)

    def leave(self) -> None:
        """Report by estimate a hole that was cut and not measured, when the job ends early."""
        run, tally, name = self._run, self._run.tally, self.site.name
        if tally.unmeasured_site != name:
            return
        known, resumed, unseen_um = self._estimate_at(run.keeper.time_s), run.job.resumed, 0.0
        if self.plan is not None:
            unseen_s = run.keeper.samples_late_s + run.setup.controller.watchdog_s
            machined_s = self.total.time_s + tally.cut.time_s
            unseen_um = unseen_s * planning.most_um_s(known, machined_s, run.profile)
        elif self.cut_estimate is None and resumed is not None:
            unseen_um = planning.expected_of_left(resumed, run.profile).unseen_um
        is_confirmed = self.estimate.fits > 0 or self.stops > 0
        left = planning.with_unseen(known, unseen_um, self.estimate.wear_ratio, is_confirmed=is_confirmed)
        before_um = self.found.depth_um if self.found else 0.0
        if tally.cut.time_s > 0.0:
            self.total = self.total.plus(tally.cut)
        estimated = Basis.ESTIMATED
        self.report(
            left,
            math.nan,
            estimated_um=left.depth_um - before_um,
            depth_basis=estimated,
            wear_basis=estimated,
        )
        # Z2 and Z3 are unknown then, and the actuator model has no values of its own.
        by_model = ("depth_model_um", "depth_model_u95_um", "wear_model_um", "wear_model_u95_um")
        unknown = dict.fromkeys(("z2_um", "z3_um", *by_model), math.nan)
        tally.sites[name] = replace(tally.sites[name], **unknown)  # type: ignore[arg-type]
        tally.unmeasured_site = name

    def _estimate_at(self, now_s: float) -> DepthAndWear:
        run, cut = self._run, self._run.tally.cut
        if self.plan is not None and not math.isnan(cut.displacement_um):
            energy = planning.energy_of(run.profile.pulse, cut)
            return planning.estimate_in_cut(self.plan, cut.displacement_um, energy, now_s)
        if self.cut_estimate is not None and run.tally.unmeasured_site == self.site.name:
            return self.cut_estimate
        if self.found is not None:
            return self.found
        if self.interrupted and run.job.resumed is not None:
            return planning.estimate_left(run.job.resumed)
        return planning.lengths()


def model_u95_um(run: JobRun, found: DepthAndWear, creep_um: float) -> tuple[float, float]:
    """Return half the 95 % intervals of depth and wear by the actuator model, NaN without a model.

    The sensor sets its zero, so the uncertainty of the measured values is included, and that of `creep_um` in the
    depth.
    """
    tracker = run.watch.tracker()
    if tracker is None:
        return math.nan, math.nan
    if not run.setup.sensor.fitted:
        return found.depth.u95, found.wear.u95
    depth = found.depth.widened(tracker.length_u_um(creep_um))
    return depth.u95, found.wear.widened(tracker.length_u_um(0.0)).u95
