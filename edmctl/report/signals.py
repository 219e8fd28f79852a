"""Signals of a run as few points, and the intervals in which the machine cut, touched or was in a state.

An envelope has the lowest value, the mean and the highest of each of many intervals. Every sample can be changed
first: masked by state, or subtracted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from edmctl.array_types import Array, Integers
from edmctl.dataclasses import dataclass
from edmctl.record import layout
from edmctl.record.reader import RecordedState, RunFile, recorded_events
from edmctl.record.rows import RunEvent

Floats = NDArray[np.floating]
Columns = Mapping[str, NDArray[np.generic]]

SERVO = "/entry/servo"
POINTS = 900
"""Intervals of a figure one column wide: a pixel each at 300 dpi."""
BLOCK_ROWS = 1 << 20
MIN_WORK_S = 1.0
WORKING = (RecordedState.APPROACH, RecordedState.MACHINING, RecordedState.JUMP, RecordedState.TOUCH)
APART_S = 2.0
"""Rows come at least every 0.5 s, and a jump with its search for the gap takes less than this."""
ROW_S = 0.1
"""The first row of a cut covers so much before its time: samples that show another state end a wait."""
MEAN_S = 10.0
"""Rates and shares of a second scatter; their means over this show what they do."""


@dataclass(frozen=True, slots=True)
class Envelope:
    """A signal by intervals of time; ndarrays of shape (n,), NaN where an interval holds no value."""

    time_s: Array
    low: Array
    mean: Array
    high: Array
    sampled: bool
    """Whether each interval is one sample."""

    @property
    def is_empty(self) -> bool:
        return not bool(np.isfinite(self.mean).any())


def envelopes(
    run: RunFile,
    path: str,
    names: Sequence[str],
    derive: Callable[[Columns], Mapping[str, Floats]],
    part: tuple[int, int] | None = None,
    points: int = POINTS,
) -> dict[str, Envelope]:
    """Reduce what `derive` makes of the columns `names`, and `time`, to about `points` intervals each.

    `derive` takes blocks of consecutive rows, shape (n,), in their order, and returns signals of that shape.
    `part` picks rows, from the first to before the second; the file is read block by block.
    """
    first, stop = (0, run.rows(path)) if part is None else part
    every = max(1, -(-(stop - first) // points)) if stop - first > 2 * points else 1
    rows = max(1, BLOCK_ROWS // every) * every
    times: list[Array] = []
    found: dict[str, list[Array]] = {}
    for start in range(first, stop, rows):
        end = min(start + rows, stop)
        columns = {name: run.column(path, name, start, end) for name in ("time", *names)}
        time_s = columns["time"].astype(np.float64, copy=False)
        starts = np.arange(0, len(time_s), every)
        times.append(0.5 * (time_s[starts] + time_s[np.minimum(starts + every, len(time_s)) - 1]))
        for name, values in derive(columns).items():
            found.setdefault(name, []).append(_extremes(values, starts))
    time = np.concatenate(times) if times else np.empty(0)
    lines: dict[str, Envelope] = {}
    for name, parts in found.items():
        low, mean, high = np.concatenate(parts, axis=1)
        lines[name] = Envelope(time, low, mean, high, sampled=every == 1)
    return lines


def _extremes(values: Floats, starts: Integers) -> Array:
    """Return lowest value, mean and highest from each start to the next, shape (3, n); NaN counts as nothing."""
    known = np.isfinite(values)
    counts = np.add.reduceat(known, starts, dtype=np.int64)
    sums = np.add.reduceat(np.where(known, values, np.float32(0.0)), starts, dtype=np.float64)
    means = np.divide(sums, counts, out=np.full(len(starts), np.nan), where=counts > 0)
    return np.stack(
        [np.fmin.reduceat(values, starts), means, np.fmax.reduceat(values, starts)], dtype=np.float64
    )


def without_jumps(values: NDArray[np.generic], state: NDArray[np.generic]) -> Floats:
    """Return the values, NaN while the tool jumped; shape (n,)."""
    resting: Floats = np.where(state == RecordedState.JUMP, np.float32(np.nan), values)
    return resting


def floats(
    run: RunFile, path: str, names: Iterable[str], part: tuple[int, int] | None = None
) -> dict[str, Array]:
    """Return columns of a group, shape (n,), to calculate with; `part` picks rows."""
    return {name: run.column(path, name, *(part or ())).astype(np.float64) for name in names}


def spans_in(run: RunFile, states: Sequence[RecordedState]) -> Integers:
    """Return the first row of each stay in one of some states and the first after it, shape (n, 2)."""
    inside = np.isin(run.column(SERVO, "state"), states)
    edges: Integers = np.flatnonzero(np.diff(inside, prepend=False, append=False)).reshape(-1, 2)
    return edges


def time_at(run: RunFile, row: int) -> float:
    """Return the time of a row of `/entry/servo`."""
    return float(run.column(SERVO, "time", row, row + 1)[0])


def rows_worked(run: RunFile) -> tuple[int, int]:
    """Return the rows of the servo from the first touch, approach or cut to the last; (0, 0) without any."""
    spans = spans_in(run, WORKING)
    if not len(spans):
        return 0, 0
    # Tests of the generator, which are shorter approaches, and conditioning would take all the room.
    step_s = float(np.median(np.diff(run.column(SERVO, "time", 0, 200)))) if run.rows(SERVO) > 1 else 0.0
    longer = np.flatnonzero((spans[:, 1] - spans[:, 0]) * step_s >= MIN_WORK_S)
    first = spans[longer[0] if len(longer) else 0, 0]
    return int(first), min(int(spans[-1, 1]) + 1, run.rows(SERVO))


def intervals(time_s: Array) -> list[slice]:
    """Split rows, shape (n,), where nothing was written for `APART_S`."""
    if not len(time_s):
        return []
    breaks = np.flatnonzero(np.diff(time_s) > APART_S) + 1
    ends = [0, *breaks.tolist(), len(time_s)]
    return [slice(first, stop) for first, stop in pairwise(ends)]


def cuts_s(run: RunFile) -> Array:
    """Return begin and end of each interval of cutting, shape (n, 2), s, with the time that its first row covers."""
    time_s = run.column(layout.SLOW.path, "time").astype(np.float64)
    planned_s = np.array([event.time_s for event in recorded_events(run, RunEvent.CUT_PLANNED)])
    ends: list[tuple[float, float]] = []
    for part in intervals(time_s):
        first_s = time_s[part][0]
        before_s = planned_s[(planned_s <= first_s) & (planned_s > first_s - ROW_S)]
        ends.append((max(first_s - ROW_S, 0.0, *before_s), time_s[part][-1]))
    return np.array(ends, np.float64).reshape(-1, 2)


def broken(time_s: Array, values: Array, points: int = 1500) -> Envelope:
    """Reduce rows, shape (n,), to about `points` groups; NaN between intervals of cutting breaks a line there."""
    every = max(1, len(time_s) // points)
    gap = np.array([np.nan])
    times, lows, highs = [np.empty(0)], [np.empty(0)], [np.empty(0)]
    for part in intervals(time_s):
        starts = np.arange(part.start, part.stop, every)
        last = np.minimum(starts + every, part.stop) - 1
        times += [0.5 * (time_s[starts] + time_s[last]), time_s[last[-1:]]]
        rows = values[: part.stop]
        lows += [np.fmin.reduceat(rows, starts), gap]
        highs += [np.fmax.reduceat(rows, starts), gap]
    low, high = np.concatenate(lows), np.concatenate(highs)
    return Envelope(np.concatenate(times), low, 0.5 * (low + high), high, sampled=every == 1)


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
