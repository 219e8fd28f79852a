"""Signals of the gap servo: gap voltage and displacement over time, the error of the estimate, and spectra.

Displacement and error are drawn like Figs 3, 7 and 9(b) of Muralidhara et al. 2009.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np
from matplotlib import mlab
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from edmctl.array_types import Array
from edmctl.record.reader import RecordedState, RunFile
from edmctl.report import panels
from edmctl.report.panels import Block, legend_above, note_above
from edmctl.report.signals import (
    SERVO,
    Columns,
    Envelope,
    Floats,
    envelopes,
    floats,
    rows_worked,
    sampling_hz,
    spans_in,
    time_at,
    without_jumps,
)
from edmctl.report.style import (
    BLACK,
    BLUE,
    DASHED,
    GREEN,
    GREY,
    LIGHT,
    SKY,
    VERMILION,
    NothingToDraw,
    time_unit,
)
from edmctl.wording import plural

PALE = "#BDBDBD"
TOGETHER_S = 2.0
"""Touches with no more time between them are one grey band."""
PROBES, PROBE_ROWS = 60, 512
MIN_RATIO = 0.05
"""Below, a gap voltage over its share is mostly rounding."""
SPARKING = (RecordedState.APPROACH, RecordedState.MACHINING)
"""Elsewhere the generator is off, and the telemetry repeats the last gap voltage."""
SHORTED = 0.05
"""A gap voltage below this share of an open gap's is a short: nothing is machined, and the tool may retract."""
PERCENT_MM = 14.0
"""Room for the second axis of the error."""
UNFOLDED_HZ = 1000.0
"""Rate at which the controller measures."""
SETTLED_S = 0.3
"""Left out after a jump, until the servo has returned to its reference."""
LONGEST_S, SMALLEST = 16.0, 32
"""Longest segment of a spectrum; it resolves frequencies 0.1 Hz apart. Samples of the shortest."""
MOST_SEGMENTS = 200
"""Taken evenly over a long run: more change nothing that can be seen."""
PARTS = 12
"""Of an octave, over each of which a mean is drawn."""
Spectrum: TypeAlias = tuple[Array, Array]
"""Frequencies in Hz and power spectral density in unit² per Hz, ndarrays of shape (n,)."""


def draw_gap(run: RunFile) -> Figure:
    """Draw mean gap voltage with the servo's reference, and displacement. Raises NothingToDraw without any work."""
    rows = rows_worked(run)
    if rows[1] - rows[0] < 2:
        raise NothingToDraw(
            "The run ended before the first touch or cut, so there is no gap voltage yet; a run that gets "
            "further has it."
        )

    def derive(columns: Columns) -> dict[str, Floats]:
        sparking = np.isin(columns["state"], SPARKING)
        gap_v = np.where(sparking, columns["v_gap_avg"], np.float32(np.nan))
        return {"gap": gap_v, **_places(columns, "z_sensor")}

    place = "z_sensor"
    lines = envelopes(run, SERVO, ["v_gap_avg", place, "state"], derive, rows)
    if lines["all"].is_empty:
        place = "z_model"
        lines |= envelopes(run, SERVO, [place, "state"], lambda columns: _places(columns, place), rows)
    time_s = lines["gap"].time_s
    unit_s, label = time_unit(float(time_s[-1] - time_s[0]))
    block = Block(label, {"mean gap voltage (V)": 1.0, "tool displacement (µm)": 1.25})
    figure, (upper, lower) = panels.panels(block)
    for axes in (upper, lower):
        for begin_s, end_s in _touching_s(run, rows):
            label = "touching" if axes is upper else "_"
            axes.axvspan(begin_s / unit_s, end_s / unit_s, color=LIGHT, linewidth=0.0, label=label)
    _draw_voltage(upper, run, lines["gap"], rows, unit_s)
    _draw_tool(lower, lines, unit_s, "sensor" if place == "z_sensor" else "estimated")
    panels.mark_readings(lower, run.table("/entry/touches"), place, unit_s)
    lower.set_xlim(time_s[0] / unit_s, time_s[-1] / unit_s)
    for axes in (upper, lower):
        legend_above(axes)
    return figure


def _touching_s(run: RunFile, rows: tuple[int, int]) -> list[tuple[float, float]]:
    """Return begin and end of the times of touching; those with up to TOGETHER_S between them are one."""
    spans: list[tuple[float, float]] = []
    for span in spans_in(run, [RecordedState.TOUCH]):
        begin_s, end_s = (time_at(run, int(row)) for row in np.clip(span, rows[0], rows[1] - 1))
        if spans and begin_s - spans[-1][1] <= TOGETHER_S:
            begin_s = spans.pop()[0]
        spans.append((begin_s, end_s))
    return spans


def _places(columns: Columns, name: str) -> dict[str, Floats]:
    """Return the displacement without jumps, and with them."""
    all_um = columns[name].astype(np.float32, copy=False)
    return {"tool": without_jumps(all_um, columns["state"]), "all": all_um}


def _draw_voltage(axes: Axes, run: RunFile, gap: Envelope, rows: tuple[int, int], unit_s: float) -> None:
    if gap.is_empty:
        axes.text(0.5, 0.5, "no sparks in this run", transform=axes.transAxes, ha="center", color=GREY)
        return
    time = gap.time_s / unit_s
    if not gap.sampled:
        axes.fill_between(time, gap.low, gap.high, color=SKY, alpha=0.55, linewidth=0.0, label="range")
    axes.plot(time, gap.mean, color=BLUE, linewidth=0.7, label="mean" if not gap.sampled else "gap voltage")
    reference_v = _reference_v(run, gap.time_s, rows)
    if np.isfinite(reference_v).any():
        axes.plot(time, reference_v, color=BLACK, linestyle=(0, (3, 1.5)), label="reference")
    axes.set_ylim(0.0, 1.06 * float(np.nanmax(gap.high)))


def _reference_v(run: RunFile, time_s: Array, rows: tuple[int, int]) -> Array:
    """Return the servo's reference in volts at some times, NaN outside of cuts."""
    reference_v = np.full(len(time_s), np.nan)
    slow_s, share = floats(run, "/entry/slow", ("time", "s_ref")).values()
    open_s, open_v = _open_gap(run, rows)
    if not len(slow_s) or not len(open_s):
        return reference_v
    nearest = np.clip(np.searchsorted(slow_s, time_s), 0, len(slow_s) - 1)
    # Rows come at least twice a second while cutting: a second without one is a pause.
    cutting = np.abs(slow_s[nearest] - time_s) <= max(1.0, 2.0 * float(np.median(np.diff(time_s))))
    scale_v = open_v[np.clip(np.searchsorted(open_s, time_s), 0, len(open_s) - 1)]
    reference_v[cutting] = (share[nearest] * scale_v)[cutting]
    return reference_v


def _open_gap(run: RunFile, rows: tuple[int, int]) -> tuple[Array, Array]:
    """Return times and, at each, the mean voltage of an open gap, of which the reference is a share.

    It changes only with the duty factor, so PROBES places are enough.
    """
    times, volts = [], []
    for start in np.unique(np.linspace(rows[0], max(rows[0], rows[1] - PROBE_ROWS), PROBES, dtype=np.int64)):
        part = (int(start), min(int(start) + PROBE_ROWS, rows[1]))
        names = ("v_gap_avg", "s", "state", "time")
        gap_v, ratio, state, time_s = floats(run, SERVO, names, part).values()
        known = np.isin(state, SPARKING) & (ratio > MIN_RATIO)
        if known.any():
            times.append(float(time_s[known].mean()))
            volts.append(float(np.median(gap_v[known] / ratio[known])))
    return np.array(times), np.array(volts)


def _draw_tool(axes: Axes, lines: Mapping[str, Envelope], unit_s: float, name: str) -> None:
    tool, everything = lines["tool"], lines["all"]
    time = tool.time_s / unit_s
    resting_um = np.where(np.isnan(tool.low), np.inf, tool.low)
    jumps = np.isfinite(everything.low) & ~(everything.low >= resting_um - 0.5)
    if jumps.any():
        low_um, top_um = (
            everything.low[jumps],
            np.where(np.isnan(tool.mean), everything.high, tool.mean)[jumps],
        )
        axes.vlines(time[jumps], low_um, top_um, color=PALE, linewidth=0.5, label="jump")
    if not tool.sampled:
        axes.fill_between(time, tool.low, tool.high, color=BLUE, linewidth=0.0)
    axes.plot(time, tool.mean, color=BLUE, linewidth=0.9, label=name)


def draw_displacement(run: RunFile) -> Figure:
    """Draw the displacement by the actuator's voltage beside that of the sensor, and its error.

    Raises NothingToDraw without a sensor or an estimate to compare.
    """
    lines = envelopes(run, SERVO, ["z_sensor", "z_model", "s", "state"], _compared, rows_worked(run))
    if not lines or lines["error"].is_empty:
        raise NothingToDraw(_why_not(lines))
    sensor, model = lines["sensor"], lines["model"]
    unit_s, label = time_unit(float(sensor.time_s[-1] - sensor.time_s[0]))
    results = run.table("/entry/results")
    known = results[np.isfinite(results["err_feed_max"])]
    feed_um = float(known["feed"][0]) if len(known) == 1 else 0.0
    figure, (upper, lower) = panels.panels(
        Block(label, {"displacement (µm)": 1.25, "error (µm)": 1.0}),
        right_mm=PERCENT_MM if feed_um > 0.0 else panels.RIGHT_MM,
    )
    time = sensor.time_s / unit_s
    upper.plot(time, sensor.mean, color=GREY, linewidth=2.2, label="sensor")
    upper.plot(time, model.mean, color=BLUE, linestyle=DASHED, label="estimated from voltage")
    _draw_error(lower, time, lines["error"], lines["steady error"])
    if len(known):
        _write_errors(lower, known)
    if feed_um > 0.0:
        to_percent = (lambda um: um * 100.0 / feed_um, lambda percent: percent * feed_um / 100.0)
        percent = lower.secondary_yaxis("right", functions=to_percent)
        percent.set_ylabel("error (% of feed)")
        percent.yaxis.set_major_locator(MaxNLocator(5))
        percent.spines["right"].set_visible(True)
    lower.set_xlim(time[0], time[-1])
    for axes in (upper, lower):
        legend_above(axes)
    return figure


def _compared(columns: Columns) -> dict[str, Floats]:
    state = columns["state"]
    sensor_um = columns["z_sensor"].astype(np.float32, copy=False)
    model_um = columns["z_model"].astype(np.float32, copy=False)
    error_um = model_um - sensor_um
    sparking = (state == RecordedState.MACHINING) & (columns["s"].astype(np.float32, copy=False) > SHORTED)
    return {
        "sensor": without_jumps(sensor_um, state),
        "model": without_jumps(model_um, state),
        "error": error_um,
        "steady error": np.where(sparking, error_um, np.float32(np.nan)),
    }


def _why_not(lines: Mapping[str, Envelope]) -> str:
    if not lines:
        return (
            "The run ended before the first touch or cut, so there is nothing to compare; a run that gets "
            "further has it."
        )
    if lines["sensor"].is_empty:
        return "The run has no displacement sensor to compare the estimate with; on a machine with one it is drawn."
    return "The run has no displacement estimated from the voltage; a conditioned or calibrated actuator has one."


def _draw_error(axes: Axes, time: Array, everything: Envelope, steady: Envelope) -> None:
    axes.axhline(0.0, color=BLACK, linewidth=0.5)
    if everything.sampled:
        axes.plot(time, everything.mean, color=SKY, linewidth=0.6, label="all")
    else:
        low_um, high_um = everything.low, everything.high
        axes.fill_between(time, low_um, high_um, color=SKY, alpha=0.7, linewidth=0.0, label="range")
    if not steady.is_empty:
        axes.plot(time, steady.mean, color=VERMILION, label="machining, mean")
    axes.locator_params(axis="y", nbins=6)


def _write_errors(axes: Axes, known: NDArray[np.void]) -> None:
    """Write the errors of the results at the foot of the panel, in room that is made for them."""
    rms_um, rms_pct, max_um, max_pct = (
        float(known[f"err_feed_{name}"].max()) for name in ("rms", "rms_pct", "max", "max_pct")
    )
    several = f"largest of {len(known)} holes: " if len(known) > 1 else ""
    text = f"{several}rms {rms_um:.2f} µm ({rms_pct:.2g} %)\nmax {max_um:.2f} µm ({max_pct:.2g} % of feed)"
    low, high = axes.get_ylim()
    axes.set_ylim(low - 0.4 * (high - low), high)
    axes.text(0.02, 0.03, text, transform=axes.transAxes, va="bottom", fontsize=6.0)


def draw_spectrum(run: RunFile) -> Figure:
    """Draw power spectral densities of gap voltage and displacement while machining, without jumps.

    A relay servo oscillates about its reference: its limit cycle is a peak. The controller measures every
    millisecond; where fewer rows are recorded, what is faster than half their rate is folded in, and the figure says
    so. Raises NothingToDraw if no part of machining is long enough.
    """
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

    def of_column(name: str) -> Spectrum | None:
        segments = (run.column(SERVO, name, start, start + size).astype(np.float64) for start in starts)
        known = [segment for segment in segments if np.isfinite(segment).all()]
        return welch(known, rate_hz) if known else None

    tool, of_tool = of_column("z_sensor"), "displacement (nm²/Hz)"
    if tool is None:  # no sensor
        tool, of_tool = of_column("v_cmd"), "actuator voltage (mV²/Hz)"
    labels = (f"power density of\n{what}" for what in ("gap voltage (mV²/Hz)", of_tool))
    figure, (upper, lower) = panels.panels(Block("frequency (Hz)", dict.fromkeys(labels, 1.2)))
    for axes, spectrum, colour in ((upper, of_column("v_gap_avg"), BLUE), (lower, tool, GREEN)):
        if spectrum is not None:
            _draw_density(axes, spectrum, colour)
    note_above(upper, f"{plural(len(starts), 'segment')} of {size / rate_hz:.3g} s, {rate_hz:.4g} Hz")
    if rate_hz < 0.9 * UNFOLDED_HZ:
        note_above(lower, f"faster than {0.5 * rate_hz:.3g} Hz: folded in")
    panels.shared_legend(figure, (upper,))
    return figure


def _parts_of_machining(run: RunFile, rate_hz: float) -> list[tuple[int, int]]:
    """Return the rows of machining without jumps and without missing samples, after the servo has settled."""
    parts: list[tuple[int, int]] = []
    for first, stop in spans_in(run, [RecordedState.MACHINING]).tolist():
        time_s = run.column(SERVO, "time", first, stop).astype(np.float64)
        # A missing sample ends a part: the one after it does not count.
        missing = first + 1 + np.flatnonzero(np.diff(time_s) * rate_hz > 1.5)
        parts += zip([first, *(missing + 1)], [*missing, stop], strict=True)
    settled = round(SETTLED_S * rate_hz)
    return [(first + settled, stop) for first, stop in parts if stop - first > settled + SMALLEST]


def segment_size(lengths: list[int], rate_hz: float) -> int:
    """Return how many samples a segment has: a power of two that half of the samples allow; 0 without any."""
    if not lengths:
        return 0
    ordered = np.sort(np.array(lengths))
    median = int(ordered[np.searchsorted(np.cumsum(ordered), 0.5 * ordered.sum())])
    longest = min(median, LONGEST_S * rate_hz)
    return int(2 ** np.floor(np.log2(longest))) if longest >= SMALLEST else 0


def welch(segments: Sequence[Array], rate_hz: float) -> Spectrum:
    """Return the mean one-sided power spectral density of segments of equal length (Welch 1967).

    Each segment loses its straight line and has a Hann window.
    """
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


def _draw_density(axes: Axes, spectrum: Spectrum, colour: str) -> None:
    """Draw densities of µm and V in nm² and mV²."""
    frequency_hz, density = spectrum[0], 1e6 * spectrum[1]
    axes.loglog(frequency_hz, density, color=colour, alpha=0.35, linewidth=0.5, label="each frequency")
    means = octave_means(frequency_hz, density)
    axes.loglog(*means, color=colour, linewidth=0.9, label=f"mean over 1/{PARTS} octave")
    axes.set_xlim(frequency_hz[0], frequency_hz[-1])
    low, high = axes.get_ylim()
    if high < 20.0 * low:
        panels.plain_log_ticks(axes.yaxis)
