"""Power spectral density of gap voltage and displacement while machining, without jumps.

A relay servo oscillates about its reference: its limit cycle is a peak. The estimate is that of Welch (1967): half
overlapping segments with a Hann window, each without its straight line, and averaged.

The controller measures every millisecond. Where fewer rows are recorded they are single samples, without a low-pass:
what is faster than half their rate is folded into the spectrum, and the figure says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from matplotlib import mlab
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from edmctl.array_types import Array
from edmctl.record.events import RecordedState
from edmctl.record.reader import RunFile
from edmctl.report import style
from edmctl.report.signals import BLOCK_ROWS, Spans, sampling_hz
from edmctl.report.style import BLUE, GREEN, NothingToDraw
from edmctl.wording import plural

UNFOLDED_HZ = 1000.0
"""Rate at which the controller measures."""
SETTLED_S = 0.3
"""Left out after a jump, until the servo has returned to its reference."""
LONGEST_S = 16.0
SMALLEST = 32
"""Samples of a segment."""
MOST_SEGMENTS = 200
"""Taken evenly over a long run: more change nothing that can be seen."""
PARTS = 12
"""Of an octave, over each of which a mean is drawn."""
Spectrum: TypeAlias = tuple[Array, Array]
"""Frequencies in Hz and power spectral density in unit² per Hz, ndarrays of shape (n,)."""


def draw(run: RunFile) -> Figure:
    """Draw the figure, 85 mm wide. Raises NothingToDraw if no part of machining is long enough."""
    rate_hz = sampling_hz(run)
    parts = _parts_of_machining(run, rate_hz)
    size = segment_size([stop - first for first, stop in parts], rate_hz)
    if not size:
        raise NothingToDraw(
            "No part of machining between two jumps is long enough for a spectrum; a longer cut has one, "
            "and `log.servo_hz` = 1000 makes it finer."
        )
    starts = [start for first, stop in parts for start in range(first, stop - size + 1, size // 2)]
    if len(starts) > MOST_SEGMENTS:
        starts = [starts[k] for k in np.linspace(0, len(starts) - 1, MOST_SEGMENTS, dtype=np.int64)]
    gap, tool = (_of_column(run, name, starts, size, rate_hz) for name in ("v_gap_avg", "z_sensor"))
    name, unit = "displacement", "µm"
    if tool is None:
        tool, name, unit = _of_column(run, "v_cmd", starts, size, rate_hz), "actuator voltage", "V"
    labels = (f"power density of\n{what} ({per}²/Hz)" for what, per in (("gap voltage", "V"), (name, unit)))
    figure, (upper, lower) = style.panels(
        style.Block("frequency (Hz)", dict.fromkeys(labels, 1.2)), left_mm=18.5, label_mm=11.5
    )
    _draw_density(upper, gap, BLUE)
    _draw_density(lower, tool, GREEN)
    style.note_above(upper, f"{plural(len(starts), 'segment')} of {size / rate_hz:.3g} s, {rate_hz:.4g} Hz")
    if rate_hz < 0.9 * UNFOLDED_HZ:
        style.note_above(lower, f"faster than {0.5 * rate_hz:.3g} Hz: folded in")
    style.shared_legend(figure, (upper,))
    return figure


def _parts_of_machining(run: RunFile, rate_hz: float) -> list[tuple[int, int]]:
    """Return the rows of machining without jumps and without missing samples, after the servo has settled."""
    machining = Spans([RecordedState.MACHINING])
    rows, last_s = 0, np.nan
    for block in run.blocks("/entry/servo", ["time", "state"], BLOCK_ROWS):
        time_s, state = block["time"].astype(np.float64), block["state"].copy()
        # A missing sample ends a part: the one after it does not count.
        state[np.diff(time_s, prepend=last_s) * rate_hz > 1.5] = RecordedState.JUMP
        machining.take(np.arange(rows, rows + len(state)), state)
        rows += len(state)
        last_s = float(time_s[-1])
    settled = round(SETTLED_S * rate_hz)
    return [
        (int(first) + settled, int(stop))
        for first, stop in machining.joined()
        if stop - first > settled + SMALLEST
    ]


def segment_size(lengths: list[int], rate_hz: float) -> int:
    """Return how many samples a segment has: a power of two that half of the samples allow; 0 without any.

    Segments of LONGEST_S resolve frequencies that are 0.1 Hz apart.
    """
    if not lengths:
        return 0
    ordered = np.sort(np.array(lengths))
    median = int(ordered[np.searchsorted(np.cumsum(ordered), 0.5 * ordered.sum())])
    longest = min(median, LONGEST_S * rate_hz)
    return int(2 ** np.floor(np.log2(longest))) if longest >= SMALLEST else 0


def _of_column(run: RunFile, name: str, starts: list[int], size: int, rate_hz: float) -> Spectrum | None:
    """Return the mean spectrum of one column; None if no segment is known throughout (no sensor)."""
    parts = (run.column("/entry/servo", name, start, start + size).astype(np.float64) for start in starts)
    known = [part for part in parts if np.isfinite(part).all()]
    return welch(known, rate_hz) if known else None


def welch(segments: Sequence[Array], rate_hz: float) -> Spectrum:
    """Return the frequencies and the mean one-sided power spectral density of segments of equal length."""
    size = len(segments[0])
    densities = [
        np.asarray(mlab.psd(one, size, rate_hz, detrend="linear")[0], np.float64) for one in segments
    ]
    return np.arange(1.0, size // 2 + 1) * (rate_hz / size), np.mean(densities, axis=0)[1:]


def octave_means(frequency_hz: Array, density: Array) -> Spectrum:
    """Return frequencies and densities averaged over the PARTS of each octave."""
    part = np.floor(np.log2(frequency_hz) * PARTS).astype(np.int64)
    starts = np.flatnonzero(np.diff(part, prepend=part[0] - 1))
    counts = np.diff(starts, append=len(part))
    means_hz = np.exp(np.add.reduceat(np.log(frequency_hz), starts) / counts)
    return means_hz, np.add.reduceat(density, starts) / counts


def _draw_density(axes: Axes, spectrum: Spectrum | None, colour: str) -> None:
    if spectrum is None:
        return
    frequency_hz, density = spectrum
    axes.loglog(frequency_hz, density, color=colour, alpha=0.35, linewidth=0.5, label="each frequency")
    axes.loglog(*octave_means(*spectrum), color=colour, linewidth=0.9, label=f"mean over 1/{PARTS} octave")
    axes.set_xlim(frequency_hz[0], frequency_hz[-1])
    low, high = axes.get_ylim()
    if high < 20.0 * low:
        style.plain_log_ticks(axes.yaxis)
