"""One cut: the servo runs in the controller, the host watches, jumps on time, and says when it is over.

And what follows it: another one, the end, or the end short of the objective.
"""

from __future__ import annotations

import math
from enum import StrEnum

from edmctl.dataclasses import dataclass
from edmctl.errors import MachineFault
from edmctl.labels import Verdict
from edmctl.machine.faults import host_fault
from edmctl.machine.interface import EventCode, MachineEvent
from edmctl.planning.measuring import cut_budget
from edmctl.procedures.hole.cut_planning import CutPlan, CutStart, following_plan
from edmctl.procedures.hole.running_cut import NO_SPARK, ArcRecovery, CutControl, with_a_check
from edmctl.procedures.job import HoleTarget, verdict_of
from edmctl.procedures.run import JobRun
from edmctl.procedures.servo.limits import TimeLeft
from edmctl.procedures.servo.supervisor import StopReason, Supervisor
from edmctl.process.live_erosion import ErosionEstimate
from edmctl.process.next_cut import is_done
from edmctl.process.touches import DepthAndWear
from edmctl.profile.model import Profile
from edmctl.record.rows import EventLevel, EventRow, RunEvent
from edmctl.results.telemetry import PulseShares, pulse_shares
from edmctl.wording import decimal, plural, signed

STATUS_PERIOD_S = 5.0
"""The dielectric is asked for this often; the controller itself guards it."""
SPARKLESS_UM = 1.0
"""A cut that ends so far beyond its last discharge has not cut that way; good cuts end within 0.2 µm of it."""
_ROWS = {StopReason.STALLED: "STALL", StopReason.ENDED: "STROKE_END"}
"""The fault row of a reason to stop."""
MOST_RATIO = 5.0
"""The recipe takes no wear.expected_ratio beyond it."""
LARGEST_FACTOR = 3.0
"""Of the wear ratio that the recipe expects; the other polarity wears the tool several times as fast."""
LEAST_EXPECTED = 0.02
"""A recipe that expects less wear than this is taken to expect this: no tool keeps its length altogether."""


class CutEnd(StrEnum):
    """How a cut ended."""

    REACHED = "feed reached"
    TIME_UP = "time limit"
    GIVEN_UP = "given up"


@dataclass(frozen=True, slots=True)
class CutResult:
    """What a cut did. `counts` are its pulses by class: open, normal, arc, short; `energy_j` as in SiteResult.

    `is_at_limit` says that the tool sparked at the feed limit in the end: its gap to the bottom is a working gap.
    `fault` names the row of the faults that ended it, empty where none did; `message` holds the figures of that.
    `breakthrough_um` is the displacement at which the sheet broke through, NaN where it did not.
    """

    end: CutEnd
    reason: str
    time_s: float
    end_displacement_um: float
    counts: tuple[int, int, int, int]
    gap_ratio_mean: float
    energy_j: float
    is_at_limit: bool
    fault: str = ""
    message: str = ""
    jumps: int = 0
    breakthrough_um: float = math.nan

    @property
    def through(self) -> bool:
        """Whether the sheet broke through."""
        return not math.isnan(self.breakthrough_um)

    @property
    def pulses(self) -> int:
        """All pulses of the cut."""
        return sum(self.counts)

    @property
    def ratios(self) -> PulseShares:
        """Share of each class."""
        return pulse_shares(*self.counts)


def run_cut(run: JobRun, plan: CutPlan, time_left: TimeLeft) -> CutResult:
    """Machine to the plan's limit, while there is time left; the tool is then held with the pulses off."""
    run.decide(
        RunEvent.CUT_PLANNED,
        f"Cut {plan.number}: feed {plan.feed_um:.1f} µm to {plan.z_limit_um:.1f} µm, expecting a gap of "
        f"{plan.start.gap_um:.2f} µm and {plan.wear_ratio:.3f} µm wear per µm depth.",
        {
            "cut": plan.number,
            "feed_um": plan.feed_um,
            "z_limit_um": plan.z_limit_um,
            "gap_um": plan.start.gap_um,
            "wear_ratio": plan.wear_ratio,
            **({} if math.isnan(plan.target_um) else {"target_um": plan.target_um}),
        },
    )
    start_s = run.machine.time_s
    supervisor = Supervisor(run, plan, start_s)
    cutting = CutControl(run, plan, supervisor, start_s + time_left.seconds)
    run.watch.follow(supervisor.on_telemetry)
    try:
        cutting.start()
        ended = _watch(run, cutting, ArcRecovery(run, plan, supervisor, cutting), supervisor)
        cutting.finish()
    finally:
        run.watch.follow(None)
    result = _result(plan, supervisor, cutting, ended, ended.time_s - start_s, time_left.limit)
    _report(run, plan, result)
    return result


def _watch(run: JobRun, cutting: CutControl, burns: ArcRecovery, supervisor: Supervisor) -> MachineEvent:
    """Watch until the end, over burns that can be recovered from."""
    while True:
        try:
            return _watch_sparks(run, cutting, supervisor)
        except MachineFault as fault:
            if fault.code == NO_SPARK:
                raise with_a_check(fault, supervisor.displacement_um) from fault
            burns.answer(fault)


def _watch_sparks(run: JobRun, cutting: CutControl, supervisor: Supervisor) -> MachineEvent:
    next_status_s = run.machine.time_s
    while True:
        ended = run.machine.watch_cut(supervisor.slice_s(run.machine.time_s))
        if ended is not None:
            return ended
        if run.machine.time_s >= next_status_s:
            supervisor.status = run.machine.status()
            next_status_s += STATUS_PERIOD_S
        if supervisor.stop_reason is not None:
            ended = run.machine.stop_cut()
            _record_stop_reason(run, supervisor)
            return ended
        if cutting.is_complete:
            return run.machine.stop_cut()
        ended = cutting.retune()
        if ended is not None:
            return ended
        cutting.jump_if_due()


def _record_stop_reason(run: JobRun, supervisor: Supervisor) -> None:
    """Say why the cut was ended: after the pulses are off, because writing takes time."""
    message = (
        f"{supervisor.stop_reason}: {supervisor.message}"
        if supervisor.message
        else str(supervisor.stop_reason)
    )
    args = {"displacement_um": supervisor.displacement_um}
    run.recorder.append(
        EventRow(run.machine.time_s, RunEvent.CUT_GIVEN_UP, EventLevel.WARNING, message, args)
    )


def _result(
    plan: CutPlan,
    supervisor: Supervisor,
    cutting: CutControl,
    ended: MachineEvent,
    time_s: float,
    time_limit: str,
) -> CutResult:
    """At CUT_DONE the controller's low-passed sensor stood at the limit: that is the displacement.

    But for a tool that has come there without sparks.
    """
    end = {EventCode.CUT_DONE: CutEnd.REACHED, EventCode.TIME_UP: CutEnd.TIME_UP}.get(
        ended.code, CutEnd.GIVEN_UP
    )
    stop_reason = supervisor.stop_reason
    at_limit, reason = end is CutEnd.REACHED, end.value
    if cutting.is_complete and stop_reason is None:
        end, reason = CutEnd.REACHED, "through"
    fault, message = ("", "") if stop_reason is None else (_ROWS.get(stop_reason, ""), supervisor.message)
    if end is CutEnd.TIME_UP:
        fault, message = "TIMEOUT", time_limit
    end_um = _end_um(plan, supervisor, ended, at_limit=at_limit)
    return CutResult(
        end=end,
        reason=reason if stop_reason is None else stop_reason.value,
        time_s=time_s,
        end_displacement_um=end_um,
        is_at_limit=at_limit and end_um == plan.z_limit_um,
        counts=supervisor.total,
        gap_ratio_mean=supervisor.gap_ratio_mean,
        energy_j=supervisor.energy_j,
        fault=fault,
        message=message,
        jumps=cutting.jumps,
        breakthrough_um=supervisor.breakthrough.at_um,
    )


def _end_um(plan: CutPlan, supervisor: Supervisor, ended: MachineEvent, *, at_limit: bool) -> float:
    end_um = plan.z_limit_um if at_limit else ended.displacement_um
    sparked_um = supervisor.sparked_at_um
    if not supervisor.is_through and end_um - sparked_um > SPARKLESS_UM:
        return sparked_um
    return end_um


def _report(run: JobRun, plan: CutPlan, result: CutResult) -> None:
    ratios = result.ratios
    run.decide(
        RunEvent.CUT_ENDED,
        f"Cut {plan.number} ended after {result.time_s:.1f} s at {result.end_displacement_um:.1f} µm "
        f"({result.reason}); {100 * ratios.normal:.0f} % normal, {100 * ratios.arc:.1f} % arcs, "
        f"{100 * ratios.short:.1f} % shorts.",
        {
            "cut": plan.number,
            "time_s": result.time_s,
            "z_um": result.end_displacement_um,
            "pulses": result.pulses,
            "jumps": result.jumps,
        },
        level=EventLevel.INFO if result.end is CutEnd.REACHED else EventLevel.WARNING,
    )


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
    verdict = verdict_of(target, found.depth_um, found.depth.u95, through=False)
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
    least_wear_um = found.wear.interval()[0]
    most_depth_um = found.depth.interval()[1]
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
