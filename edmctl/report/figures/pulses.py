"""Shares of the pulse classes against time, and over all cuts."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from edmctl.array_types import Array
from edmctl.record.reader import RunFile
from edmctl.report import style
from edmctl.report.numbers import CLASSES
from edmctl.report.pulse_statistics import cuts_with_pulses, has_every_pulse, pulse_counts
from edmctl.report.style import PULSE_COLOURS, PULSE_DASHES, PULSE_HATCHES, NothingToDraw
from edmctl.wording import count, percent

INTERVALS = 160
"""Of time over the whole run; a column of a journal shows no more steps."""
FROM_BELOW = ("normal", "open", "arc", "short")
"""Order of the stack: the frequent classes below, the rare ones on top."""


def draw(run: RunFile) -> Figure:
    """Draw the share of each class in intervals of time, the rare ones again, and over all; only while cutting."""
    cuts = cuts_with_pulses(run)
    edges_s = np.linspace(cuts[0, 0], cuts[-1, 1], INTERVALS + 1)
    counts = _while_cutting(run, edges_s, cuts)
    if not counts.sum():
        raise NothingToDraw(
            "No pulses were recorded while cutting: the line lost them all, or the cut was too short."
        )
    total = counts.sum(axis=1)[:, None]
    shares = np.divide(100.0 * counts, total, out=np.full(counts.shape, np.nan), where=total > 0)
    by_class = dict(zip(CLASSES, shares.T, strict=True))
    per_s, label = style.time_unit(float(edges_s[-1]))
    share = "share of\npulses (%)"
    figure, (over_time, rare, over_all) = style.panels(
        style.Block(label, {share: 1.2, "arcs and\nshorts (%)": 0.9}), style.Block("", {share: 0.9})
    )
    _draw_stack(over_time, edges_s / per_s, by_class)
    for name in ("arc", "short"):
        rare.stairs(
            by_class[name], edges_s / per_s, baseline=None, color=PULSE_COLOURS[name], linewidth=1.0,
            linestyle=PULSE_DASHES[name],
        )  # fmt: skip
    rare.set_ylim(bottom=0.0)
    rare.set_xlim(edges_s[0] / per_s, edges_s[-1] / per_s)
    of_run = " of this run" if run.text("/entry/parent_run") else ""
    _draw_totals(over_all, counts.sum(axis=0), of_run, every=has_every_pulse(run))
    style.shared_legend(figure, [over_time], ncols=4)
    return figure


def _while_cutting(run: RunFile, edges_s: Array, cuts: Array) -> NDArray[np.int64]:
    """Return the pulses of each class in each interval, shape (n, 4), without those between the cuts."""
    every_s = np.unique(np.concatenate([edges_s, cuts.ravel()]))
    all_counts = pulse_counts(run, every_s)
    middle_s = 0.5 * (every_s[:-1] + every_s[1:])
    cut = np.searchsorted(cuts[:, 0], middle_s, side="right") - 1
    cutting = (cut >= 0) & (middle_s < cuts[np.maximum(cut, 0), 1])
    interval = np.clip(np.searchsorted(edges_s, middle_s, side="right") - 1, 0, len(edges_s) - 2)
    counts = np.zeros((len(edges_s) - 1, 4), np.int64)
    np.add.at(counts, interval[cutting], all_counts[cutting])
    return counts


def _draw_stack(axes: Axes, edges: Array, shares: dict[str, Array]) -> None:
    below = np.where(np.isnan(shares["open"]), np.nan, 0.0)
    for name in FROM_BELOW:
        above = below + shares[name]
        axes.stairs(
            above, edges, baseline=below, fill=True, facecolor=PULSE_COLOURS[name], edgecolor="white",
            hatch=PULSE_HATCHES[name], linewidth=0.0, label=name,
        )  # fmt: skip
        below = above
    axes.set_ylim(0.0, 100.0)


def _draw_totals(axes: Axes, totals: NDArray[np.int64], of_run: str, *, every: bool) -> None:
    shares = np.array([totals[CLASSES.index(name)] for name in FROM_BELOW]) / totals.sum()
    bars = axes.bar(
        FROM_BELOW, 100.0 * shares, width=0.62, color=[PULSE_COLOURS[name] for name in FROM_BELOW],
        edgecolor="white", linewidth=0.0, hatch=[PULSE_HATCHES[name] for name in FROM_BELOW],
    )  # fmt: skip
    axes.bar_label(bars, [_percent(share) for share in shares], padding=2.0)
    axes.tick_params(axis="x", length=0.0)
    axes.grid(visible=False, axis="x")
    axes.set_ylim(0.0, 125.0 * shares.max())
    # Blocks of pulses lie partly before or after a cut.
    total = int(totals.sum())
    words = count(total) if every else f"about {count(round(total, 3 - len(str(total))))}"
    style.note_above(axes, f"{words} pulses while cutting{of_run}")


def _percent(share: float) -> str:
    """Return a share with two decimals, so that shares can be compared."""
    if share == 0.0:
        return "none"
    return "< 0.01 %" if share < 0.5e-4 else percent(share, 2)
