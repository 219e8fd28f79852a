"""Shares of the pulse classes against time, and over all cuts."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from edmctl.report.numbers import CLASSES
from edmctl.report.pulse_statistics import ARC, SHORT, cuts_with_pulses, has_every_pulse, pulse_counts
from edmctl.report.style import (
    PULSE_COLOURS,
    PULSE_DASHES,
    PULSE_HATCHES,
    NothingToDraw,
    letter_panels,
    new_figure,
    shared_legend,
    time_unit,
)
from edmctl.wording import count, percent

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from edmctl.array_types import Array
    from edmctl.record.reader import RunFile

INTERVALS = 160
"""Of time over the whole run; a column of a journal shows no more steps."""


def draw(run: RunFile) -> Figure:
    """Draw the share of each class in intervals of time, the rare ones again, and over all; only while cutting."""
    cuts = cuts_with_pulses(run)
    edges_s = np.linspace(cuts[0, 0], cuts[-1, 1], INTERVALS + 1)
    counts = _while_cutting(run, edges_s, cuts)
    if not counts.sum():
        raise NothingToDraw(
            "No pulses were recorded while cutting: the line lost them all, or the cut was too short."
        )
    figure = new_figure(118.0)
    over_time, rare, over_all = panels = figure.subplots(3, 1, height_ratios=[1.3, 1.0, 1.0])
    shares = _shares(counts)
    per_s, label = time_unit(float(edges_s[-1]))
    _draw_stack(over_time, edges_s / per_s, shares)
    _draw_rare(rare, edges_s / per_s, shares)
    for axes in (over_time, rare):
        axes.set_xlim(edges_s[0] / per_s, edges_s[-1] / per_s)
    over_time.tick_params(axis="x", labelbottom=False)
    rare.set_xlabel(label)
    of_run = " of this run" if run.text("/entry/parent_run") else ""
    _draw_totals(over_all, counts.sum(axis=0), of_run, every=has_every_pulse(run))
    letter_panels(panels)
    shared_legend(figure, [over_time], ncols=4)
    figure.align_ylabels()
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


def _shares(counts: NDArray[np.int64]) -> Array:
    """Return percents of each class, shape (n, 4); NaN where there was no pulse."""
    total = counts.sum(axis=1)[:, None]
    shares: Array = np.divide(100.0 * counts, total, out=np.full(counts.shape, np.nan), where=total > 0)
    return shares


def _draw_stack(axes: Axes, edges: Array, shares: Array) -> None:
    below = np.where(np.isnan(shares[:, 0]), np.nan, 0.0)
    for k in _FROM_BELOW:
        name = CLASSES[k]
        above = below + shares[:, k]
        axes.stairs(
            above,
            edges,
            baseline=below,
            fill=True,
            facecolor=PULSE_COLOURS[name],
            edgecolor="white",
            hatch=PULSE_HATCHES[name],
            linewidth=0.0,
            label=name,
        )
        below = above
    axes.set_ylim(0.0, 100.0)
    axes.set_ylabel("share of\npulses (%)")


def _draw_rare(axes: Axes, edges: Array, shares: Array) -> None:
    """Draw arcs and shorts again, on a scale of their own."""
    for k in (ARC, SHORT):
        name = CLASSES[k]
        axes.stairs(
            shares[:, k],
            edges,
            baseline=None,
            color=PULSE_COLOURS[name],
            linestyle=PULSE_DASHES[name],
            linewidth=1.0,
        )
    axes.set_ylim(bottom=0.0)
    axes.set_ylabel("arcs and\nshorts (%)")


def _draw_totals(axes: Axes, totals: NDArray[np.int64], of_run: str, *, every: bool) -> None:
    places = np.arange(len(_FROM_BELOW))
    shares = totals[list(_FROM_BELOW)] / totals.sum()
    names = [CLASSES[k] for k in _FROM_BELOW]
    axes.bar(
        places,
        100.0 * shares,
        width=0.62,
        color=[PULSE_COLOURS[name] for name in names],
        edgecolor="white",
        linewidth=0.0,
        hatch=[PULSE_HATCHES[name] for name in names],
    )
    for place, share in zip(places, shares, strict=True):
        axes.annotate(
            _percent(share),
            (place, 100.0 * share),
            (0, 2),
            textcoords="offset points",
            ha="center",
            va="bottom",
        )
    axes.set_xticks(places, names)
    axes.tick_params(axis="x", length=0.0)
    axes.grid(visible=False, axis="x")
    axes.set_ylim(0.0, 125.0 * shares.max())
    axes.set_ylabel("share of\npulses (%)")
    # Blocks of pulses lie partly before or after a cut.
    total = int(totals.sum())
    words = count(total) if every else f"about {count(round(total, 3 - len(str(total))))}"
    axes.set_title(f"{words} pulses while cutting{of_run}", loc="right", pad=3.0)


_FROM_BELOW = (1, 0, 2, 3)
"""Normal discharges carry the stack, and what is rare stands on top of it."""


def _percent(share: float) -> str:
    """Two decimals for all, so that they can be compared."""
    if share == 0.0:
        return "none"
    return "< 0.01 %" if share < 0.5e-4 else percent(share, 2)
