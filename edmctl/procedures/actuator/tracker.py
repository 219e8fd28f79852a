"""The estimator of a run and its slow correction.

It learns from the sensor during the conditioning swings (`home`), at every rest at 0 V before the tool works (zero
only), and from the touches of a finished hole. Between rests its displacements do not depend on the sensor.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable

import numpy as np

from edmctl.actuator.correction import SlowCorrection
from edmctl.actuator.model import ActuatorModel, ActuatorState, Estimator
from edmctl.actuator.record import Record
from edmctl.actuator.validation import ErrorFigures
from edmctl.array_types import Array
from edmctl.machine.interface import MachineState
from edmctl.results.telemetry import TelemetryBlock

HOME_READINGS = 32
"""Number of pieces in which the swings are compared."""
PIECES_ALIKE = 4
"""Number of neighbouring pieces that share one error of the model, which changes slowly along a swing."""
RECORD_SHARE = 0.2
"""A record shows creep with time constants up to this share of its length; slower creep is extrapolated."""
CALIBRATION_S = 390.0
"""Length of the record of `edmctl calibrate`."""
CREEP_U_REL = 0.08
"""Standard uncertainty of extrapolated creep, relative: one rate per decade explains the steps and sines of
Muralidhara et al. 2009 (figs. 3 and 4) within 5 to 10 % [assumed]."""
CREEPING_U_UM = 0.25
"""Standard uncertainty of a length because the creeping play operators are unknown: thresholds from 0 to 5 % of the
span differ by this [assumed]."""
LEAST_SD_UM = 0.05
"""Least standard deviation of a model: repeatability of the sensor."""
SPAN_S = 15.0
"""Longest time back: a touch is reported at the end of its dwell, which is 10 s at most."""
SMOOTHED_S = 0.1
"""Averaging time: 0.15 µm of sensor noise a sample becomes 0.05 µm at 100 Hz."""
_GATHERED_BLOCKS = 20
"""Blocks reduced together: ten seconds of them."""


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
        """Correct by the readings of the finished hole."""
        for y_um, measured_um in self._noted:
            self.correction.observe(self.correction.time_s, y_um, measured_um, self.sd_um)
        self._noted.clear()
        self.estimator.correct(self.correction.gain, self.correction.offset_um)

    def learn(self, readings: Iterable[tuple[float, float, float]], alike: int = 1) -> None:
        """Correct by (s, estimated µm, measured µm), in order of time and estimated as the tracker is now.

        `alike` neighbouring readings share one error and count as one.
        """
        sd_um = self.sd_um * alike**0.5
        for time_s, estimated_um, measured_um in readings:
            self.correction.observe(time_s, self._raw_um(estimated_um), measured_um, sd_um)
        self.estimator.correct(self.correction.gain, self.correction.offset_um)

    def _raw_um(self, estimated_um: float) -> float:
        """Return the estimate before correction."""
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
    return tracker, ErrorFigures.of(left_um, record.y_um)


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
        self._max_um = math.nan
        self._squares = 0.0
        self._count = 0

    @property
    def max_um(self) -> float:
        """Largest error, µm; NaN before any."""
        self._reduce()
        return self._max_um

    @property
    def rms_um(self) -> float:
        """Root mean square, µm; NaN before any."""
        self._reduce()
        return math.sqrt(self._squares / self._count) if self._count else math.nan

    def update(self, block: TelemetryBlock, model_um: Array) -> None:
        """Take consecutive samples with what was estimated for them, shape (n,)."""
        self._fresh.append((block, model_um))
        if len(self._fresh) >= _GATHERED_BLOCKS:
            self._reduce()

    def _reduce(self) -> None:
        if not self._fresh:
            return
        blocks = [block for block, _ in self._fresh]
        machining = np.concatenate([block.state for block in blocks]) == MachineState.MACHINING
        sensor_um = np.concatenate([block.displacement_um for block in blocks])
        error_um = np.concatenate([model_um for _, model_um in self._fresh]) - sensor_um
        span_s = float(blocks[-1].time_s[-1] - blocks[0].time_s[0])
        self._fresh.clear()
        size = max(1, round(SMOOTHED_S * (len(error_um) - 1) / span_s)) if span_s > 0.0 else 1
        rows = len(error_um) // size
        whole = machining[: rows * size].reshape(rows, size).all(axis=1)
        means_um = error_um[: rows * size].reshape(rows, size)[whole].mean(axis=1)
        if len(means_um):
            self._max_um = float(np.fmax(self._max_um, np.abs(means_um).max()))
            self._squares += float(means_um @ means_um)
            self._count += len(means_um)
