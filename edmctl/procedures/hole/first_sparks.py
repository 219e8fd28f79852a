"""Where the sparks of an approach begin, against the bottom that the cut is planned from.

First sparks tell the height of a surface as far as the working gap is known. Where the two contradict each other
before any gap was measured, touch and gap are both in doubt until the first stop has measured the gap.
"""

from __future__ import annotations

import math
from dataclasses import replace

from edmctl.machine.interface import MachineEvent
from edmctl.procedures.hole.cut_planning import CutPlan
from edmctl.procedures.hole.hole import DoubtedSurface, FirstSparks, OpenHole
from edmctl.procedures.run import JobRun
from edmctl.procedures.touch.surface_plane import SurfacePlane
from edmctl.process.discharge import FIRST_GAP_U_UM
from edmctl.process.next_cut import CLEAR_SIGMAS, GAP_U_UM
from edmctl.process.touches import share_u
from edmctl.quantity import half_width
from edmctl.record.rows import EventLevel, RunEvent
from edmctl.wording import signed

FIRST_SPARKS_SIGMAS = 3.0
LEAST_GAP_UM = 0.5
"""A working gap is never believed to be narrower than this."""


def check_first_sparks(
    run: JobRun,
    hole: OpenHole,
    surface: SurfacePlane,
    plan: CutPlan,
    event: MachineEvent,
    bottom_u_um: float,
) -> CutPlan:
    """Compare where sparks began with the bottom that the cut is planned from; return the plan as it may stand.

    `bottom_u_um` is the standard uncertainty of that bottom's height now. A bottom that contradicts them is less
    certain by as much, and what is cut from it is measured; so is a gap that nobody has measured. Sparks that begin
    late show a narrower gap or a lower surface: either way the cut counts from them. Where the bottom is the
    untouched face, no later touch of the hole tells of it: `hole` and `surface` keep the doubt, until `judge_again`
    finds that it was the gap. Something that is known to lie there sparks first.
    """
    sparks = FirstSparks(event.displacement_um, plan.start.bottom_um, bottom_u_um, debris_um(hole, surface))
    off = sparks.off(run.profile.pulse.open_voltage_v, plan.start.gap_um, plan.start.gap_u_um)
    if abs(off.sigmas) <= FIRST_SPARKS_SIGMAS:
        return plan
    is_believed = plan.start.gap_u_um >= FIRST_GAP_U_UM
    why = "one of its touches was wrong"
    if is_believed:
        why += f", or the working gap is not the {plan.start.gap_um:.1f} µm believed"
    run.decide(
        RunEvent.TOUCH_DOUBTED,
        f"Sparks began at {sparks.z_um:.1f} µm, {signed(off.um, 1)} µm from where a surface at "
        f"{plan.start.bottom_um:.1f} µm puts them: {why}. The cut will be measured.",
        {"kind": "first sparks", "off_um": off.um, "z_um": plan.start.bottom_um},
        level=EventLevel.WARNING,
    )
    doubt_u_um = math.hypot(share_u(off.um), off.u_um)
    if hole.stops == 0:
        hole.doubted = DoubtedSurface(
            sparks,
            plan.start.gap_um,
            plan.start.gap_u_um,
            hole.face_u_um,
            tuple(surface.touched),
            surface.doubt_u_um,
        )
        hole.face_u_um = math.hypot(hole.face_u_um, doubt_u_um)
        surface.doubt(doubt_u_um)
        run.keeper.set_surface(tuple(surface.touched), surface.doubt_u_um)
    start = replace(plan.start, bottom_u_um=math.hypot(plan.start.bottom_u_um, doubt_u_um))
    if is_believed:
        gap_um = min(plan.start.gap_um, max(LEAST_GAP_UM, plan.start.gap_um - off.um))
        start = replace(start, gap_um=gap_um, gap_u_um=math.hypot(plan.start.gap_u_um, off.um))
    return replace(plan, start=start, measured=True)


def judge_again(run: JobRun, hole: OpenHole, surface: SurfacePlane, gap_um: float) -> None:
    """Judge first sparks that put the face in doubt by a gap that was measured since, where they did.

    Sparks and stop tell of the gap apart from each other. Where the stop has found another gap than was believed,
    and the sparks fit it, the belief was wrong and not a touch of the face: the doubt is withdrawn. A gap as it was
    believed explains nothing.
    """
    doubted = hole.doubted
    if doubted is None:
        return
    hole.doubted = None
    off = doubted.sparks.off(run.profile.pulse.open_voltage_v, gap_um, GAP_U_UM)
    is_another = abs(gap_um - doubted.gap_um) > CLEAR_SIGMAS * doubted.gap_u_um
    if not is_another or abs(off.sigmas) > FIRST_SPARKS_SIGMAS:
        return
    hole.face_u_um = doubted.face_u_um
    surface.restore(doubted.touched, doubted.doubt_u_um)
    run.keeper.set_surface(tuple(surface.touched), surface.doubt_u_um)
    run.decide(
        RunEvent.DOUBT_WITHDRAWN,
        f"The working gap is {gap_um:.2f} µm, not the {doubted.gap_um:.2f} µm believed, and with it the first "
        f"sparks are {signed(off.um, 1)} ± {half_width(off.u_um):.1f} µm from where the touched surface puts them: "
        "no touch of it was wrong.",
        {"gap_um": gap_um, "believed_um": doubted.gap_um, "off_um": off.um},
    )


def debris_um(hole: OpenHole, surface: SurfacePlane) -> float:
    """Return how high something lies on the face where an untouched hole goes."""
    return surface.debris_um.get(hole.site.name, 0.0) if hole.stops == 0 else 0.0
