"""What an actuator remembers: where every play stands, and how far every creep has come.

The state decides half of what the actuator does next: a model that starts without memory on an actuator that
has been working is wrong by at least half the loop's width near 0 V, which is the size of the unexplained
error at the trough of Muralidhara et al. 2009, Fig. 3a.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from edmctl.actuator.model import ActuatorModel

    Array = NDArray[np.float64]


@dataclass(slots=True)
class ActuatorState:
    """State of an `ActuatorModel`; arrays change in place.

    plays_v : ndarray, shape (n,)
    lags_v : ndarray, shape (g, j)
        Creep: each lag follows the play it belongs to.
    u_v, t_s : float
        Voltage applied last, and when.
    """

    plays_v: Array
    lags_v: Array
    u_v: float
    t_s: float = 0.0

    @classmethod
    def virgin(cls, model: ActuatorModel, u_v: float = 0.0) -> ActuatorState:
        """Never driven before, resting at `u_v`: the next rise follows the initial loading curve."""
        return cls._relaxed(model, np.full(len(model.thresholds_v), u_v), u_v)

    @classmethod
    def conditioned(
        cls, model: ActuatorModel, u_v: float | None = None, *, falling: bool = False
    ) -> ActuatorState:
        """Cycled over the model's range, then brought to `u_v` (default: the low end) and long at rest.

        It came up from the low end, or with `falling` down from the high one.
        """
        ends = (model.high_v, model.low_v) if falling else (model.low_v, model.high_v)
        rest_v = model.low_v if u_v is None else u_v
        turns = (*ends, *ends, ends[0], rest_v)
        return cls._relaxed(model, _turned(model, np.full(len(model.thresholds_v), rest_v), turns), rest_v)

    @classmethod
    def after_jump(cls, model: ActuatorModel, from_v: float, to_v: float) -> ActuatorState:
        """Held at `from_v`, then brought to `to_v` in one move; creep has followed the move."""
        state = cls.virgin(model, from_v)
        state.plays_v[:] = _turned(model, state.plays_v, (to_v,))
        state.lags_v[:] = state.plays_v[model.creep_plays, np.newaxis]
        state.u_v = to_v
        return state

    @classmethod
    def replayed(
        cls, model: ActuatorModel, t_s: Array, u_v: Array, start: ActuatorState | None = None
    ) -> ActuatorState:
        """After a known history: shape (n,) each, from `start` (default: conditioned) at its first sample."""
        state = cls.conditioned(model, float(u_v[0])) if start is None else start.copy()
        state.t_s = float(t_s[0])
        model.advance(state, t_s, u_v)
        return state

    def rested(self, model: ActuatorModel, elapsed_s: float) -> ActuatorState:
        """After `elapsed_s` of real time at the same voltage: hysteresis stays, creep goes on."""
        if elapsed_s < 0.0:
            raise ValueError(f"time runs forwards: {elapsed_s} s")
        after = self.copy()
        model.advance(after, np.array([self.t_s + elapsed_s]), np.array([self.u_v]))
        return after

    def copy(self) -> ActuatorState:
        """Return an independent copy."""
        return ActuatorState(self.plays_v.copy(), self.lags_v.copy(), self.u_v, self.t_s)

    def as_mapping(self) -> dict[str, object]:
        """Plain numbers, to be saved."""
        return {
            "plays_v": self.plays_v.tolist(),
            "lags_v": self.lags_v.tolist(),
            "u_v": self.u_v,
            "t_s": self.t_s,
        }

    @classmethod
    def from_mapping(
        cls, model: ActuatorModel, mapping: Mapping[str, float | Sequence[float] | Sequence[Sequence[float]]]
    ) -> ActuatorState:
        """Restore what `as_mapping` saved. Raises ValueError where it is not a state of this model."""
        plays = np.array(mapping["plays_v"], dtype=np.float64)
        lags = np.array(mapping["lags_v"], dtype=np.float64)
        expected = (model.thresholds_v.shape, model.creep_um_per_v.shape)
        if (plays.shape, lags.shape) != expected:
            raise ValueError(f"a state of shape {plays.shape}, {lags.shape} for a model of {expected}")
        u_v, t_s = np.float64(mapping["u_v"]), np.float64(mapping["t_s"])  # type: ignore[arg-type]
        if not (np.isfinite(plays).all() and np.isfinite(lags).all() and np.isfinite([u_v, t_s]).all()):
            raise ValueError("a state holds finite numbers only")
        return cls(plays, lags, float(u_v), float(t_s))

    @classmethod
    def _relaxed(cls, model: ActuatorModel, plays_v: Array, u_v: float) -> ActuatorState:
        lags_v = np.repeat(plays_v[model.creep_plays, np.newaxis], len(model.time_constants_s), axis=1)
        return cls(plays_v, lags_v, u_v)


def _turned(model: ActuatorModel, plays_v: Array, turns: Sequence[float]) -> Array:
    """Where the plays are after the voltage has visited `turns`."""
    for u_v in turns:
        plays_v = np.clip(plays_v, u_v - model.thresholds_v, u_v + model.thresholds_v)
    return plays_v
