"""Displacement from the voltage, sample by sample or block by block, while the machine runs."""

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
        self.model.check_state(self.state)
        t_s, u_v = consecutive(t_s, u_v, self.state.t_s)
        if not len(t_s):
            return np.empty(0)
        y_um = self.model.advance_checked(self.state, t_s, u_v)
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
