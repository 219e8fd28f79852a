"""Displacement estimated from the actuator voltage beside that of the sensor, and the error of the estimate.

Like Figs 3, 7 and 9(b) of Muralidhara et al. 2009. The numbers are those of `/entry/results`.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from edmctl.record.events import RecordedState
from edmctl.record.reader import RunFile
from edmctl.report import style
from edmctl.report.signals import Columns, Envelope, Floats, envelopes, rows_worked, without_jumps
from edmctl.report.style import BLACK, BLUE, DASHED, GREY, SKY, VERMILION, NothingToDraw

SHORTED = 0.05
"""A gap voltage below this share of an open gap's is a short: nothing is machined, and the tool may retract."""
PERCENT_MM = 14.0
"""Room for the second axis of the error."""


def draw(run: RunFile) -> Figure:
    """Draw the figure, 85 mm wide. Raises NothingToDraw without a sensor or an estimate to compare."""
    rows = rows_worked(run)
    lines = envelopes(run, "/entry/servo", ["z_sensor", "z_model", "s", "state"], _derived, rows)
    if not lines or lines["error"].is_empty:
        raise NothingToDraw(_why_not(lines))
    sensor, model = lines["sensor"], lines["model"]
    unit_s, label = style.time_unit(float(sensor.time_s[-1] - sensor.time_s[0]))
    results = run.table("/entry/results")
    known = results[np.isfinite(results["err_feed_max"])]
    feed_um = float(known["feed"][0]) if len(known) == 1 else 0.0
    figure, (upper, lower) = style.panels(
        style.Block(label, {"displacement (µm)": 1.25, "error (µm)": 1.0}),
        right_mm=PERCENT_MM if feed_um > 0.0 else style.RIGHT_MM,
    )
    time = sensor.time_s / unit_s
    upper.plot(time, sensor.mean, color=GREY, linewidth=2.2, label="sensor")
    upper.plot(time, model.mean, color=BLUE, linestyle=DASHED, label="estimated from voltage")
    _draw_error(lower, lines, unit_s)
    if len(known):
        _write_errors(lower, known)
    if feed_um > 0.0:
        to_percent = (lambda um: um * 100.0 / feed_um, lambda percent: percent * feed_um / 100.0)
        percent = lower.secondary_yaxis("right", functions=to_percent)
        percent.set_ylabel("error (% of feed)")
        percent.yaxis.set_major_locator(MaxNLocator(5))
        percent.spines["right"].set_visible(True)
    lower.set_xlim(time[0], time[-1])
    style.legend_above(upper)
    style.legend_above(lower)
    return figure


def _derived(columns: Columns) -> dict[str, Floats]:
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


def _draw_error(axes: Axes, lines: Mapping[str, Envelope], unit_s: float) -> None:
    everything, steady = lines["error"], lines["steady error"]
    time = everything.time_s / unit_s
    axes.axhline(0.0, color=BLACK, linewidth=0.5)
    if everything.sampled:
        axes.plot(time, everything.mean, color=SKY, linewidth=0.6, label="all")
    else:
        axes.fill_between(
            time, everything.low, everything.high, color=SKY, alpha=0.7, linewidth=0.0, label="range"
        )
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
