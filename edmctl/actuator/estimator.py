"""Displacement from the voltage, sample by sample or block by block, while the machine runs."""

from __future__ import annotations

import math
from collections import deque
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

    `tick` is plain Python, a few µs and no start-up; `advance` takes blocks through compiled code. Both
    agree to rounding and may be mixed. It starts from a copy of `state` (default: conditioned, at the low end).
    """

    def __init__(self, model: ActuatorModel, state: ActuatorState | None = None) -> None:
        self.model = model
        self.gain, self.offset_um = 1.0, 0.0
        self._state = model.own_state(state)
        self._passed: deque[tuple[float, float]] = deque()
        """Samples (s, µm without delay) that reach one delay into the past."""
        self._thresholds_v: list[float] = model.thresholds_v.tolist()
        self._bank: list[tuple[list[float], list[float]]] = list(
            zip(model.knots_v.tolist(), model.slopes_um_per_v.tolist(), strict=True)
        )
        self._creeps: list[tuple[int, float, list[float]]] = [
            (i, self._thresholds_v[i], weights)
            for i, weights in zip(model.creep_plays.tolist(), model.creep_um_per_v.tolist(), strict=True)
        ]
        self._plays_v: list[float] | None = None
        self._lags_v: list[list[float]] = []
        self._parts_um: list[float] = []
        self._follow: list[tuple[float, float, float]] = []
        self._follow_dt_s = math.nan

    @property
    def state(self) -> ActuatorState:
        """The state reached, a live view until the next tick."""
        if self._plays_v is not None:
            self._state.plays_v[:] = self._plays_v
            self._state.lags_v[:] = self._lags_v
            self._plays_v = None
        return self._state

    def correct(self, gain: float, offset_um: float) -> None:
        """Set the two slow parameters. Raises ValueError unless they are finite and the gain is positive."""
        if not (0.0 < gain < math.inf and math.isfinite(offset_um)):
            raise ValueError(f"a gain is positive and finite, a zero is finite: {gain}, {offset_um}")
        self.gain, self.offset_um = gain, offset_um

    def tick(self, u_v: float, dt_s: float) -> float:
        """Displacement in µm when the voltage is `u_v`, `dt_s` after the last sample.

        Raises ValueError, and stays as it was, for a voltage that is not finite or a time that runs back.
        """
        if not (math.isfinite(u_v) and 0.0 <= dt_s < math.inf):
            raise ValueError(f"a tick of {dt_s} s to {u_v} V")
        if self._plays_v is None:
            self._plays_v = self._state.plays_v.tolist()
            self._lags_v = self._state.lags_v.tolist()
            self._parts_um = [
                _bent(*piece, z_v) for piece, z_v in zip(self._bank, self._plays_v, strict=True)
            ]
        if dt_s != self._follow_dt_s:
            self._follow = [_following(dt_s / tau_s) for tau_s in self.model.time_constants_s.tolist()]
            self._follow_dt_s = dt_s
        self._state.t_s += dt_s
        self._state.u_v = u_v
        creep_um = self._creep(u_v)
        y_um = self._bent_plays(u_v) + creep_um + self.model.zero_um
        if self.model.delay_s > 0.0:
            y_um = self._delayed(y_um)
        return self.gain * y_um + self.offset_um

    def advance(self, t_s: Array, u_v: Array) -> Array:
        """Displacement in µm, shape (n,), at consecutive samples; time runs on from the last one.

        Raises ValueError, and stays as it was, as `ActuatorModel.predict` does.
        """
        t_s, u_v = consecutive(t_s, u_v, self._state.t_s)
        if not len(t_s):
            return np.empty(0)
        y_um = self.model.advance(self.state, t_s, u_v)
        if self.model.delay_s > 0.0:
            y_um = self._delayed_block(t_s, y_um)
        corrected_um: Array = self.gain * y_um + self.offset_um
        return corrected_um

    def _creep(self, u_v: float) -> float:
        """Let the creep follow the move to `u_v`; the plays have not moved yet."""
        assert self._plays_v is not None
        y_um, follow = 0.0, self._follow
        for (i, threshold_v, weights), lags_v in zip(self._creeps, self._lags_v, strict=True):
            before = self._plays_v[i]
            after = min(max(before, u_v - threshold_v), u_v + threshold_v)
            for j, (stays, start, end) in enumerate(follow):
                lags_v[j] = lag = stays * lags_v[j] + start * before + end * after
                y_um += weights[j] * lag
        return y_um

    def _bent_plays(self, u_v: float) -> float:
        """Move the plays to `u_v`; most steps move few, the others keep their part of the sum."""
        plays_v, parts_um, bank = self._plays_v, self._parts_um, self._bank
        assert plays_v is not None
        for i, threshold_v in enumerate(self._thresholds_v):
            z_v = plays_v[i]
            if z_v < u_v - threshold_v:
                plays_v[i] = z_v = u_v - threshold_v
            elif z_v > u_v + threshold_v:
                plays_v[i] = z_v = u_v + threshold_v
            else:
                continue
            parts_um[i] = _bent(*bank[i], z_v)
        return sum(parts_um)

    def _delayed(self, y_um: float) -> float:
        passed, wanted_s = self._passed, self._state.t_s - self.model.delay_s
        passed.append((self._state.t_s, y_um))
        while len(passed) > 2 and passed[1][0] <= wanted_s:
            passed.popleft()
        (first_s, first_um), (second_s, second_um) = passed[0], passed[min(1, len(passed) - 1)]
        if wanted_s <= first_s:
            return first_um
        return first_um + (wanted_s - first_s) / (second_s - first_s) * (second_um - first_um)

    def _delayed_block(self, t_s: Array, y_um: Array) -> Array:
        times_s = np.concatenate([[t for t, _ in self._passed], t_s])
        values_um = np.concatenate([[y for _, y in self._passed], y_um])
        wanted_s = t_s - self.model.delay_s
        kept = max(0, int(np.searchsorted(times_s, wanted_s[-1], side="right")) - 1)
        self._passed = deque(zip(times_s[kept:].tolist(), values_um[kept:].tolist(), strict=True))
        delayed_um: Array = np.interp(wanted_s, times_s, values_um)
        return delayed_um


def _bent(knots_v: list[float], slopes: list[float], z_v: float) -> float:
    """`operators.bent` in plain Python."""
    y_um, last = 0.0, len(slopes) - 1
    for m in range(last):
        if z_v <= knots_v[m + 1]:
            return y_um + slopes[m] * (z_v - knots_v[m])
        y_um += slopes[m] * (knots_v[m + 1] - knots_v[m])
    return y_um + slopes[last] * (z_v - knots_v[last])


def _following(share: float) -> tuple[float, float, float]:
    """`operators.following` for one lag and a move that takes `share` of its time constant."""
    stays = math.exp(-share)
    mean = -math.expm1(-share) / share if share > 0.0 else 1.0
    return stays, mean - stays, 1.0 - mean
