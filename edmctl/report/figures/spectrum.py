"""Power spectral density of gap voltage and displacement while machining, without jumps.

A relay servo swings about its reference: its limit cycle is a peak. The estimate is that of Welch (1967): half
overlapping segments with a Hann window, each freed from its straight line, and averaged.

The controller measures every millisecond. Where fewer rows are recorded they are single samples, without a low-pass:
what is faster than half their rate is folded into the spectrum, and the figure says so.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from edmctl.dataclasses import dataclass
from edmctl.record.events import RecordedState
from edmctl.report.signals import BLOCK_ROWS, Spans, sampling_hz
from edmctl.report.style import (
    BLACK,
    BLUE,
    GREEN,
    NothingToDraw,
    letter_panels,
    new_figure,
    shared_legend,
)
from edmctl.wording import plural

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike, NDArray

    from edmctl.array_types import Array
    from edmctl.record.reader import RunFile

    Rows = tuple[int, int]

HEIGHT_MM = 96.0
UNFOLDED_HZ = 1000.0
"""How often the controller measures."""
SETTLED_S = 0.3
"""Left out after a jump, until the servo has found back."""
LONGEST_S = 16.0
SMALLEST = 32
"""Samples of a segment."""
MOST_SEGMENTS = 200
"""Taken evenly over a long run: more change nothing that can be seen."""
STANDS_OUT = 4.0
"""A peak is marked from so many times its neighbourhood on (6 dB)."""
SCATTER = 3.0
"""A mean of few segments scatters: its peaks must be so many relative standard deviations higher."""
TINY = float(np.finfo(float).tiny)
OCTAVE = 2.0
PARTS = 12
LINE_WIDTH = 1.1
"""A narrow line is looked for among the frequencies within this factor."""


@dataclass(frozen=True, slots=True)
class Spectrum:
    """Power spectral density: ndarrays of shape (n,), Hz and unit² per Hz, without the mean."""

    frequency_hz: Array
    density: Array
    averaged: int
    """Segments that it is the mean of."""


def draw(run: RunFile) -> Figure:
    """Draw the figure, 85 mm wide. Raises NothingToDraw where no part of machining is long enough."""
    rate_hz = sampling_hz(run)
    parts = _parts_of_machining(run, rate_hz)
    size = segment_size([stop - first for first, stop in parts], rate_hz)
    if not size:
        raise NothingToDraw(
            "No part of machining between two jumps is long enough for a spectrum; a longer cut has one, "
            "and `log.servo_hz` = 1000 makes it finer."
        )
    segments = _segments(parts, size)
    figure = new_figure(HEIGHT_MM)
    upper, lower = figure.subplots(2, 1, sharex=True)
    gap = _welch(run, "v_gap_avg", segments, size, rate_hz)
    tool = _welch(run, "z_sensor", segments, size, rate_hz)
    name = "displacement"
    if tool is None:
        tool, name = _welch(run, "v_cmd", segments, size, rate_hz), "actuator voltage"
    _draw_density(upper, gap, BLUE, "gap voltage", "V")
    _draw_density(lower, tool, GREEN, name, "µm" if name == "displacement" else "V")
    lower.set_xlabel("frequency (Hz)")
    letter_panels((upper, lower))
    upper.set_title(
        f"{plural(len(segments), 'segment')} of {size / rate_hz:.3g} s, {rate_hz:.4g} Hz",
        loc="right",
        pad=2.0,
    )
    if rate_hz < 0.9 * UNFOLDED_HZ:
        lower.set_title(f"faster than {0.5 * rate_hz:.3g} Hz: folded in", loc="right", pad=2.0)
    shared_legend(figure, (upper,))
    figure.align_ylabels()
    return figure


def _parts_of_machining(run: RunFile, rate_hz: float) -> list[Rows]:
    """Return the rows of machining without jumps and without holes in time, after the servo has settled."""
    machining = Spans([RecordedState.MACHINING])
    rows = 0
    last_s = np.nan
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

    Segments of LONGEST_S tell frequencies apart that are 0.1 Hz from each other.
    """
    if not lengths:
        return 0
    ordered = np.sort(np.array(lengths))
    median = int(ordered[np.searchsorted(np.cumsum(ordered), 0.5 * ordered.sum())])
    longest = min(median, LONGEST_S * rate_hz)
    return int(2 ** np.floor(np.log2(longest))) if longest >= SMALLEST else 0


def _segments(parts: list[Rows], size: int) -> list[int]:
    starts = [start for first, stop in parts for start in range(first, stop - size + 1, size // 2)]
    if len(starts) <= MOST_SEGMENTS:
        return starts
    return [starts[k] for k in np.linspace(0, len(starts) - 1, MOST_SEGMENTS, dtype=np.int64)]


def _welch(run: RunFile, name: str, starts: list[int], size: int, rate_hz: float) -> Spectrum | None:
    """Return the mean spectrum of one column; None where no segment is known throughout (no sensor)."""
    known = (run.column("/entry/servo", name, start, start + size).astype(np.float64) for start in starts)
    return welch((segment for segment in known if np.isfinite(segment).all()), size, rate_hz)


def welch(segments: Iterable[Array], size: int, rate_hz: float) -> Spectrum | None:
    """Return the mean one-sided power spectral density of segments of `size` samples; None without any."""
    window = np.hanning(size + 1)[:-1]
    ramp = np.linspace(-1.0, 1.0, size)
    powers = np.zeros(size // 2 + 1)
    count = 0
    for segment in segments:
        level = segment - segment.mean()
        level = level - ramp * (ramp @ level) / (ramp @ ramp)
        powers += np.abs(np.fft.rfft(window * level)) ** 2
        count += 1
    if not count:
        return None
    density: Array = 2.0 * powers / (count * rate_hz * float(window @ window))
    density[-1] /= 2.0  # the highest frequency has no mirror image
    return Spectrum(np.arange(1.0, size // 2 + 1) * (rate_hz / size), density[1:], count)


def peak_hz(spectrum: Spectrum) -> float | None:
    """Return the frequency that stands out most from an octave to both sides; None where none does."""
    frequency_hz, density = spectrum.frequency_hz, spectrum.density
    here = np.arange(len(frequency_hz))
    low = np.searchsorted(frequency_hz, frequency_hz / OCTAVE)
    high = np.searchsorted(frequency_hz, frequency_hz * OCTAVE, side="right")
    # The line that was taken out of every segment leaves nothing to tell in its lowest frequencies.
    peaked = (density >= np.roll(density, 1)) & (density >= np.roll(density, -1))
    inside = here[
        peaked & (frequency_hz >= 4.0 * frequency_hz[0]) & (frequency_hz * OCTAVE <= frequency_hz[-1])
    ]
    if not len(inside):
        return None
    # The geometric mean of both sides is on the slope, however steep it is.
    around = [np.sqrt(np.median(density[low[k] : k]) * np.median(density[k + 1 : high[k]])) for k in inside]
    return _standing_out(spectrum, inside, around)


def line_hz(spectrum: Spectrum) -> float | None:
    """Return the frequency of the strongest narrow line: something periodic, and no swing of the servo."""
    frequency_hz, density = spectrum.frequency_hz, spectrum.density
    low = np.searchsorted(frequency_hz, frequency_hz / LINE_WIDTH)
    high = np.searchsorted(frequency_hz, frequency_hz * LINE_WIDTH, side="right")
    inside = np.flatnonzero(high - low >= 2 * SMALLEST)
    if not len(inside):
        return None
    return _standing_out(spectrum, inside, [np.median(density[low[k] : high[k]]) for k in inside])


def _standing_out(spectrum: Spectrum, inside: NDArray[np.int64], around: ArrayLike) -> float | None:
    """Return the frequency that is highest above the density `around` it, shape (n,); None where all are too low."""
    excess = spectrum.density[inside] / np.maximum(around, TINY)
    best = int(np.argmax(excess))
    enough = STANDS_OUT * (1.0 + SCATTER / np.sqrt(spectrum.averaged))
    return float(spectrum.frequency_hz[inside[best]]) if excess[best] >= enough else None


def octave_means(spectrum: Spectrum) -> tuple[Array, Array]:
    """Return frequencies and densities averaged over parts of an octave, of which there are PARTS."""
    part = np.floor(np.log2(spectrum.frequency_hz) * PARTS).astype(np.int64)
    starts = np.flatnonzero(np.diff(part, prepend=part[0] - 1))
    counts = np.diff(starts, append=len(part))
    frequency_hz = np.exp(np.add.reduceat(np.log(spectrum.frequency_hz), starts) / counts)
    return frequency_hz, np.add.reduceat(spectrum.density, starts) / counts


def _draw_density(axes: Axes, spectrum: Spectrum | None, colour: str, name: str, unit: str) -> None:
    axes.set_ylabel(f"power spectral density\nof {name} ({unit}²/Hz)")
    if spectrum is None:
        return
    axes.loglog(
        spectrum.frequency_hz, spectrum.density, color=colour, alpha=0.35, linewidth=0.5,
        label="each frequency",
    )  # fmt: skip
    axes.loglog(*octave_means(spectrum), color=colour, linewidth=0.9, label=f"mean over 1/{PARTS} octave")
    axes.set_xlim(spectrum.frequency_hz[0], spectrum.frequency_hz[-1])
    marked = {peak_hz(spectrum): 3.0, line_hz(spectrum): -3.0}
    for found_hz, shift in marked.items():
        if found_hz is not None:
            _mark(axes, found_hz, shift)


def _mark(axes: Axes, found_hz: float, shift: float) -> None:
    """Write a frequency beside its line, to the right of it or to the left."""
    axes.axvline(found_hz, color=BLACK, linewidth=0.6, linestyle=(0, (1.5, 1.5)), zorder=0.5)
    axes.annotate(
        f"{found_hz:.3g} Hz", (found_hz, 1.0), xycoords=("data", "axes fraction"), xytext=(shift, -2.0),
        textcoords="offset points", ha="left" if shift > 0.0 else "right", va="top", fontsize=6.5,
    )  # fmt: skip
