"""Pulses counted over intervals of time, in constant memory: every single one, or sums over blocks of them.

A working day has 66 million pulses. They are read part by part; which pulse belongs to which interval follows from
the segments of constant period, without the time of a single one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from edmctl.record import layout
from edmctl.report.numbers import CLASSES

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from edmctl.record.reader import RunFile

    Array = NDArray[np.float64]
    Counts = NDArray[np.int64]

OPEN, NORMAL, ARC, SHORT = range(4)
"""Numbers of the classes, in the order of `numbers.CLASSES`."""
READ_ROWS = 1 << 20
_BLOCK_COUNTS = tuple(f"n_{name}" for name in CLASSES)


def has_every_pulse(run: RunFile) -> bool:
    """Whether single pulses were recorded."""
    return run.rows(layout.PULSES.path) > 0


def has_pulses(run: RunFile) -> bool:
    """Whether pulses were recorded, one by one or in blocks."""
    return has_every_pulse(run) or run.rows(layout.PULSE_BLOCKS.path) > 0


def pulse_counts(run: RunFile, edges_s: Array) -> Counts:
    """Count the pulses of each class between `edges_s`, shape (n + 1,), which rise; shape (n, 4)."""
    return _of_every_pulse(run, edges_s) if has_every_pulse(run) else _of_blocks(run, edges_s)


def current_a(run: RunFile) -> float:
    """Return the mean discharge current that the profile gives."""
    return float(run.profile_values().get("pulse.current_a", np.nan))


def rows_at(run: RunFile, times_s: Array) -> NDArray[np.int64]:
    """Return the first row of `/entry/pulses/full` that is not before each of the times, which rise."""
    segments = run.columns(layout.SEGMENTS.path)
    first_row = segments["first_row"].astype(np.int64)
    start_s, period_s = segments["t0"].astype(np.float64), segments["period"].astype(np.float64)
    stop_row = np.append(first_row[1:], run.rows(layout.PULSES.path))
    of = np.maximum(np.searchsorted(start_s, times_s, side="right") - 1, 0)
    pulses = np.ceil((times_s - start_s[of]) / period_s[of] - 1e-6)
    rows = first_row[of] + np.maximum(pulses, 0.0).astype(np.int64)
    kept: NDArray[np.int64] = np.minimum(rows, stop_row[of])
    return kept


def pulse_blocks(
    run: RunFile, first: int, stop: int, names: Sequence[str]
) -> Iterator[tuple[int, dict[str, NDArray[Any]]]]:
    """Yield the number of the first row, and columns of `/entry/pulses/full`, part by part."""
    for start in range(first, stop, READ_ROWS):
        end = min(start + READ_ROWS, stop)
        yield start, {name: run.column(layout.PULSES.path, name, start, end) for name in names}


def _of_every_pulse(run: RunFile, edges_s: Array) -> Counts:
    edges = rows_at(run, edges_s)
    intervals = len(edges_s) - 1
    counts = np.zeros(4 * intervals, np.int64)
    for first, columns in pulse_blocks(run, int(edges[0]), int(edges[-1]), ("pulse_class",)):
        kind = columns["pulse_class"]
        ends = np.clip(edges, first, first + len(kind))
        interval = np.repeat(np.arange(intervals, dtype=np.int32), ends[1:] - ends[:-1])
        counts += np.bincount(4 * interval + (kind & 3), minlength=4 * intervals)
    return counts.reshape(-1, 4)


def _of_blocks(run: RunFile, edges_s: Array) -> Counts:
    intervals = len(edges_s) - 1
    counts = np.zeros((intervals, 4), np.int64)
    for block in run.blocks(layout.PULSE_BLOCKS.path, ("time", *_BLOCK_COUNTS)):
        interval = np.searchsorted(edges_s, block["time"], side="right") - 1
        within = (interval >= 0) & (interval < intervals)
        for k, name in enumerate(_BLOCK_COUNTS):
            weights = block[name][within].astype(np.float64)
            counts[:, k] += np.bincount(interval[within], weights, minlength=intervals).astype(np.int64)
    return counts
