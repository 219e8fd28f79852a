"""Long signals as few points, without aliasing: the lowest and the highest value of each of many intervals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from .reader import RunFile

    Array = NDArray[np.float64]

POINTS = 2000
"""Intervals of time that a signal is reduced to: more than a figure of 180 mm can show at 300 dpi is of no use."""


@dataclass(frozen=True, slots=True)
class Traces:
    """Signals over time. With `every` 1 the samples themselves, and `low` equals `high`.

    time_s : ndarray, shape (n,), the time in the middle of each interval
    low, high : ndarrays of shape (n,) by column; NaN where an interval holds nothing but NaN
    """

    time_s: Array
    low: dict[str, Array]
    high: dict[str, Array]
    every: int

    @property
    def span_s(self) -> float:
        """From the first sample to the last."""
        return float(self.time_s[-1] - self.time_s[0]) if len(self.time_s) else 0.0


def traces(
    run: RunFile,
    path: str,
    names: Sequence[str],
    between_s: tuple[float, float] | None = None,
    points: int = POINTS,
) -> Traces:
    """Reduce columns of a group that has a column `time` to about `points` intervals each.

    `between_s` picks a part of the time, both ends included. The file is read block by block, so its length does
    not matter.
    """
    first, stop = _part(run, path, between_s)
    every = max(1, -(-(stop - first) // points)) if stop - first > 2 * points else 1
    rows = max(1, (1 << 18) // every) * every
    times: list[Array] = []
    lows: dict[str, list[Array]] = {name: [] for name in names}
    highs: dict[str, list[Array]] = {name: [] for name in names}
    for start in range(first, stop, rows):
        end = min(start + rows, stop)
        starts = np.arange(0, end - start, every)
        time_s = run.column(path, "time", start, end).astype(np.float64)
        last = np.minimum(starts + every, end - start) - 1
        times.append(0.5 * (time_s[starts] + time_s[last]))
        for name in names:
            values = run.column(path, name, start, end)
            if every == 1:
                lows[name].append(values.astype(np.float64))
                continue
            # fmin and fmax leave NaN out, unless there is nothing else.
            lows[name].append(np.fmin.reduceat(values, starts).astype(np.float64))
            highs[name].append(np.fmax.reduceat(values, starts).astype(np.float64))
    low = {name: _joined(parts) for name, parts in lows.items()}
    high = low if every == 1 else {name: _joined(parts) for name, parts in highs.items()}
    return Traces(_joined(times), low, high, every)


def _part(run: RunFile, path: str, between_s: tuple[float, float] | None) -> tuple[int, int]:
    if between_s is None:
        return 0, run.rows(path)
    time_s = run.column(path, "time")
    from_s, to_s = between_s
    return int(np.searchsorted(time_s, from_s, "left")), int(np.searchsorted(time_s, to_s, "right"))


def _joined(parts: list[Array]) -> Array:
    return np.concatenate(parts) if parts else np.empty(0)
