"""Electrode jumps, what asked for them, and how the jump period followed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from edmctl.record import layout
from edmctl.record.events import RecordedCode, recorded_events
from edmctl.report.signals import MEAN_S, broken, cuts_s, floats, running_mean
from edmctl.report.style import (
    BLACK,
    BLUE,
    GREY,
    PULSE_COLOURS,
    PULSE_DASHES,
    NothingToDraw,
    draw_envelope,
    letter_panels,
    new_figure,
    plain_log_ticks,
    shared_legend,
    time_unit,
)
from edmctl.wording import plural

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from edmctl.array_types import Array
    from edmctl.record.reader import RunFile

RANGE_OF_LOG = 8.0
"""A narrower range of periods is drawn on an even scale from 0, where it has more than one label."""
FEW = 400
"""Of so many jumps a column of a journal can show each mark."""


def draw(run: RunFile) -> Figure:
    """Draw the shares of arcs and shorts with a mark for each jump, and the time from jump to jump."""
    at_s = np.array([event.time_s for event in recorded_events(run, RecordedCode.JUMP_DONE)])
    if not len(at_s):
        mode = run.profile_values().get("jump.mode", "")
        why = 'its profile says jump.mode = "off"' if mode == "off" else "it ended before the first was due"
        raise NothingToDraw(f"The tool did not jump in this run: {why}.")
    slow = floats(run, layout.SLOW.path, ("time", "r_arc", "r_short", "jump_period"))
    if not len(slow["time"]):
        raise NothingToDraw("The run has jumps, but no rows of the supervisor beside them.")
    per_s, label = time_unit(float(slow["time"][-1]))
    figure = new_figure(92.0)
    shares, periods = figure.subplots(2, 1, sharex=True, height_ratios=[1.0, 1.0])
    _draw_shares(shares, slow, at_s, per_s)
    _draw_periods(periods, slow, at_s, cuts_s(run), per_s)
    periods.set_xlabel(label)
    shares.set_title(plural(len(at_s), "jump"), loc="right", pad=3.0)
    letter_panels((shares, periods))
    shared_legend(figure, (shares, periods))
    figure.align_ylabels()
    return figure


def _draw_shares(axes: Axes, slow: dict[str, Array], at_s: Array, per_s: float) -> None:
    for name in ("arc", "short"):
        mean = running_mean(slow["time"], 100.0 * slow[f"r_{name}"])
        line = broken(slow["time"], mean)
        axes.plot(
            line.time_s / per_s,
            line.mean,
            color=PULSE_COLOURS[name],
            linestyle=PULSE_DASHES[name],
            linewidth=1.0,
            label=f"{name}s",
        )
    top = max(1.0, 1.25 * axes.get_ylim()[1])
    axes.set_ylim(0.0, top)
    if len(at_s) <= FEW:
        axes.plot(
            at_s / per_s,
            np.full(len(at_s), 0.955 * top),
            "|",
            color=BLACK,
            markersize=5.0,
            markeredgewidth=0.5,
            label="jump",
        )
    axes.set_ylabel(f"share of pulses,\nmean of {MEAN_S:g} s (%)")


def _draw_periods(axes: Axes, slow: dict[str, Array], at_s: Array, cuts: Array, per_s: float) -> None:
    since_s = since_the_last(at_s, cuts)
    period = broken(slow["time"], slow["jump_period"])
    if np.isfinite(period.low).any():
        draw_envelope(axes, period, per_s, GREY, "jump period in force", 1.2)
    size = 2.6 if len(at_s) <= FEW else 1.2
    if np.isfinite(since_s).any():
        axes.plot(
            at_s / per_s,
            since_s,
            "o",
            color=BLUE,
            markersize=size,
            markeredgewidth=0.0,
            label="time since the jump before",
        )
    drawn_s = np.concatenate([since_s, slow["jump_period"]])
    drawn_s = drawn_s[drawn_s > 0.0]
    if len(drawn_s) and drawn_s.max() > RANGE_OF_LOG * drawn_s.min():
        axes.set_yscale("log")
        plain_log_ticks(axes.yaxis)
    else:
        axes.set_ylim(0.0, 1.15 * axes.get_ylim()[1])
    axes.set_ylabel("jump period (s)")


def since_the_last(at_s: Array, cuts: Array) -> Array:
    """Time since the jump before in the same cut, shape (n,); NaN for the first of a cut and outside of cuts."""
    cut = np.searchsorted(cuts[:, 0], at_s, side="right") - 1
    since_s: Array = np.diff(at_s, prepend=np.nan)
    since_s[(cut < 0) | (np.diff(cut, prepend=-1) != 0)] = np.nan
    return since_s
