"""Electrode jumps, the shares that cause them, and the jump period."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from edmctl.array_types import Array
from edmctl.record import layout
from edmctl.record.events import RecordedCode, recorded_events
from edmctl.record.reader import RunFile
from edmctl.report import style
from edmctl.report.signals import MEAN_S, broken, cuts_s, floats, running_mean
from edmctl.report.style import NothingToDraw
from edmctl.wording import plural

RANGE_OF_LOG = 8.0
"""A narrower range of periods is drawn on an even scale from 0, where it has more than one label."""
FEW = 400
"""Up to so many jumps a column of a journal can show each mark."""


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
    per_s, label = style.time_unit(float(slow["time"][-1]))
    figure, (shares, periods) = style.panels(
        style.Block(label, {f"share of pulses,\nmean of {MEAN_S:g} s (%)": 1.15, "jump period (s)": 1.15})
    )
    _draw_shares(shares, slow, at_s, per_s)
    _draw_periods(periods, slow, at_s, cuts_s(run), per_s)
    style.note_above(shares, plural(len(at_s), "jump"))
    style.shared_legend(figure, (shares, periods))
    return figure


def _draw_shares(axes: Axes, slow: dict[str, Array], at_s: Array, per_s: float) -> None:
    for name in ("arc", "short"):
        line = broken(slow["time"], running_mean(slow["time"], 100.0 * slow[f"r_{name}"]))
        axes.plot(
            line.time_s / per_s, line.mean, color=style.PULSE_COLOURS[name], linewidth=1.0, label=f"{name}s",
            linestyle=style.PULSE_DASHES[name],
        )  # fmt: skip
    top = max(1.0, 1.25 * axes.get_ylim()[1])
    axes.set_ylim(0.0, top)
    if len(at_s) <= FEW:
        marks = np.full(len(at_s), 0.955 * top)
        axes.plot(
            at_s / per_s, marks, "|", color=style.BLACK, markersize=5.0, markeredgewidth=0.5, label="jump"
        )


def _draw_periods(axes: Axes, slow: dict[str, Array], at_s: Array, cuts: Array, per_s: float) -> None:
    since_s = since_the_last(at_s, cuts)
    period = broken(slow["time"], slow["jump_period"])
    if np.isfinite(period.low).any():
        style.draw_envelope(axes, period, per_s, style.GREY, "jump period in force", 1.2)
    if np.isfinite(since_s).any():
        axes.plot(
            at_s / per_s, since_s, "o", color=style.BLUE, markersize=2.6 if len(at_s) <= FEW else 1.2,
            markeredgewidth=0.0, label="time since the jump before",
        )  # fmt: skip
    drawn_s = np.concatenate([since_s, slow["jump_period"]])
    drawn_s = drawn_s[drawn_s > 0.0]
    if len(drawn_s) and drawn_s.max() > RANGE_OF_LOG * drawn_s.min():
        axes.set_yscale("log")
        style.plain_log_ticks(axes.yaxis)
    else:
        axes.set_ylim(0.0, 1.15 * axes.get_ylim()[1])


def since_the_last(at_s: Array, cuts: Array) -> Array:
    """Time since the jump before in the same cut, shape (n,); NaN for the first of a cut and outside of cuts."""
    cut = np.searchsorted(cuts[:, 0], at_s, side="right") - 1
    since_s: Array = np.diff(at_s, prepend=np.nan)
    since_s[(cut < 0) | (np.diff(cut, prepend=-1) != 0)] = np.nan
    return since_s
