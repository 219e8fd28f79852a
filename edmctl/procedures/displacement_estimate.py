"""The displacement by the actuator model: estimator and slow correction of a run, and a machine without a sensor.

The estimator learns from the sensor during the conditioning swings (`home`), at every rest at 0 V (zero only), and
from the touches of a finished hole. Without a sensor the controller reports the mean gain times the voltage, and
samples, events and touches get the estimate at their time. Heights that a motion must not pass are sent as the
voltage of the exact inverse, with a margin; the end of a cut is watched by the host, because creep changes its
voltage.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import replace
from typing import Any, cast

import numpy as np

from edmctl.actuator.correction import SlowCorrection
from edmctl.actuator.inverse import travel_by
from edmctl.actuator.model import ActuatorModel, ActuatorState, Estimator
from edmctl.actuator.record import Record
from edmctl.actuator.validation import ErrorFigures
from edmctl.array_types import Array
from edmctl.machine.interface import (
    SLICE_S,
    CutRequest,
    EventCode,
    Machine,
    MachineEvent,
    MachineListener,
    MachineState,
    MachineStatus,
    ScanLine,
    TelemetryBlock,
    TelemetrySettings,
    Touch,
    TouchRequest,
    joined,
)
from edmctl.procedures.job import CalibratedActuator

HOME_READINGS = 32  # number of pieces in which the swings are compared
PIECES_ALIKE = 4  # neighbouring pieces that share one error of the model, which changes slowly along a swing
RECORD_SHARE = 0.2  # a record shows creep with time constants up to this share of its length
CALIBRATION_S = 390.0  # length of the record of `edmctl calibrate`
CREEP_U_REL = 0.08  # of extrapolated creep: Muralidhara et al. 2009, figs. 3 and 4, within 5 to 10 %
CREEPING_U_UM = 0.25  # of a length: thresholds of the play from 0 to 5 % of the span differ by this [assumed]
LEAST_SD_UM = 0.05  # least standard deviation of a model: repeatability of the sensor
SPAN_S = 15.0  # longest time back: a touch is reported at the end of its dwell, which is 10 s at most
SMOOTHED_S = 0.1  # averaging time: 0.15 µm of sensor noise a sample becomes 0.05 µm at 100 Hz
_GATHERED_BLOCKS = 20  # blocks reduced together: ten seconds of them


class Tracker:
    """An estimator with gain and zero learned at trusted events.

    sd_um : how well the model follows the sensor, rms
    record_s : length of the record that the model was identified from
    """

    def __init__(
        self, estimator: Estimator, correction: SlowCorrection, sd_um: float, record_s: float = CALIBRATION_S
    ) -> None:
        self.estimator = estimator
        self._slow_s = RECORD_SHARE * record_s
        self._creep_at_rest_um = 0.0
        self.correction = correction
        self.sd_um = max(sd_um, LEAST_SD_UM)
        self._noted: list[tuple[float, float]] = []

    def rest(self, time_s: float, estimated_um: float, measured_um: float) -> None:
        """Set the zero where the tool rests at 0 V."""
        self.correction.observe(time_s, self._raw_um(estimated_um), measured_um, self.sd_um, keep_gain=True)
        self.estimator.correct(self.correction.gain, self.correction.offset_um)
        self._creep_at_rest_um = self.estimator.creep_um(self._slow_s)

    def creep_um(self) -> float:
        """Return the extrapolated creep since the last rest, µm."""
        return self.estimator.creep_um(self._slow_s) - self._creep_at_rest_um

    def length_u_um(self, creep_um: float) -> float:
        """Return the standard uncertainty of a length by the model that includes extrapolated creep `creep_um`."""
        return math.hypot(math.sqrt(2.0) * self.sd_um, CREEPING_U_UM, CREEP_U_REL * creep_um)

    def zero_um(self, estimated_um: float, measured_um: float) -> float:
        """Return the sensor reading at a rest less the actuator's own displacement."""
        return measured_um - self.correction.gain * self._raw_um(estimated_um)

    def note(self, estimated_um: float, measured_um: float) -> None:
        """Keep a reading of the hole under way until it is finished."""
        self._noted.append((self._raw_um(estimated_um), measured_um))

    def learn_noted(self) -> None:
        for y_um, measured_um in self._noted:
            self.correction.observe(self.correction.time_s, y_um, measured_um, self.sd_um)
        self._noted.clear()
        self.estimator.correct(self.correction.gain, self.correction.offset_um)

    def learn(self, readings: Iterable[tuple[float, float, float]], alike: int = 1) -> None:
        """Correct by (s, estimated µm, measured µm), in order of time; `alike` neighbours share one error."""
        for time_s, estimated_um, measured_um in readings:
            self.correction.observe(time_s, self._raw_um(estimated_um), measured_um, self.sd_um * alike**0.5)
        self.estimator.correct(self.correction.gain, self.correction.offset_um)

    def _raw_um(self, estimated_um: float) -> float:
        return (estimated_um - self.estimator.offset_um) / self.estimator.gain


def at_rest(model: ActuatorModel, time_s: float, u_v: float = 0.0) -> Estimator:
    """Return an estimator of a conditioned actuator that has long been at rest at `u_v`."""
    state = ActuatorState.conditioned(model, u_v)
    state.t_s = time_s
    return Estimator(model, state)


def home(
    model: ActuatorModel, record: Record, sd_um: float, record_s: float = CALIBRATION_S
) -> tuple[Tracker, ErrorFigures]:
    """Follow the conditioning swings from rest, and learn gain and zero; return the errors on them after that.

    The model was identified from `record_s` of samples, with errors of `sd_um` rms. The part before the first
    maximum is left out: it depends on an unknown history.
    """
    start_s = float(record.t_s[0])
    estimator = at_rest(model, start_s, float(record.u_v[0]))
    y_um = estimator.advance(record.t_s, record.u_v)
    first = int(np.argmax(record.u_v >= record.u_v.max() - 0.01 * np.ptp(record.u_v)))
    tracker = Tracker(estimator, SlowCorrection(start_s), sd_um, record_s)
    pieces = np.array_split(np.arange(first, len(y_um)), min(HOME_READINGS, len(y_um) - first))
    readings = [
        (float(record.t_s[part[-1]]), float(y_um[part].mean()), float(record.y_um[part].mean()))
        for part in pieces
    ]
    tracker.learn(readings, alike=PIECES_ALIKE)
    left_um = (estimator.gain * y_um + estimator.offset_um - record.y_um)[first:]
    return tracker, ErrorFigures.over(left_um, float(np.ptp(record.y_um)))


class Trace:
    """Displacements over the last `SPAN_S`, in blocks."""

    def __init__(self) -> None:
        self._blocks: deque[tuple[Array, Array]] = deque()
        self._kept: dict[float, float] = {}

    def append(self, time_s: Array, displacement_um: Array) -> None:
        """Take consecutive samples, shape (n,) each, n > 0."""
        self._blocks.append((time_s, displacement_um))
        while self._blocks[0][0][-1] < time_s[-1] - SPAN_S:
            self._blocks.popleft()

    def keep(self, time_s: float) -> None:
        """Keep the displacement at a moment: the reading of a touch is requested much later."""
        self._kept[time_s] = self.at(time_s)

    def at(self, time_s: float) -> float:
        """Return the displacement at a moment, interpolated, of the nearest end outside the span; NaN if empty."""
        if time_s in self._kept:
            return self._kept[time_s]
        if not self._blocks:
            return float("nan")
        times_s = np.concatenate([block_s for block_s, _ in self._blocks])
        values_um = np.concatenate([block_um for _, block_um in self._blocks])
        return float(np.interp(time_s, times_s, values_um))


class FeedError:
    """Errors of the estimate in one hole, averaged over `SMOOTHED_S`, while all samples are machining."""

    def __init__(self) -> None:
        self._fresh: list[tuple[TelemetryBlock, Array]] = []
        self._max_um, self._squares, self._count = math.nan, 0.0, 0

    def figures_um(self) -> tuple[float, float]:
        """Return the largest error and the root mean square, µm; NaN before any."""
        self._reduce()
        return self._max_um, math.sqrt(self._squares / self._count) if self._count else math.nan

    def update(self, block: TelemetryBlock, model_um: Array) -> None:
        """Take consecutive samples with what was estimated for them, shape (n,)."""
        self._fresh.append((block, model_um))
        if len(self._fresh) >= _GATHERED_BLOCKS:
            self._reduce()

    def _reduce(self) -> None:
        if not self._fresh:
            return
        block = joined([block for block, _ in self._fresh])
        error_um = np.concatenate([model_um for _, model_um in self._fresh]) - block.displacement_um
        self._fresh.clear()
        span_s = float(block.time_s[-1] - block.time_s[0])
        size = max(1, round(SMOOTHED_S * (len(error_um) - 1) / span_s)) if span_s > 0.0 else 1
        rows = len(error_um) // size
        machining = (block.state == MachineState.MACHINING)[: rows * size]
        whole = machining.reshape(rows, size).all(axis=1)
        means_um = error_um[: rows * size].reshape(rows, size)[whole].mean(axis=1)
        if len(means_um):
            self._max_um = float(np.fmax(self._max_um, np.abs(means_um).max()))
            self._squares += float(means_um @ means_um)
            self._count += len(means_um)


MARGIN_SHARE = 0.03  # error of the inverse, relative: 2.5 % of gain between days, and the model's own
MARGIN_UM = 2.0  # the same, at least
SHORT, AT, BEYOND = -1.0, 0.0, 1.0


class SensorlessMachine:
    """A `Machine` with the displacements of its calibrated actuator; what is not defined here is of the real one.

    It is the listener of the real one, which is configured with `sensor_fitted` 0 and a mean `gain_um_per_v`; the
    actuator must be at rest after full swings when telemetry starts.
    """

    slice_s = SLICE_S
    """The limit of a cut is checked in every slice, so they are short."""

    def __init__(self, machine: Machine, calibration: CalibratedActuator, gain_um_per_v: float) -> None:
        self._machine, self._gain_um_per_v = machine, gain_um_per_v
        estimator = at_rest(calibration.model, 0.0)
        # Displacements count from the actuator at rest, as with a sensor; `at_rest` is there already.
        estimator.correct(1.0, -estimator.tick(estimator.state.u_v, 0.0))
        self.tracker = Tracker(estimator, SlowCorrection(), calibration.held_out_rms_um)
        self._listener: MachineListener | None = None
        self._trace, self._started = Trace(), False
        self._newest_um = self._cutting_um = 0.0
        self._z_limit_um = 0.0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._machine, name)

    def start_telemetry(self, settings: TelemetrySettings, listener: MachineListener) -> None:
        """Begin to send samples, with estimates, to `listener`."""
        self._listener = listener
        self.pulse_blocks, self.pulses, self.log = listener.pulse_blocks, listener.pulses, listener.log
        self._machine.start_telemetry(settings, cast("MachineListener", self))

    def telemetry(self, block: TelemetryBlock) -> None:
        """Estimate the displacements of a block, and pass it on."""
        estimator = self.tracker.estimator
        if not self._started:
            estimator.state.t_s = float(block.time_s[0])
            self._started = True
        estimate_um = estimator.advance(block.time_s, block.actuator_v)
        self._trace.append(block.time_s, estimate_um)
        self._newest_um = float(estimate_um[-1])
        cutting_um = estimate_um[block.state == MachineState.MACHINING]
        if len(cutting_um):
            self._cutting_um = float(cutting_um.mean())
        if self._listener is not None:
            self._listener.telemetry(replace(block, displacement_um=estimate_um))

    def event(self, event: MachineEvent) -> None:
        """Pass on with the estimate; that of a touch is kept, because its reading is requested much later."""
        if event.code is EventCode.TOUCH:
            self._trace.keep(event.time_s)
        if self._listener is not None:
            self._listener.event(self._translated(event))

    def _translated(self, event: MachineEvent) -> MachineEvent:
        return replace(event, displacement_um=self._trace.at(event.time_s))

    def status(self) -> MachineStatus:
        """Request the state of the controller; the displacement is the newest estimate."""
        return replace(self._machine.status(), displacement_um=self._newest_um)

    def set_zero(self, zero_um: float) -> None:
        """Leave the controller's zero alone: its displacements are volts, which are 0 at rest and do not drift."""

    def approach(self, speed_um_s: float, max_travel_um: float, gap_reference_v: float) -> MachineEvent:
        """Advance with pulses until the mean gap voltage falls to the reference."""
        here_v = self.tracker.estimator.state.u_v
        target_um = self._newest_um + max_travel_um
        travel_um = self._sent_um(target_um, BEYOND, speed_um_s) - self._gain_um_per_v * here_v
        return self._translated(self._machine.approach(speed_um_s, travel_um, gap_reference_v))

    def touch(self, request: TouchRequest) -> tuple[Touch, ...]:
        """Find the surface by contact; each touch is the estimate at first contact."""
        sent = replace(
            request,
            fast_to_um=self._sent_um(request.fast_to_um, SHORT, request.fast_um_s),
            z_max_um=self._sent_um(request.z_max_um, BEYOND, request.fast_um_s),
        )
        touches = self._machine.touch(sent)
        return tuple(replace(touch, displacement_um=self._trace.at(touch.time_s)) for touch in touches)

    def start_cut(self, request: CutRequest) -> None:
        """Start the gap servo; `watch_cut` checks the limit."""
        self._z_limit_um, self._cutting_um = request.z_limit_um, self._newest_um
        sent_um = self._sent_um(request.z_limit_um, BEYOND, math.inf)
        self._machine.start_cut(replace(request, z_limit_um=sent_um))

    def start_scan(self, request: CutRequest) -> None:
        """Start the gap servo with the tool held at the voltage that the inverse gives for the limit."""
        self._z_limit_um = math.inf
        self._machine.start_scan(replace(request, z_limit_um=self._sent_um(request.z_limit_um, AT)))

    def path_move(self, line: ScanLine) -> bool:
        """Append a line; its limit becomes the voltage that the inverse gives now, so send it not long before."""
        return self._machine.path_move(replace(line, z_limit_um=self._sent_um(line.z_limit_um, AT)))

    def watch_cut(self, duration_s: float) -> MachineEvent | None:
        """Let at most `duration_s` of a cut pass, and end it when the estimate has reached its limit."""
        event = self._machine.watch_cut(duration_s)
        if event is not None:
            return self._translated(event)
        if self._cutting_um < self._z_limit_um:
            return None
        return replace(self.stop_cut(), code=EventCode.CUT_DONE)

    def stop_cut(self) -> MachineEvent:
        """End a cut: pulses off, tool held."""
        return self._translated(self._machine.stop_cut())

    def _sent_um(self, target_um: float, side: float, speed_um_s: float = math.inf) -> float:
        """Return the displacement to send so that a feed from here ends at `target_um`, short of it or beyond it."""
        way_um = target_um - self._newest_um
        way_um += side * (MARGIN_UM + MARGIN_SHARE * abs(way_um))
        return self._gain_um_per_v * travel_by(self.tracker.estimator, way_um, speed_um_s)
