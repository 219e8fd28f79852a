"""A gap without any discharge, in a cut through a sheet: the controller's own limit waits for the completion there.

After the breakthrough nothing but open pulses is right, so the controller is told to bear them as long as the
completion takes (`settings.py`). Before it the host looks by the same limits that the controller has elsewhere.
"""

from __future__ import annotations

import math


class SparkLoss:
    """Follows the tool since the last spark.

    limit_um, limit_s : way and time of open pulses that are too much

    `spark_um` is the displacement at the last spark, NaN before the first slice.
    """

    def __init__(self, limit_um: float, limit_s: float) -> None:
        self._limit_um, self._limit_s = limit_um, limit_s
        self._open_s = 0.0
        self.spark_um = math.nan

    def take(self, duration_s: float, displacement_um: float, pulses: int, opens: int) -> str:
        """Judge a slice of sparking; says what was seen when the sparks are lost, empty otherwise."""
        if opens < pulses or math.isnan(self.spark_um):
            self._open_s, self.spark_um = 0.0, displacement_um
            return ""
        self._open_s += duration_s
        way_um = displacement_um - self.spark_um
        if way_um <= self._limit_um and self._open_s <= self._limit_s:
            return ""
        return f"{self._open_s:.1f} s and {way_um:.1f} µm without a discharge, at {displacement_um:.1f} µm"
