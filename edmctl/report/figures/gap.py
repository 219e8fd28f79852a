"""Mean gap voltage with the servo's reference, and the tool displacement, against time.

The displacement is that of Fig. 7 of Muralidhara et al. 2009; the voltage is the input of their servo.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from edmctl.array_types import Array
from edmctl.record.events import RecordedState
from edmctl.record.reader import RunFile
from edmctl.report import style
from edmctl.report.signals import (
    Columns,
    Envelope,
    Floats,
    Spans,
    envelopes,
    floats,
    in_states,
    rows_worked,
    without_jumps,
)
from edmctl.report.style import BLACK, BLUE, GREY, LIGHT, SKY, NothingToDraw

PALE = "#BDBDBD"
PROBES, PROBE_ROWS = 60, 512
MIN_RATIO = 0.05
"""Below, a gap voltage over its share is mostly rounding."""
SPARKING = (RecordedState.APPROACH, RecordedState.MACHINING)
"""Elsewhere the generator is off, and the telemetry repeats the last gap voltage."""


def draw(run: RunFile) -> Figure:
    """Draw the figure, 85 mm wide. Raises NothingToDraw if the run has no touch, approach or cut."""
    rows = rows_worked(run)
    if rows[1] - rows[0] < 2:
        raise NothingToDraw(
            "The run ended before the first touch or cut, so there is no gap voltage yet; a run that gets "
            "further has it."
        )
    touching = Spans([RecordedState.TOUCH])

    def derive(columns: Columns) -> dict[str, Floats]:
        state = columns["state"]
        touching.take(columns["time"], state)
        gap_v = in_states(columns["v_gap_avg"], state, SPARKING)
        return {"gap": gap_v, **_places(columns, "z_sensor")}

    lines = envelopes(run, "/entry/servo", ["v_gap_avg", "z_sensor", "state"], derive, rows)
    place = "z_sensor"
    if lines["all"].is_empty:
        place = "z_model"
        lines |= envelopes(
            run, "/entry/servo", [place, "state"], lambda columns: _places(columns, place), rows
        )
    time_s = lines["gap"].time_s
    unit_s, label = style.time_unit(float(time_s[-1] - time_s[0]))
    figure, (upper, lower) = style.panels(
        style.Block(label, {"mean gap voltage (V)": 1.0, "tool displacement (µm)": 1.25})
    )
    for axes in (upper, lower):
        for begin_s, end_s in touching.joined(within_s=2.0):
            axes.axvspan(
                begin_s / unit_s, end_s / unit_s, color=LIGHT, linewidth=0.0,
                label="touching" if axes is upper else "_",
            )  # fmt: skip
    _draw_voltage(upper, run, lines["gap"], rows, unit_s)
    _draw_tool(lower, run, lines, unit_s, place)
    lower.set_xlim(time_s[0] / unit_s, time_s[-1] / unit_s)
    for axes in (upper, lower):
        style.legend_above(axes)
    return figure


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
        gap_v, ratio, state, time_s = floats(run, "/entry/servo", names, part).values()
        known = np.isin(state, SPARKING) & (ratio > MIN_RATIO)
        if known.any():
            times.append(float(time_s[known].mean()))
            volts.append(float(np.median(gap_v[known] / ratio[known])))
    return np.array(times), np.array(volts)


def _draw_tool(axes: Axes, run: RunFile, lines: Mapping[str, Envelope], unit_s: float, place: str) -> None:
    tool, everything = lines["tool"], lines["all"]
    time = tool.time_s / unit_s
    resting_um = np.where(np.isnan(tool.low), np.inf, tool.low)
    jumps = np.isfinite(everything.low) & ~(everything.low >= resting_um - 0.5)
    if jumps.any():
        top_um = np.where(np.isnan(tool.mean), everything.high, tool.mean)
        axes.vlines(
            time[jumps], everything.low[jumps], top_um[jumps], color=PALE, linewidth=0.5, label="jump"
        )
    if not tool.sampled:
        axes.fill_between(time, tool.low, tool.high, color=BLUE, linewidth=0.0)
    name = "sensor" if place == "z_sensor" else "estimated"
    axes.plot(time, tool.mean, color=BLUE, linewidth=0.9, label=name)
    style.mark_readings(axes, run.table("/entry/touches"), place, unit_s)
