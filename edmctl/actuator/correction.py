"""Slow gain and offset of a model, Z = gain · y + offset, learned at trusted events by a Kalman filter.

Temperature moves the zero by a µm in ten minutes and the gain by half a percent in an hour; gain differs by 2.5 %
between days.
"""

from __future__ import annotations

import math

GAIN_SD_BETWEEN_DAYS = 0.025  # standard uncertainty of the gain before anything was measured today
ZERO_SD_UM = 100.0  # of the zero: a sensor that was mounted anew may read anything
GAIN_WALK_PER_SQRT_S = 0.005 / math.sqrt(3600.0)  # 0.5 % in an hour
ZERO_WALK_UM_PER_SQRT_S = 1.0 / math.sqrt(600.0)  # 1 µm in ten minutes
ZERO_DRIFT_UM_PER_S = 1.0 / 600.0  # the same as a drift, of an actuator without a sensor


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
