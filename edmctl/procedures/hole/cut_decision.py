"""What follows a cut: another one, the end, or the end short of the objective."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from edmctl.forecasts.measuring import cut_budget
from edmctl.labels import Verdict
from edmctl.machine.faults import host_fault
from edmctl.procedures.hole.cut import CutEnd, CutResult
from edmctl.procedures.hole.cut_planning import CutPlan, CutStart, following_plan
from edmctl.procedures.job import verdict_of
from edmctl.process.next_cut import is_done
from edmctl.record.rows import EventLevel, RunEvent
from edmctl.wording import decimal, plural, signed

if TYPE_CHECKING:
    from edmctl.procedures.job import HoleTarget
    from edmctl.procedures.run import JobRun
    from edmctl.process.live_erosion import ErosionEstimate
    from edmctl.process.touches import DepthAndWear
    from edmctl.profile.model import Profile


MOST_RATIO = 5.0
"""The recipe takes no wear.expected_ratio beyond it."""
LARGEST_FACTOR = 3.0
"""Of the wear ratio that the recipe expects; the other polarity wears the tool several times as fast."""
LEAST_EXPECTED = 0.02
"""A recipe that expects less wear than this is taken to expect this: no tool keeps its length altogether."""


@dataclass(frozen=True, slots=True)
class Decision:
    """The next cut, or None at the end; then `missed` says why the objective was missed, empty if not.

    `code` is the error code of a miss, `site` the hole that it is about.
    """

    plan: CutPlan | None
    message: str
    missed: str = ""
    hint: str = ""
    code: str = "E7010"
    site: str = ""


def decide(
    profile: Profile,
    target: HoleTarget,
    number: int,
    cut: CutResult | None,
    found: DepthAndWear,
    start: CutStart,
    estimate: ErosionEstimate,
    *,
    touch_final: bool = False,
    broken_cuts: int = 0,
) -> Decision:
    """Decide from what was measured after `number` cuts; another would start from `start`, with that estimate.

    `cut` is None where an earlier run made it. `touch_final` says that the last cut is measured however small;
    `broken_cuts` of the hole's came to no end and do not count.
    """
    if cut is not None and cut.end is not CutEnd.REACHED:
        return unfinished(target, cut, found.depth_um, found.feed_um)
    if target.kind == "feed" and cut is not None:
        return Decision(None, f"Feed {found.feed_um:.2f} µm of {target.feed_um:.0f} µm.")
    remaining_um = target.depth_um - found.depth_um
    done = is_done(remaining_um, target.tolerance_um, found.depth_noise_um)
    if done or number >= cut_budget(profile) + broken_cuts:
        return _final(profile, target, number, found)
    plan = following_plan(profile, target, number + 1, start, estimate, touch_final=touch_final)
    after = "measured" if plan.measured else "known well enough not to be measured"
    message = f"{remaining_um:.2f} µm are left: next cut feeds {plan.feed_um:.2f} µm, then {after}."
    return Decision(plan, message)


def out_of_time(target: HoleTarget, plan: CutPlan, limit: str) -> Decision:
    """Return the end before a cut for which `limit` leaves no time."""
    reached = target.reached(plan.start.depth_um, plan.start.depth_um + plan.start.wear_um)
    return _missed("TIMEOUT", f" No time is left for cut {plan.number}: {limit}; the job ends at {reached}.")


def unfinished(target: HoleTarget, cut: CutResult, depth_um: float, feed_um: float) -> Decision:
    """Return the end after a cut that did not reach its limit."""
    reached = target.reached(depth_um, feed_um)
    if cut.fault:
        return _missed(cut.fault, f" The cut ended early ({cut.message}) at {reached}.")
    missed = f"The cut ended early ({cut.reason}) at {reached}."
    hint = "Flush better (shorter jump.period_s, greater jump.height_um), or raise servo.reference."
    return Decision(None, missed, missed, hint)


def _missed(row: str, message: str) -> Decision:
    """Return the end by a row of the faults, and what was reached."""
    error = host_fault(row, message)
    return Decision(None, error.message, error.message, error.hint, error.code)


def _final(profile: Profile, target: HoleTarget, number: int, found: DepthAndWear) -> Decision:
    off_um = found.depth_um - target.depth_um
    cuts = plural(number, "cut")
    message = f"Depth {decimal(found.depth_um)} µm, {signed(off_um)} µm from the target, after {cuts}."
    verdict = verdict_of(target, found.depth_um, found.depth_u95_um, through=False)
    if verdict is not Verdict.MISSED:
        return Decision(None, message)
    return Decision(
        None,
        message,
        f"The depth is {decimal(found.depth_um)} µm after {cuts}, {signed(off_um)} µm from the target; "
        f"target.tolerance_um is {target.tolerance_um:.1f} µm.",
        remedy(profile, off_um, found.wear_ratio),
    )


def remedy(profile: Profile, off_um: float, wear_ratio: float = math.nan) -> str:
    """Return the remedy for a depth that misses its target by `off_um`; an unmeasured `wear_ratio` is NaN."""
    if off_um < 0.0:
        key = "max_cuts" if cut_budget(profile) == profile.wear.max_cuts else "remeasure"
        return f"Allow more cuts (wear.{key})."
    if 0.0 < wear_ratio <= MOST_RATIO:
        return f"Set wear.expected_ratio to {wear_ratio:.3f}, as measured."
    return "Cut less before the first measuring stop (wear.first_fraction)."


def refuse_wrong_setup(run: JobRun, found: DepthAndWear) -> None:
    """Raise MachineFault E67005 where the first cut wore the tool far too fast, or left a hill and no hole.

    Only what is beyond the uncertainty of the measurement counts.
    """
    expected = max(run.profile.wear.expected_ratio, LEAST_EXPECTED)
    least_wear_um = found.wear_um - found.wear_u95_um
    most_depth_um = found.depth_um + found.depth_u95_um
    if most_depth_um >= 0.0 and least_wear_um <= LARGEST_FACTOR * expected * most_depth_um:
        return
    error = host_fault(
        "SETUP",
        f" The first cut has a depth of {found.depth_um:.2f} µm and a wear of {found.wear_um:.2f} µm; "
        f"{expected:g} µm per µm were expected.",
    )
    args = {"depth_um": found.depth_um, "wear_um": found.wear_um, "expected_ratio": expected}
    run.decide(RunEvent.SETUP_WRONG, error.message, args, level=EventLevel.ERROR)
    raise error
