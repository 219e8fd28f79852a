"""Ignition delays: their histogram, and the Laue plot, a straight line where ignition is random.

Arcs and shorts are left out: they have no delay of their own.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from edmctl.report.pulse_statistics import (
    STEP_US,
    Delays,
    RandomIgnition,
    delays,
    has_every_pulse,
    random_ignition,
)
from edmctl.report.signals import cuts_s
from edmctl.report.style import (
    BLACK,
    DASHED,
    NORMAL,
    OPEN,
    PULSE_HATCHES,
    VERMILION,
    NothingToDraw,
    letter_panels,
    new_figure,
    plain_log_ticks,
    shared_legend,
)
from edmctl.wording import count, to_its_u95

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from edmctl.record.reader import RunFile

BARS = 50
LEAST_PULSES = 100
"""A distribution of fewer says nothing."""
LEAST_AT_RISK = 20
"""The survivors are drawn while so many pulses are left."""


def draw(run: RunFile) -> Figure:
    """Draw how long normal discharges took to ignite, with open pulses as what had not ignited in the on-time."""
    if not has_every_pulse(run):
        raise NothingToDraw(
            "Single pulses were not recorded: `--set log.pulses=full` keeps the ignition delay of each."
        )
    cuts = cuts_s(run)
    if not len(cuts):
        raise NothingToDraw("The run ended before the first cut, so no pulse had a gap to ignite in.")
    found = delays(run, cuts)
    fit = random_ignition(found)
    if fit is None or fit.ignited < LEAST_PULSES:
        raise NothingToDraw(
            f"Fewer than {LEAST_PULSES} normal discharges were recorded: a longer run has more."
        )
    figure = new_figure(95.0)
    histogram, laue = figure.subplots(2, 1, sharex=True, height_ratios=[1.0, 1.25])
    _draw_histogram(histogram, found)
    _draw_laue(laue, found, fit)
    laue.set_xlabel("ignition delay (µs)")
    letter_panels((histogram, laue))
    shared_legend(figure, (histogram, laue), ncols=1)
    figure.align_ylabels()
    return figure


def _draw_histogram(axes: Axes, found: Delays) -> None:
    steps = len(found.ignited)
    per_bar = -(-steps // BARS)
    starts = np.arange(0, steps, per_bar)
    edges_us = STEP_US * np.append(starts, steps)
    total = found.ignited.sum() + found.censored.sum()
    # The last bar is narrower; heights are those of whole ones.
    heights = (
        100.0 / total * np.add.reduceat(found.ignited, starts) * per_bar / np.diff(np.append(starts, steps))
    )
    axes.stairs(heights, edges_us, fill=True, color=NORMAL, label="normal discharges")
    open_share = 100.0 * found.censored.sum() / total
    width_us = edges_us[1]
    axes.bar(
        edges_us[-1] + 1.5 * width_us,
        open_share,
        width=width_us,
        facecolor=OPEN,
        edgecolor="white",
        linewidth=0.0,
        hatch=PULSE_HATCHES["open"],
        label=f"open: not ignited within the on-time ({open_share:.1f} %, bar cut off)",
    )
    axes.set_xlim(0.0, edges_us[-1] + 2.5 * width_us)
    axes.set_ylim(0.0, 1.2 * heights.max())
    axes.set_ylabel(f"share of pulses\nper {width_us:.3g} µs (%)")


def _draw_laue(axes: Axes, found: Delays, fit: RandomIgnition) -> None:
    surviving = found.surviving
    at_risk = np.cumsum((found.ignited + found.censored)[::-1])[::-1]
    shown = (surviving > 0.0) & (at_risk >= LEAST_AT_RISK)
    delay_us = STEP_US * (np.arange(len(surviving)) + 0.5)
    axes.plot(delay_us[shown], surviving[shown], color=BLACK, linewidth=1.2, label="not yet ignited")
    end_us = delay_us[shown][-1]
    line_us = np.array([fit.lag_us, end_us])
    label = f"random ignition: mean {to_its_u95(fit.mean_us, fit.mean_u95_us)} µs after a lag of {fit.lag_us:.1f} µs"
    axes.plot(
        line_us,
        np.exp(-(line_us - fit.lag_us) / fit.mean_us),
        color=VERMILION,
        linestyle=DASHED,
        linewidth=1.0,
        label=label,
    )
    axes.set_yscale("log")
    axes.set_ylim(0.9 * surviving[shown][-1], 1.1)
    plain_log_ticks(axes.yaxis)
    axes.set_ylabel("share not yet ignited")
    axes.set_title(f"{count(fit.ignited)} ignited, {count(fit.censored)} open", loc="right", pad=3.0)
