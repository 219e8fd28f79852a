"""Displacement estimated from the actuator voltage beside that of the sensor, and the error of the estimate.

Like Figs 3, 7 and 9(b) of Muralidhara et al. 2009. The numbers are those of `/entry/results`, where there are some.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from edmctl.record.events import RecordedState
from edmctl.report.signals import Envelope, envelopes, rows_worked, without_jumps
from edmctl.report.style import (
    BLACK,
    BLUE,
    DASHED,
    GREY,
    SKY,
    VERMILION,
    NothingToDraw,
    legend_above,
    letter_panels,
    new_figure,
    time_unit,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from edmctl.record.reader import RunFile
    from edmctl.report.signals import Columns, Floats

HEIGHT_MM = 84.0
SHORTED = 0.05
"""A gap voltage below this share of an open gap's is a short: nothing is machined, and the tool may retract."""


def draw(run: RunFile) -> Figure:
    """Draw the figure, 85 mm wide. Raises NothingToDraw without a sensor or an estimate to compare."""
    rows = rows_worked(run)

    def derive(columns: Columns) -> dict[str, Floats]:
        state = columns["state"]
        sensor_um = columns["z_sensor"].astype(np.float32, copy=False)
        model_um = columns["z_model"].astype(np.float32, copy=False)
        error_um = model_um - sensor_um
        sparking = (state == RecordedState.MACHINING) & (
            columns["s"].astype(np.float32, copy=False) > SHORTED
        )
        return {
            "sensor": without_jumps(sensor_um, state),
            "model": without_jumps(model_um, state),
            "error": error_um,
            "steady error": np.where(sparking, error_um, np.float32(np.nan)),
        }

    lines = envelopes(run, "/entry/servo", ["z_sensor", "z_model", "s", "state"], derive, rows)
    if not lines or lines["error"].is_empty:
        raise NothingToDraw(_why_not(lines))
    figure = new_figure(HEIGHT_MM)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[1.35, 1.0])
    time_s = lines["sensor"].time_s
    unit_s, label = time_unit(float(time_s[-1] - time_s[0]))
    _line(upper, lines["sensor"], unit_s, GREY, 2.2, "-", "sensor")
    _line(upper, lines["model"], unit_s, BLUE, 0.8, DASHED, "estimated from voltage")
    upper.set_ylabel("displacement (µm)")
    letter_panels((upper, lower))
    _draw_error(lower, lines, unit_s)
    _add_results(lower, run.table("/entry/results"))
    lower.set_xlabel(label)
    lower.set_xlim(time_s[0] / unit_s, time_s[-1] / unit_s)
    legend_above(upper)
    legend_above(lower)
    figure.align_ylabels()
    return figure


def _why_not(lines: Mapping[str, Envelope]) -> str:
    if not lines:
        return (
            "The run ended before the first touch or cut, so there is nothing to compare; a run that gets "
            "further has it."
        )
    if lines["sensor"].is_empty:
        return "The run has no displacement sensor to compare the estimate with; on a machine with one it is drawn."
    return "The run has no displacement estimated from the voltage; a conditioned or calibrated actuator has one."


def _line(
    axes: Axes, line: Envelope, unit_s: float, colour: str, width: float, dash: object, label: str
) -> None:
    axes.plot(line.time_s / unit_s, line.mean, color=colour, linewidth=width, linestyle=dash, label=label)


def _draw_error(axes: Axes, lines: Mapping[str, Envelope], unit_s: float) -> None:
    everything, steady = lines["error"], lines["steady error"]
    time = everything.time_s / unit_s
    axes.axhline(0.0, color=BLACK, linewidth=0.5)
    if everything.sampled:
        axes.plot(time, everything.mean, color=SKY, linewidth=0.6, label="all")
    else:
        axes.fill_between(
            time, everything.low, everything.high, color=SKY, alpha=0.7, linewidth=0.0,
            label="range",
        )  # fmt: skip
    if not steady.is_empty:
        axes.plot(time, steady.mean, color=VERMILION, linewidth=0.8, label="machining, mean")
    axes.set_ylabel("error (µm)")
    axes.locator_params(axis="y", nbins=6)


def _add_results(axes: Axes, results: NDArray[np.void]) -> None:
    """Write what the results tell of the error, and give it in percent of the feed where there is but one."""
    from matplotlib.ticker import MaxNLocator

    known = results[np.isfinite(results["err_feed_max"])]
    if not len(known):
        return
    rms_um, max_um = float(known["err_feed_rms"].max()), float(known["err_feed_max"].max())
    rms_pct, max_pct = float(known["err_feed_rms_pct"].max()), float(known["err_feed_max_pct"].max())
    several = f"largest of {len(known)} holes:\n" if len(known) > 1 else ""
    rms, most = f"{rms_um:.2f} µm ({rms_pct:.2g} %)", f"{max_um:.2f} µm ({max_pct:.2g} % of feed)"
    _note(axes, f"{several}rms {rms}, max {most}")
    feed_um = float(known["feed"][0])
    if len(known) == 1 and feed_um > 0.0:
        percent = axes.secondary_yaxis("right", functions=(_times(100.0 / feed_um), _times(feed_um / 100.0)))
        percent.set_ylabel("error (% of feed)")
        percent.yaxis.set_major_locator(MaxNLocator(5))
        percent.spines["right"].set_visible(True)


def _note(axes: Axes, text: str) -> None:
    """Write a line at the foot of a panel, in room that is made for it."""
    low, high = axes.get_ylim()
    axes.set_ylim(low - 0.2 * (1 + text.count("\n")) * (high - low), high)
    axes.text(0.02, 0.03, text, transform=axes.transAxes, va="bottom", fontsize=6.0)


def _times(factor: float) -> Callable[[ArrayLike], ArrayLike]:
    def scaled(values: ArrayLike) -> ArrayLike:
        return factor * np.asarray(values)

    return scaled
