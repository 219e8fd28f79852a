"""When a run cut: the stretches of time in which the supervisor wrote its rows."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from edmctl.record import layout

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from edmctl.record.reader import RunFile

    Array = NDArray[np.float64]

APART_S = 2.0
"""Rows come every 0.1 s, and a jump with its search for the gap takes less than this."""

ROW_S = 0.1
"""Each row tells of so much before its time."""

MEAN_S = 10.0
"""Rates and shares of a second scatter; their means over this show what they do."""


def stretches(time_s: Array) -> list[slice]:
    """Split rows, shape (n,), where nothing was written for `APART_S`."""
    if not len(time_s):
        return []
    breaks = np.flatnonzero(np.diff(time_s) > APART_S) + 1
    ends = [0, *breaks.tolist(), len(time_s)]
    return [slice(first, stop) for first, stop in pairwise(ends)]


def cuts_s(run: RunFile) -> Array:
    """Return begin and end of each stretch of cutting, shape (n, 2), s, with what its first row tells of."""
    time_s = run.column(layout.SLOW.path, "time").astype(np.float64)
    ends = [(max(time_s[part][0] - ROW_S, 0.0), time_s[part][-1]) for part in stretches(time_s)]
    return np.array(ends, np.float64).reshape(-1, 2)


@dataclass(frozen=True, slots=True)
class Broken:
    """A signal as a line that is broken between stretches: ndarrays of shape (n,), NaN where it is broken.

    `low is high` where every row is drawn; else they are the extremes of groups of rows.
    """

    time_s: Array
    low: Array
    high: Array


def broken(time_s: Array, values: Array, points: int = 1500) -> Broken:
    """Reduce rows, shape (n,), to about `points` groups, none of which spans two stretches."""
    parts = stretches(time_s)
    every = max(1, len(time_s) // points)
    times: list[Array] = []
    lows: list[Array] = []
    highs: list[Array] = []
    gap = np.array([np.nan])
    for part in parts:
        starts = np.arange(part.start, part.stop, every)
        last = np.minimum(starts + every, part.stop) - 1
        times += [0.5 * (time_s[starts] + time_s[last]), time_s[last[-1:]]]
        rows = values[: part.stop]
        lows += [np.fmin.reduceat(rows, starts), gap]
        highs += [np.fmax.reduceat(rows, starts), gap]
    low = np.concatenate(lows) if lows else np.empty(0)
    high = low if every == 1 else np.concatenate(highs)
    return Broken(np.concatenate(times) if times else np.empty(0), low, high)


def running_mean(time_s: Array, values: Array) -> Array:
    """Mean over the `MEAN_S` before each row, shape (n,); NaN counts as nothing."""
    known = np.isfinite(values)
    sums = np.concatenate([[0.0], np.cumsum(np.where(known, values, 0.0))])
    numbers = np.concatenate([[0], np.cumsum(known)])
    first = np.searchsorted(time_s, time_s - MEAN_S, side="right")
    last = np.arange(1, len(time_s) + 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean: Array = (sums[last] - sums[first]) / (numbers[last] - numbers[first])
    return mean
