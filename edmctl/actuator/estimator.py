"""Displacement from the voltage, sample by sample or block by block, while the machine runs.

Two slow parameters stand on top of the frozen model, Z = gain · y + offset, and are learned at trusted events only.

Temperature moves the zero by a µm in ten minutes and the gain by half a percent in an hour; between days the
gain of a piezo stage has been seen to move by 2.5 %. Both are random walks here, followed by a Kalman filter of
two states whose readings are scalar: what the model said before correction, what was measured, how well.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from edmctl.actuator.model import consecutive

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from edmctl.actuator.model import ActuatorModel, ActuatorState

    Array = NDArray[np.float64]


class Estimator:
    """Follows one actuator from a known state: Z = gain · y(voltage) + offset.

    Feed it every turning point of the voltage really applied: samples that skip one leave the plays where the
    samples went, not where the actuator did. `gain` and `offset_um` are the two slow parameters that only
    trusted events may change (see `correction`).

    It starts from a copy of `state` (default: conditioned, at the low end).
    """

    def __init__(self, model: ActuatorModel, state: ActuatorState | None = None) -> None:
        self.model = model
        self.state = model.own_state(state)
        self.gain, self.offset_um = 1.0, 0.0
        self._passed_s, self._passed_um = np.empty(0), np.empty(0)
        """Samples that reach one delay into the past, without that delay."""

    def correct(self, gain: float, offset_um: float) -> None:
        """Set the two slow parameters. Raises ValueError unless they are finite and the gain is positive."""
        if not (0.0 < gain < math.inf and math.isfinite(offset_um)):
            raise ValueError(f"a gain is positive and finite, a zero is finite: {gain}, {offset_um}")
        self.gain, self.offset_um = gain, offset_um

    def tick(self, u_v: float, dt_s: float) -> float:
        """Displacement in µm when the voltage is `u_v`, `dt_s` after the last sample; raises as `advance`."""
        return float(self.advance(np.array([self.state.t_s + dt_s]), np.array([u_v]))[0])

    def advance(self, t_s: Array, u_v: Array) -> Array:
        """Displacement in µm, shape (n,), at consecutive samples; time runs on from the last one.

        Raises ValueError, and stays as it was, as `ActuatorModel.predict` does.
        """
        t_s, u_v = consecutive(t_s, u_v, self.state.t_s)
        if not len(t_s):
            return np.empty(0)
        y_um = self.model.advance(self.state, t_s, u_v)
        if self.model.delay_s > 0.0:
            y_um = self._delayed(t_s, y_um)
        corrected_um: Array = self.gain * y_um + self.offset_um
        return corrected_um

    def _delayed(self, t_s: Array, y_um: Array) -> Array:
        times_s = np.concatenate([self._passed_s, t_s])
        values_um = np.concatenate([self._passed_um, y_um])
        wanted_s = t_s - self.model.delay_s
        kept = max(0, int(np.searchsorted(times_s, wanted_s[-1], side="right")) - 1)
        self._passed_s, self._passed_um = times_s[kept:], values_um[kept:]
        delayed_um: Array = np.interp(wanted_s, times_s, values_um)
        return delayed_um


GAIN_SD_BETWEEN_DAYS = 0.025
"""Standard uncertainty of the gain before anything was measured today."""
ZERO_SD_UM = 100.0
"""Of the zero: a sensor that was mounted anew may read anything."""
GAIN_WALK_PER_SQRT_S = 0.005 / math.sqrt(3600.0)
"""0.5 % in an hour."""
ZERO_WALK_UM_PER_SQRT_S = 1.0 / math.sqrt(600.0)
"""1 µm in ten minutes."""
ZERO_DRIFT_UM_PER_S = 1.0 / 600.0
"""The same as a drift, of an actuator without a sensor."""


class SlowCorrection:
    """Gain and offset with their uncertainty, from readings in order of time.

    gain, offset_um : the present estimate; 1 and 0 before the first reading.
    """

    __slots__ = ("_both", "_gain2", "_time_s", "_zero2", "gain", "offset_um")

    def __init__(self, time_s: float = 0.0, *, gain_sd: float = GAIN_SD_BETWEEN_DAYS) -> None:
        self.gain, self.offset_um = 1.0, 0.0
        self._time_s = time_s
        self._gain2, self._both, self._zero2 = gain_sd**2, 0.0, ZERO_SD_UM**2

    @property
    def gain_sd(self) -> float:
        """Standard uncertainty of the gain at the last reading."""
        return math.sqrt(self._gain2)

    def sd_um(self, y_um: float) -> float:
        """Standard uncertainty of gain · y + offset at the last reading, µm."""
        return math.sqrt(max(0.0, y_um * (y_um * self._gain2 + 2.0 * self._both) + self._zero2))

    @property
    def time_s(self) -> float:
        """Time of the last reading."""
        return self._time_s

    def observe(
        self, time_s: float, y_um: float, z_um: float, sd_um: float, *, keep_gain: bool = False
    ) -> None:
        """Learn from one reading: the model said `y_um` (uncorrected) where `z_um` ± `sd_um` was measured.

        keep_gain : correct the zero only (the filter stays optimal for a gain that is merely considered).

        Raises ValueError for a reading before the last one or an sd that is not positive.
        """
        elapsed_s = time_s - self._time_s
        if not (elapsed_s >= 0.0 and sd_um > 0.0):
            raise ValueError(
                f"a reading {elapsed_s} s after the last one, with a standard deviation of {sd_um} µm"
            )
        self._time_s = time_s
        self._gain2 += GAIN_WALK_PER_SQRT_S**2 * elapsed_s
        self._zero2 += ZERO_WALK_UM_PER_SQRT_S**2 * elapsed_s
        with_gain = y_um * self._gain2 + self._both
        with_zero = y_um * self._both + self._zero2
        variance = y_um * with_gain + with_zero + sd_um**2
        error_um = z_um - (self.gain * y_um + self.offset_um)
        self.offset_um += with_zero / variance * error_um
        if not keep_gain:
            self.gain += with_gain / variance * error_um
            self._gain2 -= with_gain**2 / variance
        self._both -= with_gain * with_zero / variance
        self._zero2 -= with_zero**2 / variance
