"""What follows a measured cut: another one, the end, or the end short of the objective."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from edmctl.machine.port import host_fault
from edmctl.procedures.cut import CutEnd, CutResult
from edmctl.procedures.planning import CutPlan, cut_budget, following_plan
from edmctl.process.next_cut import next_cut

if TYPE_CHECKING:
    from edmctl.process.wear import DepthAndWear
    from edmctl.profile.model import Profile


@dataclass(frozen=True, slots=True)
class Decision:
    """The next cut, or None at the end; then `missed` says why the objective was missed, empty if not.

    `code` is the error code of a miss.
    """

    plan: CutPlan | None
    message: str
    missed: str = ""
    hint: str = ""
    code: str = "E7010"


def decide(
    profile: Profile, last: CutPlan, cut: CutResult, found: DepthAndWear, bottom_um: float, gap_um: float
) -> Decision:
    """Decide from what was measured after a cut: bottom at `bottom_um`, working gap `gap_um`."""
    if cut.end is not CutEnd.REACHED:
        return _unfinished(profile, cut, found)
    if found.wear_um > profile.tool.max_wear_um:
        return Decision(
            None,
            "The tool is worn out.",
            f"The tool lost {found.wear_um:.0f} µm; tool.max_wear_um is {profile.tool.max_wear_um:.0f} µm.",
            "Dress or change the tool.",
        )
    target = profile.target
    if target.kind == "feed":
        return Decision(None, f"Feed {found.feed_um:.2f} µm of {target.feed_um:.0f} µm.")
    step = next_cut(
        target_um=target.depth_um,
        depth_um=found.depth_um,
        wear_ratio=found.wear_ratio,
        tolerance_um=target.tolerance_um,
        depth_noise_um=found.depth_noise_um,
    )
    if step.done or last.number >= cut_budget(profile):
        return _final(target.depth_um, target.tolerance_um, last, found)
    message = f"{step.remaining_um:.2f} µm are left: next cut feeds {step.feed_um:.2f} µm."
    return Decision(following_plan(last, step.feed_um, bottom_um, gap_um, found), message)


def out_of_time(profile: Profile, plan: CutPlan, limit: str) -> Decision:
    """The end before a cut for which `limit` leaves no time."""
    feed_um = plan.depth_before_um + plan.wear_before_um
    reached = _reached(profile, plan.depth_before_um, feed_um)
    return _missed("TIMEOUT", f" No time is left for cut {plan.number}: {limit}; the job ends at {reached}.")


def _missed(row: str, told: str) -> Decision:
    """The end by a row of the faults, and what was reached."""
    error = host_fault(row, told)
    return Decision(None, error.message, error.message, error.hint, error.code)


def _reached(profile: Profile, depth_um: float, feed_um: float) -> str:
    """What was reached of what was wanted."""
    target = profile.target
    if target.kind == "feed":
        return f"a feed of {feed_um:.2f} of {target.feed_um:g} µm"
    return f"a depth of {depth_um:.2f} of {target.depth_um:g} µm"


def _final(target_um: float, tolerance_um: float, last: CutPlan, found: DepthAndWear) -> Decision:
    off_um = found.depth_um - target_um
    message = f"Depth {found.depth_um:.2f} µm, {off_um:+.2f} µm from the target, after {last.number} cuts."
    if abs(off_um) <= tolerance_um:
        return Decision(None, message)
    return Decision(
        None,
        message,
        f"The depth is {found.depth_um:.2f} µm after {last.number} cuts, {off_um:+.2f} µm from the target; "
        f"target.tolerance_um is {tolerance_um:.1f} µm.",
        f"Allow more cuts with wear.max_cuts, or set wear.expected_ratio to {found.wear_ratio:.3f}, as measured.",
    )


def _unfinished(profile: Profile, cut: CutResult, found: DepthAndWear) -> Decision:
    reached = _reached(profile, found.depth_um, found.feed_um)
    if cut.fault:
        return _missed(cut.fault, f" The cut ended early ({cut.told}) at {reached}.")
    missed = f"The cut ended early ({cut.reason}) at {reached}."
    hint = "Flush better (shorter jump.period_s, greater jump.height_um), or raise servo.reference."
    return Decision(None, missed, missed, hint)
