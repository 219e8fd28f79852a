"""Ignition delays: their histogram, and the Laue plot, a straight line where ignition is random.

Arcs and shorts are left out: they have no delay of their own.
"""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from edmctl.record.reader import RunFile
from edmctl.report import style
from edmctl.report.pulse_statistics import (
    STEP_US,
    Delays,
    RandomIgnition,
    delays,
    has_every_pulse,
    random_ignition,
)
from edmctl.report.signals import cuts_s
from edmctl.report.style import NothingToDraw
from edmctl.wording import count, to_its_u95

BARS = 50
LEAST_PULSES = 100
"""Least number of discharges for a distribution."""
LEAST_AT_RISK = 20
"""The survivors are drawn while so many pulses remain."""


def draw(run: RunFile) -> Figure:
    """Draw the delays of normal discharges, with open pulses as not ignited within the on-time."""
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
    steps = len(found.ignited)
    per_bar = -(-steps // BARS)
    label = f"share of pulses\nper {STEP_US * per_bar:.3g} µs (%)"
    figure, (histogram, laue) = style.panels(
        style.Block("ignition delay (µs)", {label: 1.0, "share not yet ignited": 1.25})
    )
    edges = np.append(np.arange(0, steps, per_bar), steps)
    total = found.ignited.sum() + found.censored.sum()
    # The last bar is narrower; heights are those of whole ones.
    heights = 100.0 / total * np.add.reduceat(found.ignited, edges[:-1]) * per_bar / np.diff(edges)
    histogram.stairs(heights, STEP_US * edges, fill=True, color=style.NORMAL, label="normal discharges")
    histogram.set_xlim(0.0, STEP_US * steps)
    _draw_laue(laue, found, fit)
    style.note_above(histogram, f"{100.0 * found.censored.sum() / total:.1f} % open: not ignited")
    style.shared_legend(figure, (histogram, laue), ncols=1)
    return figure


def _draw_laue(axes: Axes, found: Delays, fit: RandomIgnition) -> None:
    surviving = found.surviving
    at_risk = np.cumsum((found.ignited + found.censored)[::-1])[::-1]
    shown = (surviving > 0.0) & (at_risk >= LEAST_AT_RISK)
    delay_us = STEP_US * (np.arange(len(surviving)) + 0.5)
    axes.plot(delay_us[shown], surviving[shown], color=style.BLACK, linewidth=1.2, label="not yet ignited")
    line_us = np.array([fit.lag_us, delay_us[shown][-1]])
    label = f"random ignition: mean {to_its_u95(fit.mean_us, fit.mean_u95_us)} µs after a lag of {fit.lag_us:.1f} µs"
    random = np.exp(-(line_us - fit.lag_us) / fit.mean_us)
    axes.plot(line_us, random, color=style.VERMILION, linestyle=style.DASHED, linewidth=1.0, label=label)
    axes.set_yscale("log")
    axes.set_ylim(0.9 * surviving[shown][-1], 1.1)
    style.plain_log_ticks(axes.yaxis)
    style.note_above(axes, f"{count(fit.ignited)} ignited, {count(fit.censored)} open")
