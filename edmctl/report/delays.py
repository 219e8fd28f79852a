"""Ignition delays of a run: their distribution, and the mean that random ignition would have."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from edmctl.report.pulse_counts import NORMAL, OPEN, pulse_blocks, rows_at

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from edmctl.record.reader import RunFile

    Array = NDArray[np.float64]
    Counts = NDArray[np.int64]

STEP_US = 0.1
"""What a delay is stored in."""
_STEPS = 1 << 16
_LAG_SHARE = 0.001
"""Of the delays, before which ignition is taken not to have begun: the time that a breakdown takes to form."""


@dataclass(frozen=True, slots=True)
class Delays:
    """Pulses by their delay, in steps of 0.1 µs.

    ignited : ndarray, shape (n,), normal discharges after that delay
    censored : ndarray, shape (n,), pulses that had not ignited when an on-time of that length was over
    """

    ignited: Counts
    censored: Counts

    @property
    def surviving(self) -> Array:
        """Share of pulses without a spark after each delay, shape (n,), by Kaplan and Meier."""
        at_risk = np.cumsum((self.ignited + self.censored)[::-1])[::-1]
        with np.errstate(invalid="ignore", divide="ignore"):
            lasting: Array = np.where(at_risk > 0, 1.0 - self.ignited / at_risk, np.nan)
        return lasting.cumprod()


@dataclass(frozen=True, slots=True)
class RandomIgnition:
    """The exponential law by maximum likelihood, open pulses counted as not yet ignited.

    Survivors follow exp(-(t - lag) / mean) after the lag; `mean_u95_us` is half the 95 % interval of the mean, and
    `ignited` and `censored` are how many pulses it is from.
    """

    lag_us: float
    mean_us: float
    mean_u95_us: float
    ignited: int
    censored: int


def delays(run: RunFile, cuts_s: Array) -> Delays:
    """Count normal discharges and open pulses by their delay, within cuts alone, shape (n, 2): begin and end.

    An approach has long delays, as its gap is wide.
    """
    counts = np.zeros((2, _STEPS), np.int64)
    for first, stop in rows_at(run, cuts_s.ravel()).reshape(-1, 2).tolist():
        for _, columns in pulse_blocks(run, first, stop, ("pulse_class", "td")):
            kind = columns["pulse_class"]
            rounded = np.rint(columns["td"] / np.float32(STEP_US)).astype(np.int32)
            for k, wanted in enumerate((NORMAL, OPEN)):
                counts[k] += np.bincount(rounded[kind == wanted], minlength=_STEPS)
    used = np.flatnonzero(counts.any(axis=0))
    end = int(used[-1]) + 1 if len(used) else 0
    return Delays(counts[0, :end], counts[1, :end])


def random_ignition(found: Delays) -> RandomIgnition | None:
    """Fit random ignition; None where fewer than two pulses ignited after the lag."""
    total = int(found.ignited.sum())
    if total < 2:
        return None
    lag = int(np.searchsorted(np.cumsum(found.ignited), max(1.0, _LAG_SHARE * total)))
    after = np.arange(len(found.ignited)) - lag
    later = after > 0
    ignited, censored = int(found.ignited[later].sum()), int(found.censored[later].sum())
    waited = STEP_US * float(((found.ignited + found.censored) * after)[later].sum())
    if ignited < 2:
        return None
    mean_us = waited / ignited
    return RandomIgnition(STEP_US * lag, mean_us, 1.96 * mean_us / math.sqrt(ignited), ignited, censored)
