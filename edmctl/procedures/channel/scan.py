"""One pass along a channel: the stages follow lines from a queue while the tool is held at a sinking height.

The height of each line's end is planned when the line is sent, seconds before the tool is there: by the energy of
the pass so far, and the energy per length for the rest. So the floor is even although the wear along a path is not.
"""

from __future__ import annotations

import math

import numpy as np

from edmctl.array_types import Array
from edmctl.dataclasses import dataclass
from edmctl.errors import PreconditionError
from edmctl.machine.interface import SLICE_S, CutRequest, EventCode, MachineEvent, MachineState, ScanLine
from edmctl.procedures.hole.cut_planning import energy_of
from edmctl.procedures.job import Counts
from edmctl.procedures.run import JobRun
from edmctl.procedures.servo.supervisor import TelemetrySums
from edmctl.procedures.settings import gap_reference_v
from edmctl.process.channel import HeldTool, ToolWear, Way, wearing_uj
from edmctl.quantity import half_width
from edmctl.results.telemetry import TelemetryBlock

LOOK_AHEAD_S = 3.0
"""Lines are sent this long before the tool gets there, so that a late host does not stop it; a line that is sent has
the wear as known then."""
HELD_WITHIN_UM = 0.4
"""Tolerance of a tool at its limit: noise of the sensor over 0.1 s, and the servo's step."""
LEARN_OVER_UM = 200.0  # weight of the expected energy per length, as a length of the pass
HELD_ENOUGH = 0.8
"""A layer is cut when the tool was at its limit on this share of the path; the next one removes the rest."""
STALLED_S = 10.0  # stages that stop for this long over a gap that is not shorted have lost their lines
TIME_SLACK_S = 2.0  # the host ends a pass when the time is up; the controller would do so this much later


@dataclass(frozen=True, slots=True, eq=False)
class PassPlan:
    """One pass: its way and speed, where the tool is held, and the expected wearing energy per length.

    `since_uj` is the wearing energy from the last touch of the pad to this pass, `rest_s` the machining time after
    it. `number` counts passes from 1; 0 is unknown. `wear_u_um` is the standard uncertainty of the wear before the
    pass, without that by energy.
    """

    way: Way
    speed_um_s: float
    held: HeldTool
    uj_per_um: float
    since_uj: float
    rest_s: float
    number: int = 0
    wear_u_um: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class PassResult:
    """Result of a pass. `fault` names the row of the faults that ended it early, `message` the reason; else both
    empty.

    `held_share` is the share of the path on which the tool was at its limit. `counts` are pulses by class (open,
    normal, arc, short), `wearing_uj` the energy that wore the tool. `limits_um` is the limit at each point of the
    way, `used_uj` the wearing energy of the pass when the tool was there, shape (n,).
    """

    limits_um: Array
    used_uj: Array
    time_s: float = 0.0
    held_share: float = 0.0
    gap_ratio_mean: float = math.nan
    counts: Counts = (0, 0, 0, 0)
    energy_j: float = 0.0
    wearing_uj: float = 0.0
    fault: str = ""
    message: str = ""

    @property
    def held(self) -> bool:
        """Whether the tool was at its limit on nearly all of the path."""
        return not self.fault and self.held_share >= HELD_ENOUGH

    @property
    def open_share(self) -> float:
        """Share of open pulses."""
        return self.counts[0] / max(1, sum(self.counts))


def run_pass(run: JobRun, plan: PassPlan, wear: ToolWear, left_s: float, time_limit: str) -> PassResult:
    """Follow the path once; the tool is then held with the pulses off."""
    start_s = run.machine.time_s
    follower = PassFollower(run, start_s, plan.number)
    feeder = _Feeder(run, plan, wear, follower)
    run.watch.follow(follower.on_telemetry)
    try:
        limit_um = feeder.limits_um[0]
        run.machine.start_scan(CutRequest(gap_reference_v(run.profile), limit_um, left_s + TIME_SLACK_S))
        ended, fault, message = _watch(run, feeder, start_s + left_s, time_limit)
    finally:
        run.watch.follow(None)
    return PassResult(
        time_s=ended.time_s - start_s,
        held_share=feeder.held_share,
        gap_ratio_mean=follower.gap_ratio_mean,
        counts=follower.total,
        energy_j=follower.energy_j,
        wearing_uj=follower.wearing_uj,
        limits_um=feeder.limits_um,
        used_uj=feeder.used_uj(),
        fault=fault,
        message=message,
    )


def _watch(run: JobRun, feeder: _Feeder, end_s: float, time_limit: str) -> tuple[MachineEvent, str, str]:
    while True:
        ended = run.machine.watch_cut(SLICE_S)
        if ended is not None:
            return (ended, "", "") if ended.code is EventCode.PATH_DONE else (ended, "TIMEOUT", time_limit)
        if message := feeder.follower.unstable or feeder.stalled:
            return run.machine.stop_cut(), "STALL", message
        if run.machine.time_s >= end_s:
            return run.machine.stop_cut(), "TIMEOUT", time_limit
        try:
            feeder.feed()
        except PreconditionError:
            # A pass that has ended takes no lines: its end, or the fault behind it, is on its way.
            ended = run.machine.watch_cut(SLICE_S)
            if ended is None:
                raise
            return ended, "TIMEOUT", time_limit


class _Feeder:
    """Follows the tool along its way, and sends the lines ahead of it."""

    def __init__(self, run: JobRun, plan: PassPlan, wear: ToolWear, follower: PassFollower) -> None:
        self._run, self._plan, self._wear, self.follower = run, plan, wear, follower
        self._sent, self._here_um = 0, 0.0
        self._slices = self._held_slices = 0
        self._trace: list[tuple[float, float]] = [(0.0, 0.0)]
        self._moved_s = math.inf
        self.limits_um = np.full(len(plan.way.points), self._limit_um(0))

    @property
    def held_share(self) -> float:
        """Share of the slices, while the tool moved, in which it was at its limit."""
        return self._held_slices / self._slices if self._slices else 0.0

    @property
    def stalled(self) -> str:
        """What is wrong with stages that have stopped; empty while they move."""
        if self._run.machine.time_s - self._moved_s <= STALLED_S:
            return ""
        return f"the stages stood still for {STALLED_S:.0f} s, {self._here_um:.0f} µm along the path"

    def used_uj(self) -> Array:
        """Return the wearing energy of the pass when the tool was at each point, shape (n,)."""
        s_um, uj = np.array(self._trace).T
        used: Array = np.interp(self._plan.way.lengths_um, s_um, uj)
        return used

    def feed(self) -> None:
        """Locate the tool, and send the lines that it will soon need."""
        way, follower = self._plan.way, self.follower
        status = self._run.machine.status()
        ahead_um = self._plan.speed_um_s * LOOK_AHEAD_S
        before_um = self._here_um
        self._here_um = way.length_at(status.x_um, status.y_um, before_um, 2.0 * ahead_um)
        if self._here_um != before_um or follower.shorted or math.isinf(self._moved_s):
            self._moved_s = self._run.machine.time_s
        below_um = follower.displacement_um - float(np.interp(self._here_um, way.lengths_um, self.limits_um))
        held = below_um >= -HELD_WITHIN_UM
        self._follow(below_um)
        if self._sent:
            self._slices += 1
            self._held_slices += held
            self._trace.append((self._here_um, follower.wearing_uj))
        while self._sent < len(way.points) - 1 and way.lengths_um[self._sent] < self._here_um + ahead_um:
            if not self._send(self._sent + 1):
                return

    def _send(self, i: int) -> bool:
        """Send the line to point `i`; return False if the queue is full."""
        x_um, y_um = (float(c) for c in self._plan.way.points[i])
        limit_um = self._limit_um(i)
        last = i == len(self._plan.way.points) - 1
        if not self._run.machine.path_move(ScanLine(x_um, y_um, self._plan.speed_um_s, limit_um, last)):
            return False
        self.limits_um[i:] = limit_um
        self._sent = i
        return True

    def _limit_um(self, i: int) -> float:
        plan, used_uj = self._plan, self.follower.wearing_uj
        ahead_um = float(plan.way.lengths_um[i]) - self._here_um
        uj_per_um = (plan.uj_per_um * LEARN_OVER_UM + used_uj) / (LEARN_OVER_UM + self._here_um)
        x_um, y_um = plan.way.points[i]
        wear_um = self._wear.um(plan.since_uj + used_uj + ahead_um * uj_per_um)
        return plan.held.z_um((float(x_um), float(y_um)), wear_um)

    def _follow(self, below_um: float) -> None:
        plan, follower = self._plan, self.follower
        if not math.isnan(below_um):
            follower.depth_um = max(0.0, plan.held.depth_um + min(0.0, below_um))
        used_uj = plan.since_uj + follower.wearing_uj
        follower.wear_um = self._wear.um(used_uj)
        follower.wear_u95_um = half_width(math.hypot(plan.wear_u_um, self._wear.u_um(used_uj)))
        follower.time_left_s = plan.rest_s + (plan.way.length_um - self._here_um) / plan.speed_um_s


class PassFollower(TelemetrySums):
    """Follows the telemetry of a pass that begins at `start_s`; keeps its sums, and the tally of the job.

    The feeder sets `depth_um`, `wear_um`, `wear_u95_um` and `time_left_s`. `unstable` is why a pass should end,
    `shorted` whether most pulses of the last seconds were shorts.
    """

    def __init__(self, run: JobRun, start_s: float, number: int = 0) -> None:
        super().__init__(run, start_s)
        self._step = f"pass {number}" if number else ""
        self.depth_um = run.tally.depth_um
        self.wear_um = self.wear_u95_um = self.time_left_s = math.nan
        self.unstable, self.shorted = "", False

    @property
    def wearing_uj(self) -> float:
        """Energy of this pass so far that wore the tool, µJ."""
        return wearing_uj(energy_of(self._run.profile.pulse, self))

    def on_telemetry(self, block: TelemetryBlock) -> None:
        """Take the samples of one slice."""
        seen = block.summary
        self.add(seen)
        ratios = self.ratios
        self.shorted = ratios.short > 0.5
        if seen.state == MachineState.MACHINING:
            self.add_gap_ratio(seen.gap_mean_v, seen.samples)
            self.displacement_um = seen.mean_um
        over = self._ratio_limits.update(seen.end_s, ratios, window_is_full=self.window_is_full)
        if over:
            self.unstable = f"{over} have stayed over their limit"
        self.report(
            seen,
            self.depth_um,
            self.displacement_um,
            ratios=ratios,
            time_left_s=self.time_left_s,
            step=self._step,
            wear_um=self.wear_um,
            wear_u95_um=self.wear_u95_um,
        )
