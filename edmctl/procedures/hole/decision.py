"""What follows a measurement cycle: another cut, the end, or the end short of the target."""

from __future__ import annotations

import math

from edmctl.dataclasses import dataclass
from edmctl.labels import Verdict
from edmctl.machine.faults import host_fault
from edmctl.planning.measuring import cut_budget
from edmctl.procedures.hole.cut import CutEnd, CutResult
from edmctl.procedures.hole.cut_planning import CutPlan, CutStart, following_plan
from edmctl.procedures.job import HoleTarget, verdict_of
from edmctl.procedures.run import JobRun
from edmctl.process.live_erosion import ErosionEstimate
from edmctl.process.next_cut import is_done
from edmctl.process.touches import DepthAndWear
from edmctl.profile.model import Profile
from edmctl.record.rows import EventLevel, RunEvent
from edmctl.wording import decimal, plural, signed

MOST_RATIO = 5.0
"""Upper bound of wear.expected_ratio in a recipe."""
LARGEST_FACTOR = 3.0
"""Relative to the expected wear ratio; the other polarity wears the tool several times as fast."""
LEAST_EXPECTED = 0.02
"""Wear ratio that is assumed for recipes that expect less: every tool wears."""


@dataclass(frozen=True, slots=True)
class Decision:
    """The next cut, or None at the end.

    `missed` is why the objective was missed, empty if it was not; `code` the error code of that, `site` its hole.
    """

    plan: CutPlan | None
    message: str
    missed: str = ""
    hint: str = ""
    code: str = "E7010"
    site: str = ""


def report_end(run: JobRun, decision: Decision, depth_um: float) -> None:
    """Record a decision that ends a hole."""
    code = RunEvent.TARGET_MISSED if decision.missed else RunEvent.TARGET_REACHED
    level = EventLevel.WARNING if decision.missed else EventLevel.INFO
    run.decide(code, decision.message, {"depth_um": depth_um, "hint": decision.hint}, level=level)


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
    """Decide from the measured lengths after `number` cuts; another cut would begin from `start`.

    `cut` is None if an earlier run made it. `touch_final` measures the last cut however small. The `broken_cuts` of
    the hole do not use up its budget.
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
    error = host_fault(row, message)
    return Decision(None, error.message, error.message, error.hint, error.code)


def _final(profile: Profile, target: HoleTarget, number: int, found: DepthAndWear) -> Decision:
    off_um = found.depth_um - target.depth_um
    cuts = plural(number, "cut")
    message = f"Depth {decimal(found.depth_um)} µm, {signed(off_um)} µm from the target, after {cuts}."
    if verdict_of(target, found.depth_um, found.depth.u95, through=False) is not Verdict.MISSED:
        return Decision(None, message)
    missed = (
        f"The depth is {decimal(found.depth_um)} µm after {cuts}, {signed(off_um)} µm from the target; "
        f"target.tolerance_um is {target.tolerance_um:.1f} µm."
    )
    return Decision(None, message, missed, remedy(profile, off_um, found.wear_ratio))


def remedy(profile: Profile, off_um: float, wear_ratio: float = math.nan) -> str:
    """Return the remedy for a depth that misses its target by `off_um`; an unmeasured `wear_ratio` is NaN."""
    if off_um < 0.0:
        key = "max_cuts" if cut_budget(profile) == profile.wear.max_cuts else "remeasure"
        return f"Allow more cuts (wear.{key})."
    if 0.0 < wear_ratio <= MOST_RATIO:
        return f"Set wear.expected_ratio to {wear_ratio:.3f}, as measured."
    return "Cut less before the first measuring stop (wear.first_fraction)."


def refuse_wrong_setup(run: JobRun, found: DepthAndWear) -> None:
    """Raise MachineFault E67005 if the first cut wore the tool far too fast, or left no hole.

    Only what exceeds the uncertainty of the measurement counts.
    """
    expected = max(run.profile.wear.expected_ratio, LEAST_EXPECTED)
    least_wear_um, most_depth_um = found.wear.interval()[0], found.depth.interval()[1]
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
