"""What a touch of the pad tells of the holes that were left unmeasured before it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from edmctl.procedures.hole.cut_planning import energy_of
from edmctl.procedures.hole.hole import Unmeasured
from edmctl.procedures.touch.reference_pad import TOUCH_U_UM
from edmctl.process.live_erosion import SCATTER_BETWEEN_HOLES
from edmctl.process.next_cut import COVERAGE
from edmctl.process.shared_wear import SharedWear, WearShare, share_wear

if TYPE_CHECKING:
    from edmctl.procedures.hole.cut import CutResult
    from edmctl.procedures.hole.cut_planning import CutPlan
    from edmctl.procedures.hole.hole import JobKnowledge, OpenHole
    from edmctl.procedures.run import JobRun
    from edmctl.procedures.touch.reading import SurfaceReading
    from edmctl.process.live_erosion import LiveErosion


def unmeasured(
    run: JobRun, hole: OpenHole, pad_s: float, plan: CutPlan, cut: CutResult, live: LiveErosion
) -> Unmeasured:
    """Return what is to be remembered of a cut just made that no touch follows; the pad was last touched at `pad_s`.

    The ratio of wear to depth errs alike in all cuts of a job; working gap and scatter do not, nor does wear that
    the energy of this cut contradicts.
    """
    start = plan.start
    added_um = live.wear_um - start.wear_um
    energy = energy_of(run.profile.pulse, cut.counts, cut.energy_j)
    off_um = plan.off_by_energy_um(cut.end_displacement_um, energy)
    own_u_um = math.hypot(SCATTER_BETWEEN_HOLES * added_um, live.wear_own_u_um, off_um)
    from_face = hole.stops == 0
    return Unmeasured(
        hole=hole,
        share=WearShare(added_um, live.wear_ratio_u_um, own_u_um, run.machine.time_s - pad_s),
        depth_u_um=math.hypot(
            plan.start.gap_u_um, start.depth_u_um, TOUCH_U_UM, hole.face_u_um if from_face else 0.0
        ),
        wear_before_um=start.wear_um,
        wear_before_u_um=start.wear_u_um,
    )


def settle_unmeasured(
    run: JobRun,
    hole: OpenHole,
    knowledge: JobKnowledge,
    pad: SurfaceReading,
    plan: CutPlan,
    cut: CutResult,
    live: LiveErosion,
) -> SharedWear:
    """Correct the cuts since the last touch of the pad, and where `hole` has begun; what that itself has worn.

    `pad` is the new reading, `live` what was expected of `hole` after `cut`; its Z1 becomes the reading less its own
    wear. The results of the others are replaced; they stay estimates, better ones.
    """
    assert knowledge.tool is not None
    before, sensor_u = knowledge.tool.pad, run.uncertainty
    cuts = [*knowledge.unmeasured, unmeasured(run, hole, before.time_s, plan, cut, live)]
    found = share_wear(
        [one.share for one in cuts],
        pad.z_um - before.z_um,
        pad.time_s - before.time_s,
        touch_u_um=math.hypot(TOUCH_U_UM * math.sqrt(2.0), sensor_u.linearity_u_um),
        drift_u_um_per_s=sensor_u.drift_u_um_per_s,
    )
    shorter_um = 0.0
    for earlier, now in zip(knowledge.unmeasured, found, strict=False):
        own_um = now.wear_um - earlier.share.wear_um
        _correct(run, earlier, own_um, shorter_um, now)
        shorter_um += own_um
    hole.z1 = hole.z1.shifted(pad.z_um - found[-1].wear_um - hole.z1.z_um)
    hole.z1_u_um = max(hole.z1_u_um, found[-1].wear_u_um)
    knowledge.unmeasured.clear()
    return found[-1]


def _correct(run: JobRun, cut: Unmeasured, own_um: float, before_um: float, now: SharedWear) -> None:
    """A cut began `before_um` shorter of tool than it was taken to, and wore it by `own_um` more."""
    hole = cut.hole
    result, found = run.tally.sites[hole.site.name], hole.found
    assert found is not None
    z3_um, depth_um = result.z3_um + before_um + own_um, result.depth_um - now.tip_um
    changed = replace(
        result,
        z1_um=result.z1_um + before_um,
        z2_um=z3_um + result.face_um + depth_um,
        z3_um=z3_um,
        depth_um=depth_um,
        depth_u95_um=COVERAGE * math.hypot(cut.depth_u_um, now.tip_u_um),
        wear_um=cut.wear_before_um + now.wear_um,
        wear_u95_um=COVERAGE * math.hypot(cut.wear_before_u_um, now.wear_u_um),
        feed_um=result.feed_um - now.tip_um + own_um,
    )
    run.tally.sites[hole.site.name] = changed
    hole.found = replace(
        found,
        depth_um=changed.depth_um,
        depth_u95_um=changed.depth_u95_um,
        wear_um=changed.wear_um,
        wear_u95_um=changed.wear_u95_um,
        feed_um=changed.feed_um,
    )
