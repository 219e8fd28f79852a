"""The hole under way, and what the holes before it have taught."""

from __future__ import annotations

import math

from edmctl.dataclasses import dataclass, field, replace
from edmctl.labels import Basis
from edmctl.planning.measuring import FACE_LIMIT_UM, estimate_of
from edmctl.procedures.hole.cut_planning import CutPlan, CutStart, energy_of
from edmctl.procedures.hole.hole_estimate import Estimate
from edmctl.procedures.hole.site_result import CutSums
from edmctl.procedures.job import HoleTarget
from edmctl.procedures.job_state import RegimeBegun, SurfaceTouch
from edmctl.procedures.monitoring.drift import pause_drift_u_um
from edmctl.procedures.run import JobRun
from edmctl.procedures.touch.home import pad_from_home_um
from edmctl.procedures.touch.reading import SurfaceReading
from edmctl.procedures.touch.spots import OFFSET_U_UM, ToolLength, read_pad
from edmctl.procedures.touch.surface_plane import SurfacePlane, fit_pad_slope, level_surface
from edmctl.process.discharge import (
    first_gap_u_um,
    first_sparks_um,
    hole_area_um2,
    mrr_mm3_min,
    tool_area_um2,
)
from edmctl.process.live_erosion import Energy, ErosionEstimate
from edmctl.process.shared_wear import WearShare
from edmctl.process.touches import DepthAndWear, Deviation, share_u
from edmctl.profile.model import Profile
from edmctl.profile.places import Place
from edmctl.quantity import Value
from edmctl.results.job import SiteResult
from edmctl.results.telemetry import pulse_shares

NO_DEPTH = Value(math.nan, math.nan)
"""Depth of a hole through the sheet."""
LEFT_U_UM = 4.0
"""Standard uncertainty of the distance to the pad where an earlier run of the job has left the tool, with wear that
it only estimated; without drift."""


@dataclass(slots=True, eq=False)
class JobKnowledge:
    """What a job has learned so far, from hole to hole: tool length, face, removal and wear, working gap.

    `pad_um` is where the pad is expected, with the standard uncertainty `pad_u_um`, before the tool has touched it;
    `gap_u_um` is that of the working gap. `unmeasured` are the cuts since the pad was last touched,
    `pads` all its readings in this run.
    """

    estimate: ErosionEstimate
    surface: SurfacePlane
    gap_um: float
    gap_u_um: float
    tool: ToolLength | None = None
    pad_um: float = math.nan
    pad_u_um: float = OFFSET_U_UM
    unmeasured: list[Unmeasured] = field(default_factory=list)
    pads: list[SurfaceReading] = field(default_factory=list)


def initial_knowledge(run: JobRun) -> JobKnowledge:
    """Return what the recipe and the setup say before the first touch."""
    profile, resumed = run.profile, run.job.resumed
    gap_u_um = first_gap_u_um(profile.pulse.open_voltage_v)
    knowledge = JobKnowledge(
        estimate_of(profile), level_surface(run), profile.measure.expected_gap_um, gap_u_um
    )
    home_um = run.tally.home_um
    knowledge.pad_um = home_um + pad_from_home_um(run)
    if resumed is not None and (resumed.site or run.tally.sites):
        knowledge.pad_u_um = math.hypot(
            LEFT_U_UM, pause_drift_u_um(run.job), share_u(home_um - resumed.home_um)
        )
    return knowledge


@dataclass(frozen=True, slots=True)
class FirstSparks:
    """Where sparks began, and the surface at `bottom_um`, known within `bottom_u_um`, that they are compared with.

    Something `debris_um` high may lie on it, which sparks first.
    """

    z_um: float
    bottom_um: float
    bottom_u_um: float
    debris_um: float

    def off(self, open_voltage_v: float, gap_um: float, gap_u_um: float) -> Deviation:
        """Return how much later they began than such a gap makes them, on the surface or on what lies there."""
        before_um, before_u_um = first_sparks_um(open_voltage_v)
        off_um = self.z_um - (self.bottom_um - gap_um - before_um)
        u_um = math.hypot(self.bottom_u_um, gap_u_um, before_u_um)
        return min(
            Deviation(off_um, u_um),
            Deviation(off_um + self.debris_um, u_um),
            key=lambda off: abs(off.sigmas),
        )


@dataclass(frozen=True, slots=True)
class DoubtedSurface:
    """First sparks that put the face in doubt, with the gap believed then, and what was known of the face before."""

    sparks: FirstSparks
    gap_um: float
    gap_u_um: float
    face_u_um: float
    touched: tuple[SurfaceTouch, ...]
    doubt_u_um: float


@dataclass(slots=True, eq=False)
class OpenHole:
    """The hole under way.

    `z1` is where the tool would have met the pad when the hole began, known within `z1_u_um` where it was not
    touched right before; `face_um` is how much further the face lies here. `bottom` and `pad` are the readings of
    the last measuring stop, the same as `z1` before the first one; `found` is what they say with what
    is doubted of it, `touched` without that; `doubted` are first sparks that have put its face in doubt. An
    `interrupted` hole has had more discharges than anybody counted. `begun` says that it was cut, `plan` is the cut
    under way, `cut_estimate` what was known when the last one ended.
    """

    site: Place
    target: HoleTarget
    z1: SurfaceReading
    z1_u_um: float
    face_um: float
    face_u_um: float
    estimate: ErosionEstimate
    bottom: SurfaceReading
    pad: SurfaceReading
    sums: CutSums = field(default_factory=CutSums)
    stops: int = 0
    found: DepthAndWear | None = None
    touched: DepthAndWear | None = None
    doubted: DoubtedSurface | None = None
    interrupted: bool = False
    begun: bool = False
    plan: CutPlan | None = None
    cut_estimate: Estimate | None = None
    regime: RegimeBegun = field(default_factory=RegimeBegun)

    @property
    def drift_um(self) -> float:
        """What the pad of the last measuring stop was corrected by, from the machine's frame to that of Z1."""
        return self.touched.drift_um if self.touched else 0.0

    @property
    def bottom_drift_um(self) -> float:
        """What the bottom was corrected by, which was touched before that pad."""
        return self.touched.drift_to_bottom_um if self.touched else 0.0

    @property
    def surface_um(self) -> float:
        """Where the tool would have met the untouched face here."""
        return self.z1.z_um + self.face_um

    @property
    def in_doubt(self) -> bool:
        """Whether its bottom, or the face that its depth counts from, may have been touched wrongly."""
        return (self.stops > 0 and self.bottom.doubt_u_um > 0.0) or self.face_u_um > FACE_LIMIT_UM

    def energy(self, run: JobRun) -> Energy:
        """Energy of all its cuts in the regime in use."""
        total = self.sums.total.since(self.regime.total)
        return energy_of(run.profile.pulse, total.counts, total.energy_j)

    def report(
        self,
        run: JobRun,
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
        """Put its result into the tally: as touched, or `fed_um` and `worn_um` further on.

        Without another basis depth and wear rest on the touches; the wear does not where Z1 was not touched.
        """
        touched, error = run.job.touch_basis, run.watch.feed_error
        total, z1, z2, z3 = self.sums.total, self.z1, self.bottom, self.pad
        self.found = found
        run.tally.depth_um = math.nan if through else found.depth_um
        run.tally.unmeasured_site = ""
        ratio_lin, ratio_vol, mrr = _erosion(run.profile, found, total.time_s, through=through)
        depth_model_u95_um, wear_model_u95_um = model_u95_um(run, found, z2.creep_um - z3.creep_um)
        pad_model_um = z3.model_um + worn_um - self.drift_um
        beyond_um = found.depth_um - run.profile.work.thickness_um
        run.tally.sites[self.site.name] = SiteResult(
            name=self.site.name,
            x_um=self.site.x_um,
            y_um=self.site.y_um,
            theta_deg=self.site.theta_deg,
            **replace(found, depth=NO_DEPTH if through else found.depth).columns(),
            beyond_exit_um=beyond_um if through else math.nan,
            beyond_exit_u95_um=found.depth.u95 if through else math.nan,
            z1_um=z1.z_um,
            z2_um=z2.z_um + fed_um - self.bottom_drift_um,
            z3_um=z3.z_um + worn_um - self.drift_um,
            face_um=self.face_um,
            measuring_stops=self.stops,
            estimated_um=estimated_um,
            depth_model_um=math.nan
            if through
            else z2.model_um + fed_um - self.bottom_drift_um - pad_model_um - self.face_um,
            depth_model_u95_um=math.nan if through else depth_model_u95_um,
            wear_model_um=pad_model_um - z1.model_um,
            wear_model_u95_um=wear_model_u95_um,
            zero_drift_um=z3.zero_um - z1.zero_um,
            feed_model_error_max_um=error.max_um,
            feed_model_error_rms_um=error.rms_um,
            feed_model_error_max_pct=_percent(error.max_um, found.feed_um),
            feed_model_error_rms_pct=_percent(error.rms_um, found.feed_um),
            machining_time_s=total.time_s,
            cuts=total.number,
            pulses=sum(total.counts),
            ratios=pulse_shares(*total.counts),
            gap_ratio_mean=self.sums.gap_ratio_mean,
            working_gap_um=gap_um,
            energy_j=total.energy_j,
            wear_ratio_lin=ratio_lin,
            wear_ratio_vol=ratio_vol,
            mrr_mm3_min=mrr,
            through=through,
            depth_basis=None if through else depth_basis or touched,
            wear_basis=wear_basis or (Basis.ESTIMATED if self.z1_u_um > 0.0 else touched),
            in_doubt=self.in_doubt,
            drift_correction_um=self.drift_um,
            drift_left_u_um=found.drift_left_u_um,
            drift_by_rests=found.drift_by_rests,
        )

    def report_left(self, run: JobRun, estimate: Estimate) -> None:
        """Put what is known of it into the tally where the job ends before it is touched.

        Z2 and Z3 are not known then, and the actuator's model has nothing of its own to say of it.
        """
        before = self.found
        self.sums.add_broken_off(run.tally.cut)
        pad_um = self.z1.z_um + estimate.wear_um
        self.report(
            run,
            estimate.as_found(),
            math.nan,
            fed_um=pad_um + self.face_um + estimate.depth_um - self.bottom.z_um + self.bottom_drift_um,
            worn_um=pad_um - self.pad.z_um + self.drift_um,
            estimated_um=estimate.depth_um - (before.depth_um if before else 0.0),
            depth_basis=Basis.ESTIMATED,
            wear_basis=Basis.ESTIMATED,
        )
        tally, name = run.tally, self.site.name
        by_model = ("depth_model_um", "depth_model_u95_um", "wear_model_um", "wear_model_u95_um")
        unknown = dict.fromkeys(("z2_um", "z3_um", *by_model), math.nan)
        tally.sites[name] = replace(tally.sites[name], **unknown)  # type: ignore[arg-type]
        tally.unmeasured_site = name


@dataclass(frozen=True, slots=True, eq=False)
class Unmeasured:
    """A cut that no touch followed: its hole, the wear that is expected of it, and what else is unknown.

    `depth_u_um` is of the hole's depth, but for the tool's length; `wear_before_um` is the hole's wear before the
    cut, known within `wear_before_u_um`.
    """

    hole: OpenHole
    share: WearShare
    depth_u_um: float
    wear_before_um: float
    wear_before_u_um: float


def touch_pad_first(run: JobRun, name: str, knowledge: JobKnowledge) -> SurfaceReading:
    """Touch the pad before anything else (Z1); its two spots may show the slope too."""
    pad = read_pad(run, "Z1", name, knowledge.pad_um, knowledge.pad_u_um)
    knowledge.pads.append(pad)
    return fit_pad_slope(run, knowledge.surface, pad)


def begin_hole(run: JobRun, site: Place, knowledge: JobKnowledge) -> OpenHole:
    """Begin a hole: touch the pad where nothing is known of the tool's length, otherwise go by what is known."""
    if knowledge.tool is None:
        knowledge.tool = ToolLength(touch_pad_first(run, site.name, knowledge))
    return hole_at(
        run, site, knowledge, knowledge.tool.pad.shifted(knowledge.tool.wear_um), knowledge.tool.wear_u_um
    )


def hole_at(
    run: JobRun, site: Place, knowledge: JobKnowledge, z1: SurfaceReading, z1_u_um: float
) -> OpenHole:
    """Return an untouched hole at a site whose tool would have met the pad at `z1`."""
    face_um = knowledge.surface.height_um(site)
    return OpenHole(
        site=site,
        target=run.target_at(site),
        z1=z1,
        z1_u_um=z1_u_um,
        face_um=face_um,
        face_u_um=knowledge.surface.height_u_um(site),
        estimate=knowledge.estimate
        if knowledge.estimate.fits == 0
        else knowledge.estimate.next_hole(run.target_at(site).depth_um),
        bottom=z1.shifted(face_um),
        pad=z1,
    )


def start_of(run: JobRun, hole: OpenHole, knowledge: JobKnowledge) -> CutStart:
    """Return what the first cut of an untouched hole starts from: tool, face, and what measures."""
    assert knowledge.tool is not None
    sensor_u, tool = run.uncertainty, knowledge.tool
    length_um = hole.target.feed_um if hole.target.kind == "feed" else hole.target.depth_um
    return CutStart(
        bottom_um=hole.surface_um,
        bottom_u_um=math.hypot(tool.u_um(tool.pad.time_s, 0.0), hole.face_u_um),
        gap_um=knowledge.gap_um,
        time_s=tool.pad.time_s,
        drift_u_um_per_s=sensor_u.drift_u_um_per_s,
        depth_u_um=sensor_u.length_u_um(length_um),
        gap_u_um=knowledge.gap_u_um,
    )


def model_u95_um(run: JobRun, found: DepthAndWear, creep_um: float) -> tuple[float, float]:
    """Return half the 95 % intervals of depth and wear by the actuator model, NaN without a model.

    Its zero is set by the sensor, so everything that is uncertain of a measured value counts as well. `creep_um` is
    the extrapolated creep in the depth.
    """
    tracker = run.watch.tracker()
    if tracker is None:
        return math.nan, math.nan
    if not run.setup.sensor.fitted:
        return found.depth.u95, found.wear.u95
    return (
        found.depth.widened(tracker.length_u_um(creep_um)).u95,
        found.wear.widened(tracker.length_u_um(0.0)).u95,
    )


def _erosion(
    profile: Profile, found: DepthAndWear, machining_time_s: float, *, through: bool
) -> tuple[float, float, float]:
    """Relative wear, linear and volumetric, and material removal rate; NaN without a depth or a time to refer to.

    Volumes are lengths times the tool's face and the hole's section, a side gap wider all round. A hole `through`
    the sheet is as long as that is thick, however far the tip came out of it.
    """
    length_um = profile.work.thickness_um if through else found.depth_um
    tool_um2 = tool_area_um2(profile.tool.diameter_um)
    hole_um2 = hole_area_um2(profile.tool.diameter_um, profile.work.side_gap_um)
    ratio = found.wear_um / length_um if length_um > 0.0 else math.nan
    removed_um3 = length_um * hole_um2
    mrr = mrr_mm3_min(removed_um3 / machining_time_s) if machining_time_s > 0.0 else math.nan
    return ratio, ratio * tool_um2 / hole_um2, mrr


def _percent(part: float, whole: float) -> float:
    return 100.0 * part / whole if whole > 0.0 else math.nan
