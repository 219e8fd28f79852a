"""Supervision of a running cut, slice by slice: pulse ratios, feed, estimated depth and wear, time left, limits.

The controller keeps the gap; the supervisor only watches, reports, and decides when a cut should end.
"""

from __future__ import annotations

import math
import operator
from collections import deque
from collections.abc import Sequence
from enum import StrEnum
from typing import Any

from edmctl.machine.interface import SLICE_S, MachineState, MachineStatus, TelemetryBlock, host_fault
from edmctl.planning.forecast import forecast
from edmctl.procedures.hole.cut_planning import (
    CutPlan,
    discharge_energy_j,
    energy_of,
    estimate_in_cut,
    with_unseen,
)
from edmctl.procedures.job import Counts, RunningCut, target_of
from edmctl.procedures.monitoring.watch import NEWEST_S
from edmctl.procedures.run import JobRun
from edmctl.procedures.servo.adaptive import AdaptiveControl, ShortRecovery
from edmctl.procedures.servo.limits import (
    RATIO_WINDOW_S,
    STALL_SHARE,
    Breakthrough,
    RatioLimits,
    SparkLoss,
    StallDetection,
    stroke_left_um,
)
from edmctl.procedures.settings import OPEN_LOST_S, gap_reference_v, telemetry_settings
from edmctl.process.live_erosion import Energy
from edmctl.record.rows import RunEvent, SlowRow
from edmctl.results.declared import shared
from edmctl.results.progress import Phase
from edmctl.results.telemetry import BlockSummary, PulseShares, pulse_shares


class TelemetrySums:
    """Sums over the slices of one cut or pass: pulses by class (open, normal, arc, short), energy of the discharges.

    `power_w` is their mean power in the newest slice, `duty_v` the mean voltage of an open gap, `displacement_um`
    the newest while sparking.
    """

    def __init__(self, run: JobRun, start_s: float) -> None:
        self._run, self._start_s = run, start_s
        self._machined_before_s = run.tally.machining_time_s
        self._ratio_limits = RatioLimits(run)
        self.displacement_um = math.nan
        run.tally.phase = Phase.MACHINING
        self.duty_v = run.profile.pulse.duty_voltage_v
        self._sample_s = 1e-6 * telemetry_settings(run.profile, run.setup).period_us
        self._window: deque[tuple[float, float, Counts]] = deque()
        self._window_counts = [0, 0, 0, 0]
        self._gap_ratio_sum, self._gap_samples = 0.0, 0
        self._newest_s = math.nan
        self.counts: Counts = (0, 0, 0, 0)
        self.energy_j = self.power_w = self.time_s = 0.0

    @property
    def ratios(self) -> PulseShares:
        """Shares over the last `RATIO_WINDOW_S`; of the oldest slice by the part that lies in it."""
        if not self._window:
            return pulse_shares(0, 0, 0, 0)
        end_s, duration_s, oldest = self._window[0]
        before_s = self._newest_s - RATIO_WINDOW_S - (end_s - duration_s)
        left_out = min(max(before_s / duration_s, 0.0), 1.0)
        counts = (count - left_out * old for count, old in zip(self._window_counts, oldest, strict=True))
        return pulse_shares(*counts)

    @property
    def window_is_full(self) -> bool:
        end_s, duration_s, _ = self._window[0]
        return self._newest_s - end_s + duration_s >= 0.9 * RATIO_WINDOW_S

    @property
    def gap_ratio_mean(self) -> float:
        """Mean of the normalised gap voltage while sparking; NaN before any sample."""
        return self._gap_ratio_sum / self._gap_samples if self._gap_samples else math.nan

    def duration_s(self, seen: BlockSummary) -> float:
        """Return the time that the samples of a slice cover."""
        return seen.samples * self._sample_s

    def add(self, seen: BlockSummary) -> Counts:
        """Add a slice; return its pulses."""
        self._newest_s, fresh = seen.end_s, seen.counts
        duration_s = self.duration_s(seen)
        pulse = self._run.profile.pulse
        if self.duty_v != pulse.duty_voltage_v:
            pulse = pulse.model_copy(update={"duty": self.duty_v / pulse.open_voltage_v})
        energy_j = discharge_energy_j(pulse, fresh, seen.current_mean_a * duration_s)
        self.energy_j += energy_j
        self.power_w = energy_j / duration_s
        self._window.append((self._newest_s, duration_s, fresh))
        opens, normals, arcs, shorts = map(operator.add, self.counts, fresh)
        self.counts = (opens, normals, arcs, shorts)
        for i, number in enumerate(fresh):
            self._window_counts[i] += number
        while self._window[0][0] <= self._newest_s - RATIO_WINDOW_S:
            for i, number in enumerate(self._window.popleft()[2]):
                self._window_counts[i] -= number
        return fresh

    def add_gap_ratio(self, gap_v: float, samples: int) -> None:
        """Add the mean gap voltage of samples while sparking."""
        self._gap_ratio_sum += gap_v / self.duty_v * samples
        self._gap_samples += samples

    def report(
        self,
        seen: BlockSummary,
        depth_um: float,
        sparked_um: float,
        status: MachineStatus | None = None,
        **values: Any,
    ) -> None:
        """Put the sums into the tally; record and report the progress, which `values` complete."""
        run, tally, duty_v = self._run, self._run.tally, self.duty_v
        self.time_s = max(0.0, seen.end_s - self._start_s)
        tally.depth_um, tally.machining_time_s = depth_um, self._machined_before_s + self.time_s
        tally.cut = RunningCut(self.counts, self.energy_j, self.time_s, sparked_um)
        here_um, gap_v = self.displacement_um, seen.gap_mean_v
        progress = run.progress(time_s=seen.end_s, gap_v=gap_v, displacement_um=here_um, **values)
        shares = progress.ratios
        run.recorder.append(
            SlowRow(
                **shared(SlowRow, progress),
                gap_ratio=progress.gap_v / duty_v,
                gap_ratio_ref=progress.reference_v / duty_v,
                ratio_open=shares.open,
                ratio_normal=shares.normal,
                ratio_arc=shares.arc,
                ratio_short=shares.short,
                power_w=self.power_w,
                dielectric_c=math.nan if status is None else status.temperature_c,
                flow_lpm=math.nan if status is None else status.flow_lpm,
                link_errors=run.watch.missing_frames,
            )
        )
        run.observer.progress(progress)


FEED_WINDOW_S = 10.0  # one jump period, 3 µm at 0.3 µm/s, twenty times the sensor's noise
OVERRUN_SHARE = 0.05  # a cut deeper than the target by this share has not ended where it should
LEAST_OVERRUN_UM = 3.0  # least allowance, for the servo's swing and the sensor's noise at a shallow target
TOUCH_RESERVE_UM = 5.0  # left for the touch of the bottom after the cut, a working gap further
NEAR_THE_END_UM = 60.0  # stroke by the mean gain below which the model computes the rest

SWING_UM = 0.5  # largest distance of a tool at the bottom from its deepest place: the servo's swing

# Looked up in every slice; an enum member costs a metaclass call each time in Python 3.11.
_MACHINING = int(MachineState.MACHINING)
_PHASE = {True: Phase.MACHINING, False: Phase.JUMPING}


class StopReason(StrEnum):
    """Why a cut should end."""

    STALLED = "the tool has stopped advancing"
    UNSTABLE = "arcs or shorts have stayed over their limit"
    ENDED = "the depth or the stroke is used up"


class Supervisor(TelemetrySums):
    """Follows the telemetry of one cut that begins at `start_s`; keeps its sums and the tally of the job.

    `stop_reason` is set when the cut should end, with the figures in `message`. The cut sets `jumps`, `last_jump_s`,
    `reference_v` (the mean gap voltage that the servo keeps) and `status` (with the dielectric).
    """

    def __init__(self, run: JobRun, plan: CutPlan, start_s: float) -> None:
        super().__init__(run, start_s)
        profile, self._plan = run.profile, plan
        self.reference_v = gap_reference_v(profile)
        self._forecast_feed_um_s = forecast(profile, run.setup).feed_rate_um_s
        self._track: deque[tuple[float, float]] = deque()
        self._begin: tuple[float, float] | None = None
        self.status: MachineStatus | None = None
        self._stall = StallDetection(self._forecast_feed_um_s)
        self._through = profile.target.kind == "through"
        self._completion_um = target_of(profile).completion_um
        self._spark_loss = SparkLoss(profile.limits.open_lost_um, OPEN_LOST_S)
        self.adaptive = AdaptiveControl(profile, start_s)
        self.shorts = ShortRecovery()
        self._newest = round(NEWEST_S / self._sample_s)
        self.breakthrough = Breakthrough(profile.work.thickness_um)
        self.sparking_s, self.jumps = 0.0, 0
        self.seen_s = self.last_jump_s = math.nan

        self._spark_um = plan.start.bottom_um - plan.start.gap_um
        self._deepest_um = -math.inf
        self._near_the_end = False
        self.stop_reason: StopReason | None = None
        self.message = ""

    @property
    def is_through(self) -> bool:
        return not math.isnan(self.breakthrough.at_um)

    @property
    def sparked_at_um(self) -> float:
        """Where the tool was at the bottom when it last sparked: not in a retreat, nor below a sheet."""
        if self.is_through:
            return self.breakthrough.at_um
        return max(self._spark_um, self._deepest_um - SWING_UM)

    @property
    def is_complete(self) -> bool:
        """Whether the sheet has broken through, and the tip has followed."""
        return self.displacement_um >= self.breakthrough.at_um + self._completion_um

    def slice_s(self, now_s: float) -> float:
        """Return for how long the cut needs no attention: short near the end of the stroke and in a sheet."""
        longest_s = self._run.machine.slice_s
        due_s = min(self.adaptive.clock_due_s, self._stall.due_s) - now_s
        if self._through or self._near_the_end:
            return SLICE_S
        return SLICE_S * max(1, math.ceil(due_s / SLICE_S - 1e-6)) if due_s < longest_s else longest_s

    def jump_due(self, now_s: float) -> tuple[RunEvent, str] | None:
        """Return which kind of jump is due, and why; None without a reason."""
        if reason := self.shorts.due():
            return RunEvent.SHORT_RECOVERY, reason
        if self._stall.jump_wanted:
            return RunEvent.STALL_JUMP, f"the tool has advanced only {self._stall.message}"
        if reason := self.adaptive.due(now_s):
            return RunEvent.JUMPED, reason
        return None

    def jumped(self, code: RunEvent, now_s: float) -> None:
        self._stall.jump_wanted = False
        if code is RunEvent.SHORT_RECOVERY:
            self.shorts.jumped()
        self.adaptive.jumped(now_s)

    def on_telemetry(self, block: TelemetryBlock) -> None:
        seen, heights_um, plan = block.summary, block.displacement_um.tolist(), self._plan
        now_s, machining = seen.end_s, seen.state == _MACHINING
        fresh, duration_s = self.add(seen), self.duration_s(seen)
        self._note_sparks(block, heights_um)
        if machining:
            self.add_gap_ratio(seen.gap_mean_v, len(heights_um))
            newest_um = heights_um[-self._newest :]
            self.displacement_um, self.seen_s = sum(newest_um) / len(newest_um), now_s
            self._track.append((now_s, self.displacement_um))
            self._begin = self._begin or self._track[0]
            if self._stall.update(now_s, self.displacement_um):
                self.stop_reason, self.message = StopReason.STALLED, self._stall.message
        ratios = self.ratios
        if self._ratio_limits.update(now_s, ratios, window_is_full=self.window_is_full):
            self.stop_reason = StopReason.UNSTABLE
        energy = energy_of(self._run.profile.pulse, self)
        erosion = plan.at(self.sparked_at_um, energy, now_s)
        self.sparking_s += duration_s if machining else 0.0
        _, _, arcs, shorts = fresh
        self.adaptive.update(duration_s, sum(fresh), arcs, shorts, sparking=machining)
        self.shorts.update(duration_s, sum(fresh), shorts, sparking=machining)
        if self._through:
            self._look_for_the_back(duration_s, fresh, energy, now_s, sparking=machining)
        depth, wear = plan.stated(erosion)
        self.report(
            seen,
            math.nan if self.is_through else depth.value,
            self.sparked_at_um,
            self.status,
            phase=_PHASE[machining],
            reference_v=self.reference_v,
            ratios=ratios,
            depth_target_um=plan.target_um,
            time_left_s=self._time_left_s(now_s, depth.value),
            depth_u95_um=depth.u95,
            step=f"cut {plan.number}",
            feed_um=depth.value + wear.value,
            feed_target_um=plan.feed_um if math.isnan(plan.target_um) else math.nan,
            feed_um_s=self._feed_um_s(now_s),
            wear_um=wear.value,
            wear_u95_um=wear.u95,
            jumps=self.jumps,
            jump_period_s=self.adaptive.period_s,
            last_jump_s=self.last_jump_s,
        )
        if machining:
            self._look_for_the_end(float(block.actuator_v[-1]), depth.value)

    def _note_sparks(self, block: TelemetryBlock, heights_um: list[float]) -> None:
        """Find where the tool sparked last; if the host was delayed, the cut may have ended within the block."""
        states, normals = block.state.tolist(), block.n_normal.tolist()
        sparked: Sequence[int] = range(len(states))
        if 0 in normals or states.count(_MACHINING) < len(states):
            arcs = block.n_arc.tolist()
            sparked = [i for i in sparked if states[i] == _MACHINING and normals[i] + arcs[i]]
            if not sparked:
                return
        times_s = block.time_s.tolist()
        since_s = times_s[sparked[-1]] - NEWEST_S
        newest_um = [heights_um[i] for i in sparked if times_s[i] > since_s]
        self._spark_um = sum(newest_um) / len(newest_um)
        self._deepest_um = max(self._deepest_um, self._spark_um)

    def _look_for_the_back(
        self, duration_s: float, fresh: Counts, energy: Energy, now_s: float, *, sparking: bool
    ) -> None:
        """Check whether the sheet has broken through; sparks that are lost elsewhere are a fault."""
        opens, pulses = fresh[0], sum(fresh)
        if pulses == 0:
            return
        plan, back, here_um = self._plan, self.breakthrough, self.displacement_um
        # Before the first hole was measured the recipe alone divides the feed.
        estimate = estimate_in_cut(plan, self.sparked_at_um, energy, now_s)
        estimate = with_unseen(estimate, 0.0, plan.estimate.wear_ratio, is_confirmed=plan.estimate.fits > 0)
        depth = estimate.depth
        is_through = back.update(duration_s, here_um, depth, opens / pulses, sparking=sparking)
        if sparking and not self.is_through:
            lost = self._spark_loss.update(duration_s, here_um, pulses, opens)
            is_through = bool(lost) and back.on_spark_loss(self._spark_loss.spark_um, depth, lost)
            if lost and not is_through:
                raise host_fault("NO_SPARK", f" ({lost})")
        if is_through:
            args = {"displacement_um": back.at_um, "depth_um": depth.value, "feed_um_s": back.feed_um_s}
            self._run.decide(RunEvent.BREAKTHROUGH, back.message, args)

    def _feed_um_s(self, now_s: float) -> float:
        track = self._track
        begin_s = now_s - FEED_WINDOW_S
        while len(track) > 1 and track[1][0] <= begin_s:
            track.popleft()
        if not track or track[0][0] > begin_s:
            return math.nan  # the way to the equilibrium gap is no feed
        (first_s, first_um), (last_s, last_um) = track[0], track[-1]
        return (last_um - first_um) / (last_s - first_s)

    def _time_left_s(self, now_s: float, depth_um: float) -> float:
        """Return the machining time to the target at the mean feed of this cut, first at the forecast feed."""
        feed_um_s = self._forecast_feed_um_s
        if self._begin is not None and now_s - self._begin[0] > FEED_WINDOW_S:
            feed_um_s = (self.displacement_um - self._begin[1]) / (now_s - self._begin[0])
        if not feed_um_s > STALL_SHARE * self._forecast_feed_um_s:
            return math.nan
        left_um = self._plan.z_limit_um - self.displacement_um
        if self.is_through:
            left_um = self.breakthrough.at_um + self._completion_um - self.displacement_um
        elif not math.isnan(self._plan.target_um):
            whole = 1.0 + self._plan.estimate.wear_ratio
            left_um = (self._plan.target_um - depth_um) * whole + self._completion_um
        return max(0.0, left_um) / feed_um_s

    def _look_for_the_end(self, actuator_v: float, depth_um: float) -> None:
        """Check whether the cut is past its target, or the actuator at the end of its stroke."""
        what, done_um, wanted_um = "depth", depth_um, self._plan.target_um
        if self._through or math.isnan(wanted_um):
            what, done_um = "feed", self._plan.fed_um(self.displacement_um)
            wanted_um = self._plan.feed_um
        message, limit_v = "", self._run.profile.limits.stroke_v_max
        rest_um = self._run.setup.actuator.gain_um_per_v * (limit_v - actuator_v)
        if done_um > wanted_um + max(LEAST_OVERRUN_UM, OVERRUN_SHARE * wanted_um):
            message = f"the estimated {what} is {done_um:.1f} of {wanted_um:.1f} µm"
        elif rest_um <= NEAR_THE_END_UM and (estimator := self._run.watch.estimator()) is not None:
            left_um = stroke_left_um(estimator, limit_v)
            self._near_the_end = left_um < 2.0 * TOUCH_RESERVE_UM
            if left_um < TOUCH_RESERVE_UM:
                message = f"{left_um:.1f} µm of stroke are left at {actuator_v:.1f} of {limit_v:.0f} V"
        if message and self.stop_reason is None:
            self.stop_reason, self.message = StopReason.ENDED, message
