"""Shares of the pulse classes against time, and over all cuts."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from edmctl.report.pulse_counts import CLASSES, has_pulses, pulse_counts
from edmctl.report.stretches import cuts_s
from edmctl.report.style import PULSE_COLOURS, NothingToDraw, new_figure
from edmctl.report.time_axis import time_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from edmctl.record.reader import RunFile

    Array = NDArray[np.float64]

INTERVALS = 160
"""Of time over the whole run; a column of a journal shows no more steps."""


def draw(run: RunFile) -> Figure:
    """Draw the share of each class in intervals of time and over all; only pulses while cutting count."""
    cuts = cuts_s(run)
    if not has_pulses(run) or not len(cuts):
        raise NothingToDraw(
            'No pulses were recorded while cutting: the run ended before, or its profile says log.pulses = "off".'
        )
    edges_s = np.linspace(cuts[0, 0], cuts[-1, 1], INTERVALS + 1)
    counts = _while_cutting(run, edges_s, cuts)
    if not counts.sum():
        raise NothingToDraw(
            "No pulses were recorded while cutting: the line lost them all, or the cut was too short."
        )
    figure = new_figure(86.0)
    over_time, over_all = figure.subplots(2, 1, height_ratios=[1.5, 1.0])
    _draw_shares(over_time, edges_s, counts)
    _draw_totals(over_all, counts.sum(axis=0))
    handles, names = over_time.get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper center", ncols=4, handlelength=1.2, columnspacing=1.5)
    return figure


def _while_cutting(run: RunFile, edges_s: Array, cuts: Array) -> NDArray[np.int64]:
    """Pulses of each class in each interval, shape (n, 4), without those between the cuts."""
    every_s = np.unique(np.concatenate([edges_s, cuts.ravel()]))
    all_counts = pulse_counts(run, every_s)
    middle_s = 0.5 * (every_s[:-1] + every_s[1:])
    cut = np.searchsorted(cuts[:, 0], middle_s, side="right") - 1
    cutting = (cut >= 0) & (middle_s < cuts[np.maximum(cut, 0), 1])
    interval = np.clip(np.searchsorted(edges_s, middle_s, side="right") - 1, 0, len(edges_s) - 2)
    counts = np.zeros((len(edges_s) - 1, 4), np.int64)
    np.add.at(counts, interval[cutting], all_counts[cutting])
    return counts


def _draw_shares(axes: Axes, edges_s: Array, counts: NDArray[np.int64]) -> None:
    unit = time_unit(edges_s[-1])
    total = counts.sum(axis=1)
    with np.errstate(invalid="ignore"):
        shares = np.where(total[:, None] > 0, 100.0 * counts / total[:, None], np.nan)
    below = np.zeros(len(total))
    for k in _FROM_BELOW:
        above = below + np.nan_to_num(shares[:, k])
        top = np.where(total > 0, above, np.nan)
        axes.stairs(
            top,
            edges_s / unit.seconds,
            baseline=np.where(total > 0, below, np.nan),
            fill=True,
            color=PULSE_COLOURS[CLASSES[k]],
            linewidth=0.0,
            label=CLASSES[k],
        )
        below = above
    axes.set_xlim(edges_s[0] / unit.seconds, edges_s[-1] / unit.seconds)
    axes.set_ylim(0.0, 100.0)
    axes.set_xlabel(unit.label)
    axes.set_ylabel("share of pulses (%)")
    axes.set_title("(a)", loc="left", pad=3.0)


def _draw_totals(axes: Axes, totals: NDArray[np.int64]) -> None:
    places = np.arange(len(_FROM_BELOW))
    shares = 100.0 * totals[list(_FROM_BELOW)] / totals.sum()
    names = [CLASSES[k] for k in _FROM_BELOW]
    axes.bar(places, shares, width=0.62, color=[PULSE_COLOURS[name] for name in names])
    for place, share in zip(places, shares, strict=True):
        axes.annotate(
            _percent(share), (place, share), (0, 2), textcoords="offset points", ha="center", va="bottom"
        )
    axes.set_xticks(places, names)
    axes.tick_params(axis="x", length=0.0)
    axes.grid(visible=False, axis="x")
    axes.set_ylim(0.0, 1.18 * shares.max())
    axes.set_ylabel("share of pulses (%)")
    axes.set_title("(b)", loc="left", pad=3.0)
    axes.set_title(f"{totals.sum():,} pulses".replace(",", "\u202f"), loc="right", pad=3.0)


_FROM_BELOW = (1, 0, 2, 3)
"""Normal discharges carry the stack, and what is rare stands on top of it."""


def _percent(share: float) -> str:
    if share == 0.0:
        return "none"
    return "< 0.01 %" if share < 0.01 else f"{share:.3g} %" if share < 10.0 else f"{share:.1f} %"
