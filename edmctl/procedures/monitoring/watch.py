"""Listens to the machine for a whole run: estimates, records, and keeps recent values for the procedures."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from edmctl.actuator.model import Estimator
from edmctl.array_types import Array
from edmctl.machine.interface import (
    EventCode,
    MachineEvent,
    MachineListener,
    MachineState,
    PulseBlockBatch,
    PulseTrain,
    TelemetryBlock,
    TelemetryFlag,
    joined,
)
from edmctl.procedures.displacement_estimate import FeedError, Trace, Tracker
from edmctl.procedures.monitoring.drift import Rests
from edmctl.process.rest_drift import CreepLags, CreepLeft, Rest
from edmctl.record.rows import EventLevel, EventRow, Recorder, RunEvent, ServoBlock

_GATHERED_S = 0.45  # blocks are estimated and recorded together up to this duration

NEWEST_S = 0.1 - 1e-6  # the place of the tool is the mean of a frame; a delayed host gets seconds of samples

_DIRECTION = np.zeros((256, 256), dtype=np.int8)
"""Direction of the tool by (state, flags): -1 back, 0 hold, 1 forward."""
_DIRECTION[MachineState.APPROACH] = 1
_DIRECTION[MachineState.MACHINING] = np.where(np.arange(256) & TelemetryFlag.ADVANCING, 1, -1)


class Watch(MachineListener):
    """Passes each sample to the estimator, the recorder, and a follower if any.

    Gap ratios refer to `duty_voltage_v`, the mean voltage of an open gap. One of `record_every` samples is recorded.
    Without `sensor` the displacements are estimates already. `latest` are the newest samples, None before the first.
    """

    def __init__(
        self, recorder: Recorder, duty_voltage_v: float, record_every: int = 1, *, sensor: bool = True
    ) -> None:
        self._recorder = recorder
        self._duty_voltage_v = duty_voltage_v
        self._every, self._skip = record_every, 0
        self._sensor = sensor
        self._tracker: Tracker | None = None
        self._fresh: list[TelemetryBlock] = []
        self.latest: TelemetryBlock | None = None
        self._trace = Trace()
        self._follower: Callable[[TelemetryBlock], None] | None = None
        self._guards: list[Callable[[TelemetryBlock], None]] = []
        self._comparer: Callable[[TelemetryBlock, Array], None] | None = None
        self.missing_frames = 0
        self.feed_error = FeedError()
        self.rests = Rests()
        self._lags: CreepLags | None = None
        self.last_rest: Rest | None = None

    def follow_creep(self, left: CreepLeft | None) -> None:
        """Follow the lags of the displacement from home on; `left` is the residual creep, None if unused."""
        if self._sensor:
            self._lags = CreepLags(left)

    def creep_left(self) -> CreepLeft | None:
        """Return the residual creep; None if it was not followed."""
        self.settle()
        return None if self._lags is None else self._lags.left

    def estimate_with(self, tracker: Tracker) -> None:
        """Estimate the displacement from now on; the tracker includes the samples so far."""
        self.settle()
        self._tracker = tracker

    def tracker(self) -> Tracker | None:
        """Return the tracker in the state of the newest sample; None without one."""
        self.settle()
        return self._tracker

    def rest(self) -> None:
        """Set the zero of the estimate by the sensor: the tool rests at 0 V, and begins to work from here."""
        zero_um, tracker, block = self.zero_um(), self._tracker, self.latest
        if self._lags is not None and block is not None:
            self.settle()
            self.last_rest = Rest(*_now(block), _now_u_um(block), self._lags.um, self._lags.out_s)
        if math.isnan(zero_um) or tracker is None or block is None:
            return
        middle_s, measured_um = _now(block)
        self.rests.note(middle_s, zero_um)
        tracker.rest(middle_s, self._trace.at(middle_s), measured_um)

    def zero_um(self) -> float:
        """Return the sensor reading at this rest at 0 V less the actuator's own displacement, or NaN."""
        tracker, block = self.tracker(), self.latest
        if not self._sensor or tracker is None or block is None:
            return math.nan
        middle_s, measured_um = _now(block)
        return tracker.zero_um(self._trace.at(middle_s), measured_um)

    def estimator(self) -> Estimator | None:
        """Return the estimator in the state of the newest sample; None without one."""
        tracker = self.tracker()
        return None if tracker is None else tracker.estimator

    def follow(self, follower: Callable[[TelemetryBlock], None] | None) -> None:
        """Also pass every block to `follower`; None ends that."""
        self._follower = follower

    def set_duty_voltage(self, duty_voltage_v: float) -> None:
        """Set the mean voltage of the open gap that gap ratios refer to."""
        if duty_voltage_v != self._duty_voltage_v:
            self.settle()
            self._duty_voltage_v = duty_voltage_v

    def guard(self, guard: Callable[[TelemetryBlock], None]) -> None:
        """Also pass every block of the run to `guard`, which may raise to end it."""
        self._guards.append(guard)

    def compare(self, comparer: Callable[[TelemetryBlock, Array], None]) -> None:
        """Also pass samples of the sensor with their estimates to `comparer`, which may raise."""
        self._comparer = comparer

    @property
    def newest_s(self) -> float:
        """Time of the newest sample; minus infinity before the first."""
        block = self.latest
        return -math.inf if block is None else float(block.time_s[-1])

    @property
    def displacement_um(self) -> float:
        """Mean sensor displacement over the newest `NEWEST_S`; NaN before the first sample."""
        block = self.latest
        return math.nan if block is None else _now(block)[1]

    @property
    def actuator_v(self) -> float:
        """Newest actuator voltage; NaN before the first block."""
        block = self.latest
        return math.nan if block is None else float(block.actuator_v[-1])

    @property
    def in_contact(self) -> bool:
        """Whether the contact sensor read closed at the newest sample."""
        block = self.latest
        return block is not None and bool(block.flags[-1] & TelemetryFlag.CONTACT)

    def model_at(self, time_s: float) -> float:
        """Return the estimated displacement at a touch, or in the last seconds; NaN without an estimator."""
        self.settle()
        return self._trace.at(time_s)

    def telemetry(self, block: TelemetryBlock) -> None:
        """Keep the block for the estimator and the recorder, and pass it on."""
        self.latest = block
        self._fresh.append(block)
        self.missing_frames += block.missing_frames
        if self._sensor:
            self.rests.reach(block.summary.low_um, block.summary.high_um)
        if block.time_s[-1] - self._fresh[0].time_s[0] >= _GATHERED_S:
            self.settle()
        if self._follower is not None:
            self._follower(block)
        for guard in self._guards:
            guard(block)

    def settle(self) -> None:
        """Estimate and record the blocks since the last time."""
        if not self._fresh:
            return
        block = joined(self._fresh)
        self._fresh.clear()
        compared = self._sensor and self._tracker is not None
        if self._lags is not None:
            self._lags.advance(block.time_s, block.displacement_um, block.actuator_v)
        if not self._sensor:
            model_um = block.displacement_um
        elif self._tracker is None:
            model_um = np.full(len(block.time_s), math.nan)
        else:
            model_um = self._tracker.estimator.advance(block.time_s, block.actuator_v)
            self.feed_error.update(block, model_um)
        self._trace.append(block.time_s, model_um)
        self._record(block, model_um)
        if compared and self._comparer is not None:
            self._comparer(block, model_um)

    def _record(self, block: TelemetryBlock, model_um: Array) -> None:
        """Record each `record_every`-th sample of the run; a block may have none."""
        pick = slice(self._skip, None, self._every)
        self._skip = (self._skip - len(block.time_s)) % self._every
        if not len(block.time_s[pick]):
            return
        sensor_um = block.displacement_um if self._sensor else np.full_like(model_um, math.nan)
        self._recorder.append(
            ServoBlock(
                time_s=block.time_s[pick],
                actuator_v=block.actuator_v[pick],
                displacement_um=sensor_um[pick],
                model_um=model_um[pick],
                gap_v=block.gap_v[pick],
                gap_ratio=block.gap_v[pick] / self._duty_voltage_v,
                current_a=block.current_a[pick],
                direction=_DIRECTION[block.state[pick], block.flags[pick]],
                state=block.state[pick],
            )
        )

    def pulse_blocks(self, batch: PulseBlockBatch | PulseTrain) -> None:
        self._recorder.append(batch)

    pulses = pulse_blocks

    def event(self, event: MachineEvent) -> None:
        """Record; the estimate at a touch is kept, because its reading is requested much later."""
        if event.code is EventCode.TOUCH:
            self.settle()
            self._trace.keep(event.time_s)
        places = {"displacement_um": event.displacement_um, "actuator_v": event.actuator_v}
        args = {"argument": event.argument, **places}
        self._recorder.append(EventRow(event.time_s, event.code, EventLevel.DEBUG, event.code.name, args))

    def log(self, level: int, text: str) -> None:
        """Record a line of the controller's own log."""
        weight = EventLevel(min(max(level, EventLevel.DEBUG), EventLevel.ERROR))
        time_s = max(0.0, self.newest_s)
        self._recorder.append(EventRow(time_s, RunEvent.CONTROLLER_LOG, weight, text))


def _now(block: TelemetryBlock) -> tuple[float, float]:
    """Return the mean time and displacement over the last `NEWEST_S` of a block."""
    newest = block.time_s > block.time_s[-1] - NEWEST_S
    return float(block.time_s[newest].mean()), float(block.displacement_um[newest].mean())


def _now_u_um(block: TelemetryBlock) -> float:
    """Return the standard uncertainty of that displacement, by neighbouring samples as a tool may creep."""
    newest = int(np.count_nonzero(block.time_s > block.time_s[-1] - NEWEST_S))
    steps_um = np.diff(block.displacement_um)
    return math.sqrt(float(np.mean(steps_um**2)) / (2.0 * newest)) if len(steps_um) else 0.0
