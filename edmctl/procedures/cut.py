"""One cut: the servo runs in the controller, the host watches, jumps on time, and says when it is over."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

from edmctl.machine.port import CutRequest, EventCode, MachineEvent
from edmctl.procedures.codes import RunEvent
from edmctl.procedures.jumping import jump_request
from edmctl.procedures.settings import gap_reference_v
from edmctl.procedures.supervisor import Supervisor, Verdict
from edmctl.process.pulses import pulse_shares
from edmctl.record.rows import EventLevel

if TYPE_CHECKING:
    from edmctl.procedures.planning import CutPlan
    from edmctl.procedures.results import PulseRatios
    from edmctl.procedures.run import Run
    from edmctl.procedures.time_limits import TimeLeft

WATCH_SLICE_S = 0.1
STATUS_PERIOD_S = 5.0
"""The dielectric is asked for this often; the controller itself guards it."""
JUMP_RESERVE_UM = 5.0
"""A jump leaves this much displacement, because the actuator cannot go below 0 V."""
LEAST_JUMP_UM = 10.0


class CutEnd(StrEnum):
    """How a cut ended."""

    REACHED = "feed reached"
    TIME_UP = "time limit"
    GIVEN_UP = "given up"


_ROWS = {Verdict.STALLED: "STALL", Verdict.ENDED: "STROKE_END"}
"""The fault row of a verdict."""


@dataclass(frozen=True, slots=True)
class CutResult:
    """What a cut did. `counts` are its pulses by class: open, normal, arc, short; `energy_j` as in SiteResult.

    `fault` names the row of the faults that ended it, empty where none did; `told` holds the figures of that.
    """

    end: CutEnd
    reason: str
    time_s: float
    end_displacement_um: float
    counts: tuple[int, int, int, int]
    gap_ratio_mean: float
    energy_j: float
    fault: str = ""
    told: str = ""

    @property
    def pulses(self) -> int:
        """All pulses of the cut."""
        return sum(self.counts)

    @property
    def ratios(self) -> PulseRatios:
        """Share of each class."""
        return pulse_shares(*self.counts)


def run_cut(run: Run, plan: CutPlan, time_left: TimeLeft) -> CutResult:
    """Machine to the plan's limit, while there is time left; the tool is then held with the pulses off."""
    run.decide(
        RunEvent.CUT_PLANNED,
        f"Cut {plan.number}: feed {plan.feed_um:.1f} µm to {plan.z_limit_um:.1f} µm, expecting a gap of "
        f"{plan.gap_um:.2f} µm and {plan.wear_ratio:.3f} µm wear per µm depth.",
        {"cut": plan.number, "feed_um": plan.feed_um, "z_limit_um": plan.z_limit_um, "gap_um": plan.gap_um},
    )
    start_s = run.machine.time_s
    supervisor = Supervisor(run, plan, start_s)
    run.watch.follow(supervisor.take)
    try:
        run.machine.start_cut(CutRequest(gap_reference_v(run.profile), plan.z_limit_um, time_left.seconds))
        ended = _watch(run, supervisor)
    finally:
        run.watch.follow(None)
    result = _result(plan, supervisor, ended, ended.time_s - start_s, time_left.limit)
    _report(run, plan, result)
    return result


def _watch(run: Run, supervisor: Supervisor) -> MachineEvent:
    jump = run.profile.jump
    next_jump_s = run.machine.time_s + jump.period_s
    next_status_s = run.machine.time_s
    while True:
        ended = run.machine.watch_cut(WATCH_SLICE_S)
        if ended is not None:
            return ended
        if run.machine.time_s >= next_status_s:
            supervisor.note_status(run.machine.status())
            next_status_s += STATUS_PERIOD_S
        if supervisor.verdict is not None:
            ended = run.machine.stop_cut()
            _tell_verdict(run, supervisor)
            return ended
        if jump.mode == "fixed" and run.machine.time_s >= next_jump_s:
            _jump(run, supervisor)
            next_jump_s = run.machine.time_s + jump.period_s


def _tell_verdict(run: Run, supervisor: Supervisor) -> None:
    """Say why the cut was ended: after the pulses are off, because writing takes time."""
    told = f"{supervisor.verdict}: {supervisor.told}" if supervisor.told else str(supervisor.verdict)
    args = {"displacement_um": supervisor.displacement_um}
    run.recorder.event(run.machine.time_s, RunEvent.CUT_GIVEN_UP, EventLevel.WARNING, told, args)


def _jump(run: Run, supervisor: Supervisor) -> None:
    jump = run.profile.jump
    height_um = min(jump.height_um, supervisor.displacement_um - JUMP_RESERVE_UM)
    if not height_um >= LEAST_JUMP_UM:
        return
    run.machine.jump(jump_request(run, height_um))
    run.recorder.event(
        run.machine.time_s, RunEvent.JUMPED, EventLevel.DEBUG, "jump", {"height_um": height_um}
    )


def _result(
    plan: CutPlan, supervisor: Supervisor, ended: MachineEvent, time_s: float, time_limit: str
) -> CutResult:
    """At CUT_DONE the controller's low-passed sensor stood at the limit: that is the displacement."""
    end = {EventCode.CUT_DONE: CutEnd.REACHED, EventCode.TIME_UP: CutEnd.TIME_UP}.get(
        ended.code, CutEnd.GIVEN_UP
    )
    reached = end is CutEnd.REACHED
    counts, verdict = supervisor.counts, supervisor.verdict
    fault, told = ("", "") if verdict is None else (_ROWS.get(verdict, ""), supervisor.told)
    if end is CutEnd.TIME_UP:
        fault, told = "TIMEOUT", time_limit
    return CutResult(
        end=end,
        reason=end.value if verdict is None else verdict.value,
        time_s=time_s,
        end_displacement_um=plan.z_limit_um if reached else ended.displacement_um,
        counts=(counts[0], counts[1], counts[2], counts[3]),
        gap_ratio_mean=supervisor.gap_ratio_mean,
        energy_j=supervisor.energy_j,
        fault=fault,
        told=told,
    )


def _report(run: Run, plan: CutPlan, result: CutResult) -> None:
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
        },
        level=EventLevel.INFO if result.end is CutEnd.REACHED else EventLevel.WARNING,
    )
