"""Ringing after steps of the voltage: a narrow line in what a model misses, which decays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from edmctl.actuator.record import Record
from edmctl.array_types import Array, Flags

STEP_SHARE, STEP_SAMPLES = 0.05, 8
"""A step moves the voltage by this share of its span within so many samples."""
FEWEST_STEPS = 3
WINDOW, SHORTEST_WINDOW = 128, 24  # samples after a step that are looked at, fewer where steps follow sooner
LOWEST_CYCLES = 3  # a line has this many cycles in a window
LINE_BINS = 2  # on either side of a line, that belong to it
LINE_SHARE = 0.5  # of the squares after steps, that are in a line
DECAY_FACTOR = 2.0  # the line's squares in a window are at least this many times those in the next one


class Ringing(NamedTuple):
    """A resonance: its frequency, its largest amplitude, and the samples after steps of each record."""

    frequency_hz: float
    amplitude_um: float
    after_steps: tuple[Flags, ...]


def ringing_of(
    records: Sequence[Record], residuals_um: Sequence[Array], used: Sequence[Flags]
) -> Ringing | None:
    """Return the resonance in what a model misses of records, shape (n,) each; None if there is none."""
    found = [
        one
        for record, left_um, counts in zip(records, residuals_um, used, strict=True)
        if (one := _line(record, left_um, counts)) is not None
    ]
    if not found:
        return None
    strongest = max(found, key=lambda one: one[1])
    after = []
    for record, counts in zip(records, used, strict=True):
        mask = np.zeros(len(record.t_s), dtype=np.bool_)
        ends, length = _steps(record, counts)
        for end in ends:
            mask[max(0, end - STEP_SAMPLES) : end + 2 * length] = True
        after.append(mask)
    return Ringing(*strongest, tuple(after))


def _line(record: Record, left_um: Array, counts: Flags) -> tuple[float, float] | None:
    """Frequency and amplitude of a decaying line after the steps of a record."""
    ends, length = _steps(record, counts)
    if len(ends) < FEWEST_STEPS:
        return None
    after = _spectrum([left_um[end : end + length] for end in ends])
    later = _spectrum([left_um[end + length : end + 2 * length] for end in ends])
    k = LOWEST_CYCLES + int(np.argmax(after[LOWEST_CYCLES:]))
    line = slice(max(1, k - LINE_BINS), k + LINE_BINS + 1)
    in_line = float(after[line].sum())
    if in_line < LINE_SHARE * float(after.sum()) or in_line < DECAY_FACTOR * float(later[line].sum()):
        return None
    low, here, high = (float(after[n]) if n < len(after) else 0.0 for n in (k - 1, k, k + 1))
    centre = k + (high - low) / (low + here + high)
    amplitude_um = max(float(np.abs(left_um[end : end + length]).max()) for end in ends)
    return centre / (length * float(np.median(np.diff(record.t_s)))), amplitude_um


def _spectrum(windows_um: Sequence[Array]) -> Array:
    """Return the mean squares by frequency of windows of one length, without their straight lines."""
    values = np.array(windows_um)
    along = np.linspace(-1.0, 1.0, values.shape[1])
    values = values - values.mean(axis=1, keepdims=True)
    values = values - np.outer(values @ along / (along @ along), along)
    squares: Array = (np.abs(np.fft.rfft(values, axis=1)) ** 2).mean(axis=0)
    return squares


def _steps(record: Record, counts: Flags) -> tuple[list[int], int]:
    """Return the samples at which steps have ended, and half the samples that are free of the next step."""
    least_v = STEP_SHARE * float(np.ptp(record.u_v))
    moved_v = np.abs(np.diff(record.u_v))
    is_fast = moved_v > least_v / STEP_SAMPLES
    edges = np.flatnonzero(np.diff(np.concatenate([[False], is_fast, [False]]).astype(int)))
    begins, ends = edges[::2], edges[1::2]
    free = np.append(begins[1:], len(record.u_v)) - ends
    kept = (ends - begins <= STEP_SAMPLES) & (free >= 2 * SHORTEST_WINDOW) & counts[ends]
    kept &= np.abs(record.u_v[ends] - record.u_v[begins]) >= least_v
    if not kept.any():
        return [], 0
    return ends[kept].tolist(), int(min(WINDOW, free[kept].min() // 2))
