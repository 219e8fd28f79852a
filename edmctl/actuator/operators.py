"""Hysteresis and creep of a piezo actuator as a bank of play operators.

Play operator of threshold r (volts): z_k = max(u_k − r, min(u_k + r, z_{k−1})), Krasnosel'skii & Pokrovskii
1989. It needs no time: between turning points only the end matters. Creep of a play is a sum of first-order
lags of equal weight with time constants in geometric progression, which relaxes like the logarithm of time:
L' = (z − L)/τ.

`advance_bank` is plain Python and is the definition; `compiled_bank` is the same source through numba, bit
for bit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Protocol

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class BankShape:
    """What a bank is made of.

    thresholds_v : ndarray, shape (n,)
        Thresholds of the plays; the first is 0 (the voltage itself).
    creeping : ndarray of int, shape (g,)
        Plays that creep.
    time_constants_s : ndarray, shape (j,)
        Lags of each creeping play.
    """

    thresholds_v: Array
    creeping: NDArray[np.int64]
    time_constants_s: Array

    @property
    def features(self) -> int:
        """Outputs per sample: n plays, then g creeps."""
        return len(self.thresholds_v) + len(self.creeping)


@dataclass(slots=True)
class BankState:
    """What a bank remembers; arrays change in place.

    plays_v : ndarray, shape (n,)
    creep_v : ndarray, shape (g, j)
    time_s : float
        When the state was last brought up to date.
    """

    plays_v: Array
    creep_v: Array
    time_s: float

    @classmethod
    def at_rest(cls, shape: BankShape, actuator_v: float, time_s: float) -> BankState:
        """Every play and every creep at the voltage `actuator_v`: no memory of earlier swings."""
        return cls(
            np.full(len(shape.thresholds_v), actuator_v),
            np.full((len(shape.creeping), len(shape.time_constants_s)), actuator_v),
            time_s,
        )

    def copy(self) -> BankState:
        """Return an independent copy."""
        return BankState(self.plays_v.copy(), self.creep_v.copy(), self.time_s)


class BankKernel(Protocol):
    """Signature of `advance_bank`."""

    def __call__(
        self,
        time_s: Array,
        actuator_v: Array,
        since_s: float,
        thresholds_v: Array,
        creeping: NDArray[np.int64],
        time_constants_s: Array,
        plays_v: Array,
        creep_v: Array,
        weights: Array,
        features: Array,
        output: Array,
    ) -> None: ...


def advance_bank(
    time_s: Array,
    actuator_v: Array,
    since_s: float,
    thresholds_v: Array,
    creeping: NDArray[np.int64],
    time_constants_s: Array,
    plays_v: Array,
    creep_v: Array,
    weights: Array,
    features: Array,
    output: Array,
) -> None:
    """Advance the state by k samples.

    `plays_v` (n,) and `creep_v` (g, j) change in place; `since_s` is the time they belong to. `features`
    (k, n + g) receives the plays and, per creeping play, the sum of its lags; `output` (k,) the product
    with `weights` (n + g,). Between two samples a creep follows the earlier one's play.
    """
    plays = thresholds_v.shape[0]
    before_s = since_s
    for k in range(time_s.shape[0]):
        elapsed_s = time_s[k] - before_s
        before_s = time_s[k]
        for j in range(time_constants_s.shape[0]):
            decay = math.exp(-elapsed_s / time_constants_s[j])
            for g in range(creeping.shape[0]):
                held_v = plays_v[creeping[g]]
                creep_v[g, j] = held_v + decay * (creep_v[g, j] - held_v)
        total = 0.0
        for i in range(plays):
            play_v = plays_v[i]
            low_v = actuator_v[k] - thresholds_v[i]
            high_v = actuator_v[k] + thresholds_v[i]
            if play_v < low_v:
                play_v = low_v
            elif play_v > high_v:
                play_v = high_v
            plays_v[i] = play_v
            features[k, i] = play_v
            total += weights[i] * play_v
        for g in range(creeping.shape[0]):
            lags_v = 0.0
            for j in range(time_constants_s.shape[0]):
                lags_v += creep_v[g, j]
            features[k, plays + g] = lags_v
            total += weights[plays + g] * lags_v
        output[k] = total


@cache
def compiled_bank() -> BankKernel:
    """Return `advance_bank` compiled by numba: no fastmath, so the same bits; cached on disk."""
    from edmctl.actuator.compiling import cached

    kernel: BankKernel = cached(advance_bank)
    return kernel
