"""What a touch of the pad tells of the holes that were left unmeasured before it.

Each of them was taken to wear the tool as expected; the pad then tells what they wore together. Their shares are
scaled to that, as far as the touches are better known than the expectation. A tool that was shorter than expected
has left every later hole shallower by as much.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from edmctl.procedures.measuring import displacement_uncertainty
from edmctl.procedures.tool_length import TOUCH_U_UM
from edmctl.process.live_erosion import SCATTER_BETWEEN_HOLES
from edmctl.process.next_cut import COVERAGE, GAP_U_UM

if TYPE_CHECKING:
    from edmctl.procedures.hole import Hole, Known
    from edmctl.procedures.run import Run
    from edmctl.procedures.touch import SurfaceReading


def settle_unmeasured(
    run: Run, hole: Hole, known: Known, pad: SurfaceReading, worn_um: float, worn_u_um: float
) -> None:
    """Correct the holes since the last touch of the pad, and where `hole` has begun.

    `pad` is the new reading, `worn_um` what `hole` itself is expected to have worn, known within `worn_u_um`. Every
    such hole then counts as measured through its neighbours: its result is replaced.
    """
    assert known.tool is not None
    shares_um = [one.found.wear_um for one in known.unmeasured if one.found is not None]
    expected_um = math.fsum(shares_um) + worn_um
    drift_um = displacement_uncertainty(run.job).drift_u_um_per_s * (pad.time_s - known.tool.pad.time_s)
    linearity_um = displacement_uncertainty(run.job).linearity_u_um
    touched_u_um = math.hypot(TOUCH_U_UM * math.sqrt(2.0), linearity_um, drift_um)
    expected_u_um = known.tool.wear_u_um + worn_u_um
    trust = expected_u_um**2 / (expected_u_um**2 + touched_u_um**2)
    found_um = pad.z_um - known.tool.pad.z_um
    total_um = expected_um + trust * (found_um - expected_um)
    scale = total_um / expected_um if expected_um > 0.0 and total_um > 0.0 else 1.0
    shift_um = so_far_um = 0.0
    for one, share_um in zip(known.unmeasured, shares_um, strict=True):
        more_um = (scale - 1.0) * share_um
        so_far_um += share_um
        unknown = touched_u_um / max(expected_um, share_um)
        wear_u_um = math.hypot(unknown, SCATTER_BETWEEN_HOLES) * share_um
        _correct(
            run, one, before_um=shift_um, own_um=more_um, tip_u_um=unknown * so_far_um, wear_u_um=wear_u_um
        )
        shift_um += more_um
    hole.z1 = hole.z1.shifted(shift_um)
    hole.z1_u_um = touched_u_um if known.unmeasured else hole.z1_u_um
    known.unmeasured.clear()


def _correct(
    run: Run, hole: Hole, *, before_um: float, own_um: float, tip_u_um: float, wear_u_um: float
) -> None:
    """A hole began `before_um` shorter of tool than it was taken to, and wore it by `own_um` more.

    `tip_u_um` is the standard uncertainty of the tool's length at its end, `wear_u_um` of what the hole took of it.
    """
    result = run.ledger.sites[hole.site.name]
    found = hole.found
    assert found is not None
    known = displacement_uncertainty(run.job)
    sensed_u_um = math.hypot(known.linearity_u_um, known.gain_u_rel * found.depth_um)
    depth_u95_um = COVERAGE * math.hypot(GAP_U_UM, TOUCH_U_UM, hole.face_u_um, tip_u_um, sensed_u_um)
    changed = replace(
        result,
        z1_um=result.z1_um + before_um,
        z3_um=result.z3_um + before_um + own_um,
        depth_um=result.depth_um - before_um - own_um,
        depth_u95_um=depth_u95_um,
        wear_um=result.wear_um + own_um,
        wear_u95_um=COVERAGE * math.hypot(wear_u_um, GAP_U_UM * result.wear_um / max(result.feed_um, 1.0)),
        feed_um=result.feed_um - before_um,
    )
    run.ledger.sites[hole.site.name] = changed
    hole.found = replace(
        found,
        depth_um=changed.depth_um,
        depth_u95_um=changed.depth_u95_um,
        wear_um=changed.wear_um,
        wear_u95_um=changed.wear_u95_um,
        feed_um=changed.feed_um,
    )
