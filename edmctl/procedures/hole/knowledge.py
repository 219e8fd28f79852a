"""What a job learns from hole to hole, and from first sparks that contradict a touch.

The next touch of the pad measures all cuts since the last one at once, and corrects the results of their holes.
First sparks measure a surface as far as the working gap is known.
"""

from __future__ import annotations

import math

from edmctl.dataclasses import dataclass, replace
from edmctl.planning.measuring import estimate_of
from edmctl.procedures.hole.cut import CutResult
from edmctl.procedures.hole.cut_planning import CutPlan, CutStart, energy_of
from edmctl.procedures.hole.hole import Hole
from edmctl.procedures.job import SurfaceTouch
from edmctl.procedures.monitoring.drift import pause_drift_u_um
from edmctl.procedures.run import JobRun
from edmctl.procedures.stages import pad_from_home_um
from edmctl.procedures.touch.reading import SurfaceReading
from edmctl.procedures.touch.surfaces import OFFSET_U_UM, SurfacePlane, ToolLength, drift_between, read_pad
from edmctl.process.erosion import FIRST_GAP_U_UM, first_gap_u_um, first_sparks_um
from edmctl.process.live_erosion import SCATTER_BETWEEN_HOLES, LiveErosion
from edmctl.process.next_cut import CLEAR_SIGMAS, GAP_U_UM
from edmctl.process.shared_wear import SharedWear, WearShare, share_wear
from edmctl.process.touches import TOUCH_U_UM, Deviation, share_u
from edmctl.profile.model import Profile
from edmctl.profile.places import Place
from edmctl.quantity import Value, half_width
from edmctl.record.rows import RunEvent
from edmctl.wording import signed

LEFT_U_UM = 4.0  # u of the distance to the pad after an earlier run that estimated the wear, without drift


@dataclass(frozen=True, slots=True, eq=False)
class Unmeasured:
    """A cut that no touch followed; `depth_u_um` excludes the uncertainty of the tool's length."""

    hole: Hole
    share: WearShare
    depth_u_um: float
    wear_before: Value

    def correct(self, run: JobRun, shorter_um: float, now: SharedWear) -> float:
        """Correct the result of the hole, which began with a tool `shorter_um` shorter; return its own error."""
        result, found = run.tally.sites[self.hole.site.name], self.hole.found
        assert found is not None
        own_um = now.wear_um - self.share.wear_um
        feed_um = result.feed_um - now.tip_um + own_um
        gain_u_um = run.uncertainty.gain_u_rel * feed_um
        before = self.wear_before
        wear_u_um = math.hypot(before.u, now.wear_u_um, run.uncertainty.length_u_um(now.wear_um))
        corrected = replace(
            found,
            depth=Value(result.depth_um - now.tip_um, math.hypot(self.depth_u_um, now.tip_u_um)),
            wear=Value(before.value + now.wear_um, wear_u_um),
            feed=Value(feed_um, math.hypot(self.depth_u_um, before.u, now.feed_u_um, gain_u_um)),
        )
        self.hole.correct(corrected, shorter_um, result.z3_um + shorter_um + own_um)
        return own_um


class JobKnowledge:
    """What a job knows so far of tool, surface, erosion and working gap.

    `estimate` is of removal and wear, `gap` the working gap to expect, µm; `tool` is None before it has touched the
    pad. `pads` are the readings of the pad in this run, `unmeasured` the cuts since the last of them.
    """

    def __init__(self, run: JobRun) -> None:
        self._run = run
        profile = run.profile
        self.estimate, self.gap = estimate_of(profile), first_gap(profile)
        self.surface = SurfacePlane(run)
        self.tool: ToolLength | None = None
        self.pads: list[SurfaceReading] = []
        self.unmeasured: list[Unmeasured] = []

    def touch_pad_first(self, name: str) -> SurfaceReading:
        """Touch the pad before anything else (Z1); its two spots may show the slope too."""
        run, resumed, home_um = self._run, self._run.job.resumed, self._run.tally.home_um
        u_um = OFFSET_U_UM
        if resumed is not None and (resumed.site or run.tally.sites):
            u_um = math.hypot(LEFT_U_UM, pause_drift_u_um(run.job), share_u(home_um - resumed.home_um))
        pad = read_pad(run, "Z1", name, home_um + pad_from_home_um(run), u_um)
        self.pads.append(pad)
        self.surface.fit_pad_slope(pad)
        self.tool = ToolLength(pad)
        return pad

    def next_hole(self, site: Place) -> Hole:
        """Return an untouched hole, after a touch of the pad if the tool length is unknown."""
        if self.tool is None:
            self.touch_pad_first(site.name)
        assert self.tool is not None
        z1 = self.tool.pad.shifted(self.tool.wear_um)
        return Hole(self._run, site, self.surface, self.estimate, z1, self.tool.wear_u_um)

    def first_start(self, hole: Hole) -> CutStart:
        """Return where the first cut of an untouched hole begins."""
        assert self.tool is not None
        sensor_u, tool = self._run.uncertainty, self.tool
        length_um = hole.target.feed_um if hole.target.kind == "feed" else hole.target.depth_um
        return CutStart(
            bottom_um=hole.z1.z_um + hole.face_um,
            bottom_u_um=math.hypot(tool.u_um(tool.pad.time_s, 0.0), hole.face_u_um),
            gap_um=self.gap.value,
            time_s=tool.pad.time_s,
            drift_u_um_per_s=sensor_u.drift_u_um_per_s,
            depth_u_um=sensor_u.length_u_um(length_um),
            gap_u_um=self.gap.u,
        )

    def add_unmeasured(self, hole: Hole, plan: CutPlan, cut: CutResult, live: LiveErosion) -> None:
        """Take the expected wear of a cut that is not measured; the errors of such cuts have the same sign."""
        tool = self.tool
        assert tool is not None
        self.unmeasured.append(self._unmeasured(hole, plan, cut, live))
        wear_um = tool.wear_um + (live.wear_um - plan.start.wear_um)
        self.tool = ToolLength(tool.pad, wear_um, tool.wear_u_um + live.wear_u_um)

    def share_wear(
        self, hole: Hole, pad: SurfaceReading, plan: CutPlan, cut: CutResult, live: LiveErosion
    ) -> SharedWear:
        """Correct all cuts since the last touch of the pad by a new one after `cut`; return the wear of `hole`.

        `live` is the expected wear of `hole` after `cut`; from here on it counts from the new reading.
        """
        assert self.tool is not None
        run, before, sensor_u = self._run, self.tool.pad, self._run.uncertainty
        cuts = [*self.unmeasured, self._unmeasured(hole, plan, cut, live)]
        seconds, drift = pad.time_s - before.time_s, drift_between(run, before, pad)
        # The sensor's gain is left out: its error in a depth or wear is counted with that length.
        walk_u_um = sensor_u.walk_um_per_sqrt_s * math.sqrt(seconds)
        shared = share_wear(
            [unmeasured.share for unmeasured in cuts],
            pad.z_um - before.z_um - (drift.um if drift else 0.0),
            seconds,
            touch_u_um=math.hypot(TOUCH_U_UM * math.sqrt(2.0), walk_u_um),
            drift_u_um_per_s=drift.left_u_um / seconds if drift else sensor_u.drift_u_um_per_s,
        )
        shorter_um = 0.0
        for earlier, wear in zip(self.unmeasured, shared, strict=False):
            shorter_um += earlier.correct(run, shorter_um, wear)
        hole.restart_from(pad, shared[-1])
        self.unmeasured.clear()
        return shared[-1]

    def _unmeasured(self, hole: Hole, plan: CutPlan, cut: CutResult, live: LiveErosion) -> Unmeasured:
        """Return the cut with its share of the wear, whose ratio errs alike in all cuts of a job."""
        assert self.tool is not None
        run, start = self._run, plan.start
        added_um = live.wear_um - start.wear_um
        energy = energy_of(run.profile.pulse, cut)
        off_um = plan.estimate.off_by_energy_um(plan.fed_um(cut.end_displacement_um), start.gap_u_um, energy)
        own_u_um = math.hypot(SCATTER_BETWEEN_HOLES * added_um, live.wear_own_u_um, off_um)
        after_s = run.machine.time_s - self.tool.pad.time_s
        face_u_um = hole.face_u_um if hole.stops == 0 else 0.0
        return Unmeasured(
            hole,
            WearShare(added_um, live.wear_ratio_u_um, own_u_um, after_s),
            math.hypot(start.gap_u_um, start.depth_u_um, TOUCH_U_UM, face_u_um),
            Value(start.wear_um, start.wear_u_um),
        )


def first_gap(profile: Profile) -> Value:
    """Return the working gap to expect before one was measured."""
    return Value(profile.measure.expected_gap_um, first_gap_u_um(profile.pulse.open_voltage_v))


FIRST_SPARKS_SIGMAS = 3.0
LEAST_GAP_UM = 0.5  # least working gap that is assumed


@dataclass(frozen=True, slots=True)
class _Doubt:
    """First sparks at `z_um` that put the surface in doubt, and what was known of bottom, gap and surface before."""

    z_um: float
    bottom: Value
    debris_um: float
    gap: Value
    face_u_um: float
    touched: tuple[SurfaceTouch, ...]
    doubt_u_um: float


class FirstSparkCheck:
    """Compares the first sparks of the cuts of a hole with the touches."""

    def __init__(self, run: JobRun, hole: Hole, knowledge: JobKnowledge) -> None:
        self._run, self._hole, self._knowledge = run, hole, knowledge
        self._doubt: _Doubt | None = None

    def _off(self, z_um: float, bottom: Value, debris_um: float, gap: Value) -> Deviation:
        """Return how much later than such a gap makes them sparks began, on the surface or on the debris."""
        before_um, before_u_um = first_sparks_um(self._run.profile.pulse.open_voltage_v)
        off_um, u_um = z_um - (bottom.value - gap.value - before_um), math.hypot(bottom.u, gap.u, before_u_um)
        offs = Deviation(off_um, u_um), Deviation(off_um + debris_um, u_um)
        return min(offs, key=lambda off: abs(off.sigmas))

    @property
    def debris_um(self) -> float:
        """Height of what lies on the surface where an untouched hole is to be cut."""
        hole = self._hole
        return self._knowledge.surface.debris_um.get(hole.site.name, 0.0) if hole.stops == 0 else 0.0

    def checked(self, plan: CutPlan, spark_um: float, bottom_u_um: float) -> CutPlan:
        """Return the plan after sparks began at `spark_um`; its bottom has a standard uncertainty of `bottom_u_um`.

        A bottom that contradicts the sparks is less certain by as much, and the cut is measured; so is a gap that
        was never measured. Late sparks show a narrower gap or a lower surface: in both cases the cut counts from
        them. A doubt about the untouched surface remains until `judge_again` finds that it was the gap. Known debris
        there sparks first.
        """
        hole, surface, start = self._hole, self._knowledge.surface, plan.start
        bottom, debris_um = Value(start.bottom_um, bottom_u_um), self.debris_um
        gap = Value(start.gap_um, start.gap_u_um)
        off = self._off(spark_um, bottom, debris_um, gap)
        if abs(off.sigmas) <= FIRST_SPARKS_SIGMAS:
            return plan
        is_gap_measured = gap.u < FIRST_GAP_U_UM
        or_gap = "" if is_gap_measured else f", or the working gap is not the expected {gap.value:.1f} µm"
        self._run.warn(
            RunEvent.TOUCH_DOUBTED,
            f"Sparks began at {spark_um:.1f} µm, {signed(off.um, 1)} µm from where a surface at "
            f"{start.bottom_um:.1f} µm puts them: one of its touches was wrong{or_gap}. The cut will be measured.",
            {"kind": "first sparks", "off_um": off.um, "z_um": start.bottom_um},
        )
        doubt_u_um = math.hypot(share_u(off.um), off.u_um)
        if hole.stops == 0:
            touched, surface_u_um = tuple(surface.touched), surface.doubt_u_um
            self._doubt = _Doubt(spark_um, bottom, debris_um, gap, hole.face_u_um, touched, surface_u_um)
            hole.face_u_um = math.hypot(hole.face_u_um, doubt_u_um)
            surface.doubt(doubt_u_um)
            surface.keep()
        start = replace(start, bottom_u_um=math.hypot(start.bottom_u_um, doubt_u_um))
        if not is_gap_measured:
            gap_um = min(gap.value, max(LEAST_GAP_UM, gap.value - off.um))
            start = replace(start, gap_um=gap_um, gap_u_um=math.hypot(gap.u, off.um))
        return replace(plan, start=start, measured=True)

    def judge_again(self, gap_um: float) -> None:
        """Withdraw a doubt about the surface if a measured gap explains it.

        The sparks and the measurement cycle measure the gap independently. If the cycle found another gap than was
        assumed, and the sparks fit it, the assumption was wrong and not a touch of the surface.
        """
        doubt, self._doubt = self._doubt, None
        if doubt is None:
            return
        surface, before_um = self._knowledge.surface, doubt.gap.value
        off = self._off(doubt.z_um, doubt.bottom, doubt.debris_um, Value(gap_um, GAP_U_UM))
        is_other_gap = abs(gap_um - before_um) > CLEAR_SIGMAS * doubt.gap.u
        if not is_other_gap or abs(off.sigmas) > FIRST_SPARKS_SIGMAS:
            return
        self._hole.face_u_um = doubt.face_u_um
        surface.restore(doubt.touched, doubt.doubt_u_um)
        surface.keep()
        self._run.decide(
            RunEvent.DOUBT_WITHDRAWN,
            f"The working gap is {gap_um:.2f} µm, not {before_um:.2f} µm as assumed. Then the first sparks are "
            f"{signed(off.um, 1)} ± {half_width(off.u_um):.1f} µm from the touched surface: no touch was wrong.",
            {"gap_um": gap_um, "believed_um": before_um, "off_um": off.um},
        )
