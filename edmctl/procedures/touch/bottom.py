"""The bottom of a hole, touched and judged by where the tool has just sparked, or by how deep the hole should be.

A bottom at or above that is impossible, and one that is shorter than the working gap allows has something on it. The
tool is lifted high so that oil washes it away, and touches again; what stays in doubt widens the interval.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from edmctl.procedures.stages import retract
from edmctl.procedures.touch.approach import lower_to, raise_by
from edmctl.procedures.touch.reading import SurfaceReading, take_reading
from edmctl.process.next_cut import COVERAGE
from edmctl.process.touches import TOUCH_SD_PRIOR_UM, Deviation, against_sparks, between, is_long, is_short
from edmctl.record.rows import EventLevel, RejectedTouch, RunEvent

if TYPE_CHECKING:
    from edmctl.procedures.hole.cut import CutResult
    from edmctl.procedures.hole.cut_planning import CutPlan
    from edmctl.procedures.run import JobRun

CLEAR_OF_BOTTOM_UM = 60.0
"""Before the bottom is touched the tool rises by this: clear of 20 µm for the contact check."""
MORE_LOOKS = 2
"""A bottom in doubt is touched so many times more."""
WASHING_STROKES = 3
"""Before each of them the tool is drawn out so many times: what is loose goes with the oil."""
UNFINISHED_GAP_U_UM = 3.0
"""Standard uncertainty of the gap where a cut did not end at its limit: the servo swings, and shorts draw back
[assumed]."""


@dataclass(frozen=True, slots=True)
class ExpectedBottom:
    """Where a bottom is: `way_um`, known within `u_um`, below what it cannot be above, at `above_um`.

    `source` names what says so.
    """

    above_um: float
    way_um: float
    u_um: float
    source: str

    @property
    def z_um(self) -> float:
        """Where the tool is expected to touch it."""
        return self.above_um + self.way_um


def read_bottom(run: JobRun, place: str, plan: CutPlan, cut: CutResult) -> SurfaceReading:
    """Touch the bottom that a cut has left, more often where it is not where it should be."""
    raise_by(run, CLEAR_OF_BOTTOM_UM)
    gap_u_um = math.hypot(plan.start.gap_u_um, 0.0 if cut.is_at_limit else UNFINISHED_GAP_U_UM)
    return read_expected(
        run, place, ExpectedBottom(cut.end_displacement_um, plan.start.gap_um, gap_u_um, "the last sparks")
    )


def read_expected(run: JobRun, place: str, expected: ExpectedBottom) -> SurfaceReading:
    """Touch a bottom below the tool, more often where it is not where it should be; doubts that stay widen it."""
    above_um, way_um, u_um = expected.above_um, expected.way_um, expected.u_um
    z2 = take_reading(run, "Z2", place, expected.z_um, u_um)
    for look in range(MORE_LOOKS + 1):
        off = against_sparks(z2.z_um, above_um, way_um, u_um)
        short = is_short(off, way_um)
        if not short and (look > 0 or not is_long(off)):
            return z2
        if look == MORE_LOOKS:
            break
        _report_doubt(run, z2, off, expected.source, "It is touched again.")
        wash(run, above_um)
        again = take_reading(run, "Z2", place, expected.z_um, u_um)
        # Nothing under the tool makes a reading longer; of two within their noise the newer one is told.
        used, other = (z2, again) if z2.z_um > again.z_um + TOUCH_SD_PRIOR_UM else (again, z2)
        run.recorder.append(RejectedTouch(other.time_s))
        z2 = used
    middle_um, doubt_u_um = between(z2.z_um, above_um, way_um, u_um)
    message = f"It is taken to be at {middle_um:.2f} ± {COVERAGE * doubt_u_um:.2f} µm."
    _report_doubt(run, z2, off, expected.source, message)
    return replace(z2.shifted(middle_um - z2.z_um), doubt_u_um=doubt_u_um)


def wash(run: JobRun, bottom_um: float) -> None:
    """Draw the tool out of the hole and bring it back above the bottom, again and again."""
    for _ in range(WASHING_STROKES):
        retract(run)
        lower_to(run, bottom_um - CLEAR_OF_BOTTOM_UM)


def _report_doubt(run: JobRun, z2: SurfaceReading, off: Deviation, source: str, what_now: str) -> None:
    way = f"{abs(off.um):.2f} ± {COVERAGE * off.u_um:.2f} µm {'short of' if off.um < 0.0 else 'beyond'}"
    chip = " (a chip?)" if off.um < 0.0 else ""
    run.decide(
        RunEvent.TOUCH_DOUBTED,
        f"Z2 = {z2.z_um:.2f} µm is {way} where {source} put the bottom{chip}. {what_now}",
        {"kind": "Z2", "off_um": off.um, "u_um": off.u_um, "z_um": z2.z_um},
        level=EventLevel.WARNING,
    )
