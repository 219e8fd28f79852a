"""Layers of a channel, and passes along it: the stages follow lines while the tool is held at a sinking height.

The height of each line's end is planned when the line is sent, seconds before the tool is there: by the energy of
the pass so far, and the energy per length for the rest. So the floor is even although the wear along a path is not.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from edmctl.errors import PreconditionError
from edmctl.machine.interface import SLICE_S, CutRequest, EventCode, MachineEvent, MachineState, ScanLine
from edmctl.planning.removal import SIDE_DISCHARGE_SHARE, removal_um3_s
from edmctl.procedures.channel.touching import (
    FLOOR_U_UM,
    ChannelSurface,
    FloorReading,
    PassPlan,
    PassResult,
    learned_gap_um,
)
from edmctl.procedures.hole.cut_planning import energy_of
from edmctl.procedures.job import CutTotals, RunningCut
from edmctl.procedures.run import JobRun
from edmctl.procedures.servo.limits import TimeLimits
from edmctl.procedures.servo.supervisor import TelemetrySums
from edmctl.procedures.settings import gap_reference_v
from edmctl.procedures.stages import move_to
from edmctl.procedures.touch.approach import approach_bottom
from edmctl.process.channel import HeldTool, ToolWear, Way, channel_width_um, passes_needed, wearing_uj
from edmctl.process.erosion import hole_area_um2
from edmctl.process.touches import TOUCH_U_UM
from edmctl.profile.model import Profile
from edmctl.profile.places import Place
from edmctl.quantity import half_width
from edmctl.record.rows import EventLevel, RunEvent
from edmctl.results.telemetry import TelemetryBlock

LOOK_AHEAD_S = 3.0  # lines are sent this early, so that a late host stops no tool
HELD_WITHIN_UM = 0.4  # tolerance of a tool at its limit: noise of the sensor over 0.1 s, and the servo's step
LEARN_OVER_UM = 200.0  # weight of the expected energy per length, as a length of the pass
STALLED_S = 10.0  # stages that stop for this long over a gap that is not shorted have lost their lines
TIME_SLACK_S = 2.0  # the host ends a pass when the time is up; the controller would do so this much later
QUIET_SHARE = 0.65  # a floor is even if this share of the pulses is open; the servo's own gap has 0.3
GAP_GROWTH = 1.25  # gap of an evened floor relative to the servo's, until measured: half the pulses ignite
SPARE_PASSES = 4  # a layer may take these and twice the passes that its volume needs
MOST_TO_EVEN = 8  # passes at one height to even out the floor before a measuring stop


class Layers:
    """The layers cut so far, the wear of the tool, and the gap that a held tool leaves.

    `since_uj` is the wearing energy since the last measurement, at `since_s`, `measured_u_um` the standard
    uncertainty of the wear measured then; `last` the newest pass. `aim_um` is the depth of the layer under way,
    `behind` says that it took more passes than it may. `keep` is called before every pass.
    """

    def __init__(
        self, run: JobRun, limits: TimeLimits, way: Way, surface: ChannelSurface, speed_um_s: float
    ) -> None:
        profile = run.profile
        self._run, self._limits, self._way, self._speed_um_s = run, limits, way, speed_um_s
        self._width_um = channel_width_um(profile.tool.diameter_um, profile.work.side_gap_um)
        self._engaged = self.behind = False
        self.surface = surface
        self.wear = wear_of(profile)
        self.gap_um = GAP_GROWTH * profile.measure.expected_gap_um
        self.depth_um = self.aim_um = self.since_uj = self.measured_u_um = 0.0
        self.since_s = surface.z1.time_s
        self.layers, self.sums = 0, CutTotals()
        self.keep: Callable[[], None] = lambda: None
        self.last: tuple[PassPlan, PassResult] | None = None

    @property
    def wear_u_um(self) -> float:
        """Standard uncertainty of the tip of the tool: wear since the last measurement, and drift."""
        return math.hypot(self.wear.u_um(self.since_uj), self._drift_um(self._run.machine.time_s))

    def _drift_um(self, time_s: float) -> float:
        return self._run.uncertainty.drift_u_um_per_s * (time_s - self.since_s)

    def cut(self, depth_um: float, layers_after: int, *, even_out: bool) -> tuple[str, str]:
        """Cut a layer down to `depth_um`; return fault row and message of an early end, or empty ones."""
        left = self._limits.left()
        if left.seconds <= 0.0:
            return "TIMEOUT", left.limit
        profile, thickness_um = self._run.profile, depth_um - self.depth_um
        held = HeldTool(self.surface.z1.z_um, self.surface.plane, depth_um, self.gap_um)
        self.aim_um, self.behind = depth_um, False
        self._engage(held)
        rate_um3_s = removal_um3_s(profile, depth_um)
        needed = passes_needed(thickness_um, self._width_um, self._speed_um_s, rate_um3_s)
        uj_per_um = thickness_um * self._width_um / needed / _removal_um3_per_uj(profile)
        most = 2 * needed + SPARE_PASSES
        for _ in range(most):
            done = self._pass(held, uj_per_um, layers_after * needed)
            if done.fault:
                return done.fault, done.message
            uj_per_um = done.wearing_uj / self._way.length_um
            if done.held:
                break
        else:
            self.behind = True
            message = f"after {most} passes the tool was held on {100 * done.held_share:.0f} % of the path"
            return "STALL", message
        self.depth_um, self.layers = depth_um, self.layers + 1
        for _ in range(MOST_TO_EVEN if even_out else 0):
            done = self._pass(held, uj_per_um, 0)
            if done.fault:
                return done.fault, done.message
            if done.open_share >= QUIET_SHARE:
                break
            uj_per_um = done.wearing_uj / self._way.length_um
        return "", ""

    def learn(self, measured: FloorReading) -> None:
        """Update wear, wear per energy, the gap of a held tool and the depth by a measurement."""
        if self.last is None:
            raise ValueError("nothing was cut")
        wear_um = measured.pad.z_um - self.surface.z1.z_um
        self.wear.learn(self.since_uj, wear_um, self._drift_um(measured.pad.time_s))
        self.gap_um = learned_gap_um(*self.last, measured, self.wear, self.gap_um)
        self._start_from(measured)

    def resume(self, measured: FloorReading) -> None:
        """Take the first measurement after an earlier run, whose last sparks are in no sum: no wear rate."""
        self.wear.restart(measured.pad.z_um - self.surface.z1.z_um)
        self._start_from(measured)

    def _start_from(self, measured: FloorReading) -> None:
        self.depth_um, self._engaged = measured.depth_um, False
        self.since_uj, self.since_s = 0.0, measured.pad.time_s

    def _pass(self, held: HeldTool, uj_per_um: float, passes_after: int) -> PassResult:
        """Make one pass, against the direction of the one before."""
        run, left = self._run, self._limits.left()
        if left.seconds <= 0.0:
            nothing = np.zeros(len(self._way.points))
            return PassResult(nothing, nothing, fault="TIMEOUT", message=left.limit)
        way = self._way.reversed() if self.sums.number % 2 else self._way
        rest_s = passes_after * way.length_um / self._speed_um_s
        wear_u_um = math.hypot(self.measured_u_um, self._drift_um(run.machine.time_s))
        number = self.sums.number + 1
        plan = PassPlan(way, self._speed_um_s, held, uj_per_um, self.since_uj, rest_s, number, wear_u_um)
        before_s = run.tally.machining_time_s
        run.tally.unmeasured_site = run.profile.meta.name
        self.keep()
        done = PassFollower(run, plan, self.wear).run(left.seconds, left.limit)
        run.tally.machining_time_s = before_s + done.time_s
        run.tally.cut = RunningCut()
        self.sums, self.last = self.sums.plus(done), (plan, done)
        self.since_uj += done.wearing_uj
        ended_early = f"; ended early, {done.message}" if done.fault else ""
        figures = {"pass": number, "depth_um": held.depth_um, "time_s": done.time_s, "held": done.held_share}
        run.decide(
            RunEvent.PASS_ENDED,
            f"Pass {number} at {held.depth_um:.2f} µm took {done.time_s:.0f} s: held on "
            f"{100 * done.held_share:.0f} % of the path, {100 * done.open_share:.0f} % of the pulses open"
            f"{ended_early}.",
            {**figures, "open": done.open_share, "wear_um": self.wear.um(self.since_uj)},
            level=EventLevel.WARNING if done.fault else EventLevel.INFO,
        )
        return done

    def _engage(self, held: HeldTool) -> None:
        """Go to the start of the next pass, and down to the first sparks, unless the tool is there."""
        if self._engaged:
            return
        is_back = self.sums.number % 2
        x_um, y_um = self._way.at(self._way.length_um if is_back else 0.0)
        move_to(self._run, Place("the path's end" if is_back else "the path's start", x_um, y_um))
        before = HeldTool(held.pad_um, held.plane, self.depth_um, held.gap_um)
        floor_um = before.floor_um((x_um, y_um), self.wear.um(self.since_uj))
        floor_u_um = math.hypot(self.wear_u_um, self.surface.plane.height_u_um(x_um, y_um), FLOOR_U_UM)
        approach_bottom(self._run, floor_um, floor_u_um)
        self._engaged = True


def wear_of(profile: Profile) -> ToolWear:
    """Return the wear per energy by the recipe: as much tool per workpiece as in a hole."""
    work, wear = profile.work, profile.wear
    section_um2 = hole_area_um2(profile.tool.diameter_um, work.side_gap_um)
    per_uj = wear.expected_ratio / section_um2 * _removal_um3_per_uj(profile)
    return ToolWear(per_uj, math.hypot(wear.ratio_u_rel, work.removal_u_rel), TOUCH_U_UM)


def _removal_um3_per_uj(profile: Profile) -> float:
    return profile.work.removal_um3_per_uj * (1.0 - SIDE_DISCHARGE_SHARE)


class PassFollower(TelemetrySums):
    """Follows the tool along its way and its telemetry, and sends the lines ahead of it.

    `_limits_um` is the limit at each point of the way, `_unstable` why the pass should end.
    """

    def __init__(self, run: JobRun, plan: PassPlan, wear: ToolWear) -> None:
        super().__init__(run, run.machine.time_s)
        self._plan, self._wear = plan, wear
        self._sent, self._here_um = 0, 0.0
        self._slices = self._held_slices = 0
        self._trace: list[tuple[float, float]] = [(0.0, 0.0)]
        self._moved_s = math.inf
        self._depth_um = run.tally.depth_um
        self._estimates: dict[str, float] = {}
        self._unstable, self._shorted = "", False
        self._limits_um = np.full(len(plan.way.points), self._limit_um(0))

    @property
    def _wearing_uj(self) -> float:
        """Energy of this pass so far that wore the tool, µJ."""
        return wearing_uj(energy_of(self._run.profile.pulse, self))

    def run(self, left_s: float, time_limit: str) -> PassResult:
        """Follow the path once within `left_s`, set by `time_limit`; the tool is then held with the pulses off."""
        run, start_s = self._run, self._start_s
        run.watch.follow(self.on_telemetry)
        try:
            reference_v, limit_um = gap_reference_v(run.profile), self._limits_um[0]
            run.machine.start_scan(CutRequest(reference_v, limit_um, left_s + TIME_SLACK_S))
            ended, fault, message = self._watch(start_s + left_s, time_limit)
        finally:
            run.watch.follow(None)
        s_um, used_uj = np.array(self._trace).T
        return PassResult(
            limits_um=self._limits_um,
            used_uj=np.interp(self._plan.way.lengths_um, s_um, used_uj),
            time_s=ended.time_s - start_s,
            held_share=self._held_slices / self._slices if self._slices else 0.0,
            gap_ratio_mean=self.gap_ratio_mean,
            counts=self.counts,
            energy_j=self.energy_j,
            wearing_uj=self._wearing_uj,
            fault=fault,
            message=message,
        )

    def _watch(self, end_s: float, time_limit: str) -> tuple[MachineEvent, str, str]:
        """Return the event that ended the pass, the row of its fault and the reason."""
        machine = self._run.machine
        while True:
            ended = machine.watch_cut(SLICE_S)
            if ended is not None:
                return (
                    (ended, "", "") if ended.code is EventCode.PATH_DONE else (ended, "TIMEOUT", time_limit)
                )
            if self._unstable:
                return machine.stop_cut(), "STALL", self._unstable
            if machine.time_s - self._moved_s > STALLED_S:
                message = (
                    f"the stages stood still for {STALLED_S:.0f} s, {self._here_um:.0f} µm along the path"
                )
                return machine.stop_cut(), "STALL", message
            if machine.time_s >= end_s:
                return machine.stop_cut(), "TIMEOUT", time_limit
            try:
                self._feed()
            except PreconditionError:
                # A pass that has ended takes no lines: its end, or the fault behind it, is on its way.
                ended = machine.watch_cut(SLICE_S)
                if ended is None:
                    raise
                return ended, "TIMEOUT", time_limit

    def _feed(self) -> None:
        """Locate the tool, and send the lines that it will soon need until the queue is full."""
        plan, way, machine = self._plan, self._plan.way, self._run.machine
        status, before_um = machine.status(), self._here_um
        ahead_um = plan.speed_um_s * LOOK_AHEAD_S
        self._here_um = way.length_at(status.x_um, status.y_um, before_um, 2.0 * ahead_um)
        if self._here_um != before_um or self._shorted or math.isinf(self._moved_s):
            self._moved_s = machine.time_s
        below_um = self.displacement_um - float(np.interp(self._here_um, way.lengths_um, self._limits_um))
        if not math.isnan(below_um):
            self._depth_um = max(0.0, plan.held.depth_um + min(0.0, below_um))
        used_uj = plan.since_uj + self._wearing_uj
        self._estimates = {
            "time_left_s": plan.rest_s + (way.length_um - self._here_um) / plan.speed_um_s,
            "wear_um": self._wear.um(used_uj),
            "wear_u95_um": half_width(math.hypot(plan.wear_u_um, self._wear.u_um(used_uj))),
        }
        if self._sent:
            self._slices += 1
            self._held_slices += below_um >= -HELD_WITHIN_UM
            self._trace.append((self._here_um, self._wearing_uj))
        last = len(way.points) - 1
        while self._sent < last and way.lengths_um[self._sent] < self._here_um + ahead_um:
            i = self._sent + 1
            x_um, y_um = (float(c) for c in way.points[i])
            limit_um = self._limit_um(i)
            if not machine.path_move(ScanLine(x_um, y_um, plan.speed_um_s, limit_um, i == last)):
                return
            self._limits_um[i:] = limit_um
            self._sent = i

    def _limit_um(self, i: int) -> float:
        """Return the height at which the tool is to be held at point `i`."""
        plan, used_uj = self._plan, self._wearing_uj
        ahead_um = float(plan.way.lengths_um[i]) - self._here_um
        uj_per_um = (plan.uj_per_um * LEARN_OVER_UM + used_uj) / (LEARN_OVER_UM + self._here_um)
        x_um, y_um = plan.way.points[i]
        wear_um = self._wear.um(plan.since_uj + used_uj + ahead_um * uj_per_um)
        return plan.held.z_um((float(x_um), float(y_um)), wear_um)

    def on_telemetry(self, block: TelemetryBlock) -> None:
        seen = block.summary
        self.add(seen)
        ratios, step = self.ratios, f"pass {self._plan.number}" if self._plan.number else ""
        self._shorted = ratios.short > 0.5
        if seen.state == MachineState.MACHINING:
            self.add_gap_ratio(seen.gap_mean_v, seen.samples)
            self.displacement_um = seen.mean_um
        over = self._ratio_limits.update(seen.end_s, ratios, window_is_full=self.window_is_full)
        if over:
            self._unstable = f"{over} have stayed over their limit"
        estimates: dict[str, Any] = self._estimates
        self.report(seen, self._depth_um, self.displacement_um, ratios=ratios, step=step, **estimates)
