"""Electrode jumps, what asked for them, and how the jump period followed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from edmctl.record import layout
from edmctl.record.told import Told
from edmctl.report.happened import happened
from edmctl.report.stretches import MEAN_S, broken, cuts_s, running_mean
from edmctl.report.style import (
    ARC,
    BLACK,
    BLUE,
    GREY,
    SHORT,
    NothingToDraw,
    draw_envelope,
    new_figure,
    plain_log_ticks,
)
from edmctl.report.time_axis import time_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from edmctl.record.reader import RunFile

    Array = NDArray[np.float64]

FEW = 400
"""Of so many jumps a column of a journal can show each mark."""


def draw(run: RunFile) -> Figure:
    """Draw the shares of arcs and shorts with a mark for each jump, and the time from jump to jump."""
    at_s = np.array([event.time_s for event in happened(run, Told.JUMP_DONE)])
    if not len(at_s):
        mode = run.profile_values().get("jump.mode", "")
        why = 'its profile says jump.mode = "off"' if mode == "off" else "it ended before the first was due"
        raise NothingToDraw(f"The tool did not jump in this run: {why}.")
    slow = {
        name: run.column(layout.SLOW.path, name).astype(np.float64)
        for name in ("time", "r_arc", "r_short", "jump_period")
    }
    if not len(slow["time"]):
        raise NothingToDraw("The run has jumps, but no rows of the supervisor beside them.")
    unit = time_unit(float(slow["time"][-1]))
    figure = new_figure(92.0)
    shares, periods = figure.subplots(2, 1, sharex=True, height_ratios=[1.0, 1.0])
    _draw_shares(shares, slow, at_s, unit.seconds)
    _draw_periods(periods, slow, at_s, cuts_s(run), unit.seconds)
    periods.set_xlabel(unit.label)
    shares.set_title(f"{len(at_s)} jumps", loc="right", pad=3.0)
    handles, names = [], []
    for axes, letter in ((shares, "a"), (periods, "b")):
        axes.set_title(f"({letter})", loc="left", pad=3.0)
        drawn = axes.get_legend_handles_labels()
        handles += drawn[0]
        names += drawn[1]
    figure.legend(handles, names, loc="outside upper center", ncols=2, handlelength=1.6, columnspacing=1.5)
    figure.align_ylabels()
    return figure


def _draw_shares(axes: Axes, slow: dict[str, Array], at_s: Array, seconds: float) -> None:
    for name, colour, label in (("r_arc", ARC, "arcs"), ("r_short", SHORT, "shorts")):
        mean = running_mean(slow["time"], 100.0 * slow[name])
        line = broken(slow["time"], mean)
        draw_envelope(axes, line.time_s / seconds, line.low, line.high, colour, label, 1.0)
    top = max(1.0, 1.25 * axes.get_ylim()[1])
    axes.set_ylim(0.0, top)
    if len(at_s) <= FEW:
        axes.plot(
            at_s / seconds,
            np.full(len(at_s), 0.955 * top),
            "|",
            color=BLACK,
            markersize=5.0,
            markeredgewidth=0.5,
            label="jump",
        )
    axes.set_ylabel(f"share of pulses,\nmean of {MEAN_S:g} s (%)")


def _draw_periods(axes: Axes, slow: dict[str, Array], at_s: Array, cuts: Array, seconds: float) -> None:
    since_s = _since_the_last(at_s, cuts)
    period = broken(slow["time"], slow["jump_period"])
    if np.isfinite(period.low).any():
        draw_envelope(
            axes, period.time_s / seconds, period.low, period.high, GREY, "jump period in force", 1.2
        )
    size = 2.6 if len(at_s) <= FEW else 1.2
    axes.plot(
        at_s / seconds,
        since_s,
        "o",
        color=BLUE,
        markersize=size,
        markeredgewidth=0.0,
        label="time since the jump before",
    )
    axes.set_yscale("log")
    plain_log_ticks(axes.yaxis)
    axes.set_ylabel("jump period (s)")


def _since_the_last(at_s: Array, cuts: Array) -> Array:
    """Time since the jump before, or since its cut began, shape (n,); NaN for a jump outside of the cuts."""
    before_s = np.concatenate([[-np.inf], at_s[:-1]])
    cut = np.searchsorted(cuts[:, 0], at_s, side="right") - 1
    began_s = np.where(cut >= 0, cuts[np.maximum(cut, 0), 0], np.nan)
    since_s: Array = at_s - np.fmax(before_s, began_s)
    return since_s
