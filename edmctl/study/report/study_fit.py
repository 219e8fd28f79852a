"""How well the model of a response fits: measured against fitted, residuals, and the runs in their order."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import special

from edmctl.report.style import (
    BLUE,
    FAINT,
    GREY,
    LIGHT,
    VERMILION,
    NothingToDraw,
    draw_points,
    letter_panels,
    new_figure,
    shared_legend,
)
from edmctl.study.report.study_effects import plain_ticks, wrapped
from edmctl.study.results import ResponseInfo, RunKind, StudyRun
from edmctl.study.statistics.response_analysis import ResponseAnalysis
from edmctl.wording import printable

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_NO_MODEL = "No model was fitted to this response."
MOST_BLOCKS = 8
"""So many blocks are named above the panel."""


def draw_fitted(info: ResponseInfo, one: ResponseAnalysis, runs: Sequence[StudyRun]) -> Figure:
    """Draw every run against what the model makes of it, and the mean of every point. Raises NothingToDraw."""
    if not one.fitted:
        raise NothingToDraw(_NO_MODEL)
    fitted, measured = np.asarray(one.fitted), np.asarray(one.values)
    if one.is_log:
        fitted = np.exp(fitted)
    points = np.array([runs[row].planned.point for row in one.used])
    figure = new_figure(62.0)
    axes = figure.subplots()
    plain_ticks(axes)
    ends = [min(fitted.min(), measured.min()), max(fitted.max(), measured.max())]
    margin = 0.05 * (ends[1] - ends[0])
    ends = [ends[0] - margin, ends[1] + margin]
    axes.plot(ends, ends, color=GREY, linewidth=0.6)
    axes.plot(fitted, measured, "o", color=FAINT, markersize=1.8, linestyle="none", label="run")
    means = [(fitted[points == one].mean(), measured[points == one].mean()) for one in np.unique(points)]
    axes.plot(*zip(*means, strict=True), "o", color=BLUE, markersize=4.2, markerfacecolor="none",
              markeredgewidth=0.8, label="mean of a point")  # fmt: skip
    axes.set_xlim(*ends)
    axes.set_ylim(*ends)
    axes.locator_params(nbins=6)
    axes.set_xlabel(wrapped(f"fitted {printable(info.label)}", 70.0))
    axes.set_ylabel(wrapped(f"measured {printable(info.label)}", 48.0))
    shared_legend(figure, [axes])
    return figure


def draw_residuals(info: ResponseInfo, one: ResponseAnalysis) -> Figure:
    """Draw residuals against what was fitted, and against a normal distribution. Raises NothingToDraw."""
    if not one.residuals or one.anova is None or not one.anova.error.dof:
        raise NothingToDraw("The model leaves no residuals." if one.residuals else _NO_MODEL)
    residuals = np.asarray(one.residuals)
    unit = f" ({info.unit})" if info.unit else ""
    fitted_label, residual_label = f"fitted{unit}", f"residual{unit}"
    if one.is_log:
        fitted_label, residual_label = f"fitted, ln{unit}", "residual, ln"
    figure = new_figure(48.0)
    left, right = figure.subplots(1, 2, sharey=True)
    plain_ticks(left, right)
    left.axhline(0.0, color=GREY, linewidth=0.6)
    left.plot(one.fitted, residuals, "o", color=BLUE, markersize=2.6, linestyle="none")
    left.set_xlabel(fitted_label)
    left.set_ylabel(residual_label)
    left.locator_params(axis="x", nbins=4)
    count = len(residuals)
    quantiles = special.ndtri((np.arange(1, count + 1) - 0.375) / (count + 0.25))
    ends = np.array([quantiles[0], quantiles[-1]])
    right.plot(ends, residuals.std() * ends, color=GREY, linewidth=0.6)
    right.plot(quantiles, np.sort(residuals), "o", color=BLUE, markersize=2.6, linestyle="none")
    right.set_xlabel("normal quantile (1)")
    letter_panels([left, right])
    return figure


def draw_order(info: ResponseInfo, one: ResponseAnalysis, runs: Sequence[StudyRun]) -> Figure:
    """Draw a response in the order of the runs, and what the model leaves of it. Raises NothingToDraw."""
    if not one.used:
        raise NothingToDraw("No run has a value.")
    ordered = sorted(range(len(one.used)), key=lambda n: runs[one.used[n]].planned.number)
    mine = [runs[one.used[n]] for n in ordered]
    number = np.array([run.planned.number for run in mine])
    values = np.array([one.values[n] for n in ordered])
    has_rest = bool(one.residuals) and one.anova is not None and one.anova.error.dof > 0
    figure = new_figure(82.0 if has_rest else 50.0)
    panels = figure.subplots(2 if has_rest else 1, 1, sharex=True, squeeze=False).ravel()
    plain_ticks(*panels)
    for axes in panels:
        _shade_blocks(axes, mine, is_named=axes is panels[0])
    centre = np.array([run.planned.kind is RunKind.CENTER for run in mine])
    upper = panels[0]
    u95 = _u95(info, mine)
    for chosen, colour, mark, label in ((~centre, BLUE, "o", "run"), (centre, VERMILION, "D", "centre run")):
        if chosen.any():
            bars = u95[chosen] if np.isfinite(u95[chosen]).all() else None
            draw_points(
                upper, number[chosen], values[chosen], bars, colour, marker=mark, size=2.6, label=label
            )
    upper.set_ylabel(wrapped(printable(info.label), 30.0))
    if has_rest:
        rest = np.array([one.residuals[n] for n in ordered])
        panels[1].axhline(0.0, color=GREY, linewidth=0.6)
        panels[1].plot(number, rest, color=BLUE, linewidth=0.5)
        for chosen, colour, mark in ((~centre, BLUE, "o"), (centre, VERMILION, "D")):
            panels[1].plot(number[chosen], rest[chosen], mark, color=colour, markersize=2.6, linestyle="none")
        unit = f" ({info.unit})" if info.unit else ""
        panels[1].set_ylabel("residual, ln" if one.is_log else f"residual{unit}")
    panels[-1].set_xlabel("run, in the order they were made")
    panels[-1].set_xlim(number[0] - 0.7, number[-1] + 0.7)
    panels[-1].xaxis.get_major_locator().set_params(integer=True)
    if centre.any():
        shared_legend(figure, [upper])
    figure.align_ylabels()
    return figure


def _u95(info: ResponseInfo, runs: Sequence[StudyRun]) -> NDArray[np.float64]:
    found = [
        run.row.u95.get(info.name) if run.row is not None and info.name not in run.told else None
        for run in runs
    ]
    return np.array([np.nan if value is None else value for value in found], float)


def _shade_blocks(axes: Axes, runs: Sequence[StudyRun], *, is_named: bool) -> None:
    """Shade every second stretch of runs of one block, and name the stretches where there is room."""
    stretches = [
        (block, [run.planned.number for run in members])
        for block, members in (
            (k, list(g)) for k, g in itertools.groupby(runs, lambda run: run.planned.block)
        )
    ]
    if len(stretches) < 2:
        return
    for n, (block, numbers) in enumerate(stretches):
        low, high = numbers[0] - 0.5, numbers[-1] + 0.5
        if n % 2:
            axes.axvspan(low, high, color=LIGHT, alpha=0.6, zorder=0, linewidth=0)
        if is_named and len(stretches) <= MOST_BLOCKS:
            axes.annotate(
                f"block {block}" if len(stretches) <= 4 else str(block), ((low + high) / 2, 1.0),
                xycoords=("data", "axes fraction"), xytext=(0, 2), textcoords="offset points",
                ha="center", va="bottom", fontsize=6.5, color=FAINT,
            )  # fmt: skip
