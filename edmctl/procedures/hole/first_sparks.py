"""Where the sparks of an approach begin, relative to the bottom that the cut is planned from.

First sparks measure the height of a surface as far as the working gap is known. If they contradict a touch before
any gap was measured, touch and gap are both in doubt until the first measurement cycle has measured the gap.
"""

from __future__ import annotations

import math

from edmctl.dataclasses import dataclass, replace
from edmctl.procedures.hole.cut_planning import CutPlan
from edmctl.procedures.hole.hole import Hole
from edmctl.procedures.hole.knowledge import JobKnowledge
from edmctl.procedures.job_state import SurfaceTouch
from edmctl.procedures.run import JobRun
from edmctl.process.discharge import FIRST_GAP_U_UM, first_sparks_um
from edmctl.process.next_cut import CLEAR_SIGMAS, GAP_U_UM
from edmctl.process.touches import Deviation, share_u
from edmctl.quantity import Value, half_width
from edmctl.record.rows import RunEvent
from edmctl.wording import signed

FIRST_SPARKS_SIGMAS = 3.0
LEAST_GAP_UM = 0.5
"""Least working gap that is assumed."""


@dataclass(frozen=True, slots=True)
class FirstSparks:
    """Where sparks began, and the bottom that they are compared with, on which debris `debris_um` high may lie."""

    z_um: float
    bottom: Value
    debris_um: float

    def off(self, open_voltage_v: float, gap: Value) -> Deviation:
        """Return how much later they began than such a gap makes them, on the surface or on the debris."""
        before_um, before_u_um = first_sparks_um(open_voltage_v)
        off_um = self.z_um - (self.bottom.value - gap.value - before_um)
        u_um = math.hypot(self.bottom.u, gap.u, before_u_um)
        return min(
            Deviation(off_um, u_um), Deviation(off_um + self.debris_um, u_um), key=lambda off: abs(off.sigmas)
        )


@dataclass(frozen=True, slots=True)
class _Doubt:
    """First sparks that put the surface in doubt, and what was known of gap and surface before."""

    sparks: FirstSparks
    gap: Value
    face_u_um: float
    touched: tuple[SurfaceTouch, ...]
    doubt_u_um: float


class FirstSparkCheck:
    """Compares the first sparks of the cuts of a hole with the touches."""

    def __init__(self, run: JobRun, hole: Hole, knowledge: JobKnowledge) -> None:
        self._run, self._hole, self._knowledge = run, hole, knowledge
        self._doubt: _Doubt | None = None

    @property
    def debris_um(self) -> float:
        """Height of what lies on the surface where an untouched hole is to be cut."""
        hole = self._hole
        return self._knowledge.surface.debris_um.get(hole.site.name, 0.0) if hole.stops == 0 else 0.0

    def checked(self, plan: CutPlan, spark_um: float, bottom_u_um: float) -> CutPlan:
        """Return the plan after sparks began at `spark_um`; its bottom has a standard uncertainty of `bottom_u_um`.

        A bottom that contradicts the sparks is less certain by as much, and the cut is measured; so is a gap that
        was never measured. Late sparks show a narrower gap or a lower surface: in both cases the cut counts from
        them. If the bottom is the untouched surface, no later touch of the hole measures it: the doubt remains until
        `judge_again` finds that it was the gap. Debris that is known to lie there sparks first.
        """
        run, hole, surface, start = self._run, self._hole, self._knowledge.surface, plan.start
        sparks = FirstSparks(spark_um, Value(start.bottom_um, bottom_u_um), self.debris_um)
        gap = Value(start.gap_um, start.gap_u_um)
        off = sparks.off(run.profile.pulse.open_voltage_v, gap)
        if abs(off.sigmas) <= FIRST_SPARKS_SIGMAS:
            return plan
        is_gap_measured = gap.u < FIRST_GAP_U_UM
        why = "one of its touches was wrong"
        if not is_gap_measured:
            why += f", or the working gap is not the {gap.value:.1f} µm believed"
        run.warn(
            RunEvent.TOUCH_DOUBTED,
            f"Sparks began at {spark_um:.1f} µm, {signed(off.um, 1)} µm from where a surface at "
            f"{start.bottom_um:.1f} µm puts them: {why}. The cut will be measured.",
            {"kind": "first sparks", "off_um": off.um, "z_um": start.bottom_um},
        )
        doubt_u_um = math.hypot(share_u(off.um), off.u_um)
        if hole.stops == 0:
            self._doubt = _Doubt(sparks, gap, hole.face_u_um, tuple(surface.touched), surface.doubt_u_um)
            hole.set_surface_u(math.hypot(hole.face_u_um, doubt_u_um))
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
        run, surface = self._run, self._knowledge.surface
        off = doubt.sparks.off(run.profile.pulse.open_voltage_v, Value(gap_um, GAP_U_UM))
        is_another = abs(gap_um - doubt.gap.value) > CLEAR_SIGMAS * doubt.gap.u
        if not is_another or abs(off.sigmas) > FIRST_SPARKS_SIGMAS:
            return
        self._hole.set_surface_u(doubt.face_u_um)
        surface.restore(doubt.touched, doubt.doubt_u_um)
        surface.keep()
        run.decide(
            RunEvent.DOUBT_WITHDRAWN,
            f"The working gap is {gap_um:.2f} µm, not the {doubt.gap.value:.2f} µm believed, and with it the first "
            f"sparks are {signed(off.um, 1)} ± {half_width(off.u_um):.1f} µm from where the touched surface puts "
            "them: no touch of it was wrong.",
            {"gap_um": gap_um, "believed_um": doubt.gap.value, "off_um": off.um},
        )
