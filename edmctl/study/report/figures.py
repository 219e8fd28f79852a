"""Figures of a study: effects, quality of the fit, the Pareto front, surfaces and Sobol indices."""

from __future__ import annotations

import itertools
import math
import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from scipy import special

from edmctl.array_types import Array
from edmctl.report.panels import (
    BLACK,
    BLUE,
    COLUMN_MM,
    DASHED,
    FAINT,
    GREEN,
    GREY,
    LIGHT,
    ORANGE,
    PURPLE,
    SKY,
    VERMILION,
    NothingToDraw,
    draw_points,
    letter_panels,
    new_figure,
    plain_log_ticks,
    shared_legend,
)
from edmctl.study.design import uncoded
from edmctl.study.report.contents import factor_label, level_text, target_text
from edmctl.study.results import Choice, FactorInfo, ResponseInfo, RunKind, StudyPlan, StudyRun
from edmctl.study.statistics.linear_model import Settings, term_name
from edmctl.study.statistics.response_analysis import LevelMeans, ResponseAnalysis
from edmctl.wording import plain_number, printable

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


LETTER_MM = 1.45
"""Mean width of a letter."""
AXIS_MM = 14.0
"""Width of the labels of the vertical axis."""
MOST_COLUMNS, MOST_INTERACTIONS = 4, 6
MOST_LETTERS = 20
"""Of a level below a panel or in a legend."""
LEVEL_COLOURS = (BLUE, VERMILION, GREEN, ORANGE, PURPLE, SKY, BLACK, GREY)
LEVEL_MARKS = "os^Dv<>P"
GRID = 41
"""Points of a surface along each factor."""
NO_MODEL = "No model was fitted to this response."


def wrapped(text: str, mm: float) -> str:
    """Break a label into lines that are no longer than a side of its panel."""
    return "\n".join(textwrap.wrap(text, max(6, int(mm / LETTER_MM)))[:4])


def plain_ticks(*panels: Axes) -> None:
    """Write every tick in full: a power of ten above a panel would cover other text."""
    for axis in (axis for axes in panels for axis in (axes.xaxis, axes.yaxis)):
        axis.set_major_formatter("{x:g}")


def check_varies(one: ResponseAnalysis) -> None:
    """Raise NothingToDraw where all runs have the same value, or there are none."""
    if not one.values:
        raise NothingToDraw("No run has a value.")
    if min(one.values) == max(one.values):
        raise NothingToDraw("All runs have the same value.")


def _panels(count: int, most: int, row_mm: float, label: str) -> tuple[Figure, list[Axes]]:
    """Return a figure of panels in rows that share their vertical axis, with its label before each row."""
    columns = min(most, count)
    rows = math.ceil(count / columns)
    figure = new_figure(5.0 + row_mm * rows)
    panels = figure.subplots(rows, columns, sharey=True, squeeze=False).ravel().tolist()
    for axes in panels[::columns]:
        axes.set_ylabel(wrapped(label, 30.0))
    for axes in panels[count:]:
        axes.remove()
    plain_ticks(*panels[:count])
    return figure, panels[:count]


def _short(level: object) -> str:
    text = level_text(level)
    return text if len(text) <= MOST_LETTERS else f"{text[: MOST_LETTERS - 1]}…"


def _turned_mm(levels: Sequence[object], width_mm: float) -> float:
    """Return the height of the levels below a panel of this width if they have to be upright; else 0."""
    longest_mm = LETTER_MM * max(len(_short(level)) for level in levels)
    return longest_mm if (longest_mm + 1.5) * len(levels) > width_mm else 0.0


def _levels_below(axes: Axes, levels: Sequence[object], width_mm: float) -> None:
    turned = 90.0 if _turned_mm(levels, width_mm) else 0.0
    axes.set_xticks(range(len(levels)), list(map(_short, levels)), rotation=turned)
    axes.grid(visible=False, axis="x")
    axes.set_xlim(-0.4, len(levels) - 0.6)


def draw_main_effects(
    plan: StudyPlan, info: ResponseInfo, one: ResponseAnalysis, runs: Sequence[StudyRun]
) -> Figure:
    """Draw the mean by level of every factor, with the 95 % interval of each mean. Raises NothingToDraw."""
    check_varies(one)
    if not one.level_means:
        raise NothingToDraw("Means by level need factors of a few levels, and these runs have none.")
    factors = {factor.name: factor for factor in plan.factors}
    width_mm = (COLUMN_MM - AXIS_MM) / min(MOST_COLUMNS, len(one.level_means))
    names = [wrapped(factor_label(factors[of.factor]), width_mm) for of in one.level_means]
    lines = max(name.count("\n") for name in names)
    row_mm = 38.5 + 2.7 * lines + max(_turned_mm(of.levels, width_mm - 2.0) for of in one.level_means)
    figure, panels = _panels(len(one.level_means), MOST_COLUMNS, row_mm, printable(info.label))
    for axes, of, name in zip(panels, one.level_means, names, strict=True):
        axes.axhline(one.mean, color=GREY, linewidth=0.6, linestyle=DASHED)
        axes.plot(of.means, color=BLUE)
        levels = [runs[row].planned.settings[factors[of.factor].key] for row in one.used]
        draw_points(axes, range(len(of.means)), of.means, _intervals(one, of, levels), BLUE)
        _levels_below(axes, of.levels, width_mm - 2.0)
        axes.set_xlabel(name)
    return figure


def _intervals(one: ResponseAnalysis, of: LevelMeans, levels: Sequence[object]) -> Array | None:
    """Return half-widths of the 95 % intervals of means, by the row that F compares with; None without an error."""
    under = one.anova.under(of.factor) if one.anova is not None else None
    if under is None or not under.dof or not math.isfinite(under.mean_square):
        return None
    means, counts = np.array(of.means), np.array([levels.count(level) for level in of.levels])
    half = float(special.stdtrit(under.dof, 0.975)) * np.sqrt(under.mean_square / counts)
    return np.array([means * -np.expm1(-half), means * np.expm1(half)]) if one.is_log else half


def _cell_means(
    one: ResponseAnalysis, settings: Sequence[Mapping[str, object]], levels: Mapping[str, Sequence[object]]
) -> Array:
    """Return the means of a response at the levels of two factors, by their keys; NaN without a run."""
    (first, rows), (second, columns) = levels.items()
    means = np.full((len(rows), len(columns)), np.nan)
    for i, j in np.ndindex(means.shape):
        cell = {first: rows[i], second: columns[j]}.items()
        values = [
            value for row, value in zip(one.used, one.values, strict=True) if cell <= settings[row].items()
        ]
        means[i, j] = np.mean(values) if values else np.nan
    return means


def departure(means: Array) -> float:
    """Return the departure of lines from parallel: the rms interaction of the means; −1 if a mean is missing."""
    rest = means - means.mean(axis=0) - means.mean(axis=1)[:, None] + means.mean()
    return float(np.nan_to_num(np.sqrt((rest**2).mean()), nan=-1.0))


def draw_interactions(
    plan: StudyPlan, info: ResponseInfo, one: ResponseAnalysis, runs: Sequence[StudyRun]
) -> Figure:
    """Draw means over pairs of factors, those whose lines are least parallel first. Raises NothingToDraw."""
    check_varies(one)
    factors = {factor.name: factor for factor in plan.factors}
    settings = [run.planned.settings for run in runs]
    pairs = []
    for first, second in itertools.combinations(one.level_means, 2):
        levels = {factors[of.factor].key: of.levels for of in (first, second)}
        pairs.append((first, second, _cell_means(one, settings, levels)))
    if not pairs:
        raise NothingToDraw("Interactions need two factors of a few levels, and these runs have none.")
    pairs = sorted(pairs, key=lambda pair: -departure(pair[2]))[:MOST_INTERACTIONS]
    width_mm = (COLUMN_MM - AXIS_MM) / min(2, len(pairs))
    longest = max(len(_short(level)) for _, second, _ in pairs for level in second.levels)
    columns = max(1, int((width_mm - 2.0) / (5.0 + LETTER_MM * longest)))
    lines = max(math.ceil(len(second.levels) / columns) for _, second, _ in pairs)
    figure, panels = _panels(len(pairs), 2, 34.0 + 3.0 * (1 + lines), printable(info.label))
    for axes, (first, second, means) in zip(panels, pairs, strict=True):
        looks = itertools.cycle(zip(LEVEL_COLOURS, LEVEL_MARKS, strict=True))
        for level, line, (colour, mark) in zip(second.levels, means.T, looks, strict=False):
            # A legend hides names that begin with an underscore.
            axes.plot(
                line, color=colour, marker=mark, markersize=2.8, linewidth=0.7, label=f" {_short(level)}"
            )
        _levels_below(axes, first.levels, width_mm - 6.0)
        axes.set_xlabel(wrapped(factor_label(factors[first.factor]), width_mm))
        axes.legend(
            title=wrapped(factor_label(factors[second.factor]), width_mm), title_fontsize=6.5, alignment="left",
            loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns, handlelength=1.2, columnspacing=0.7,
            handletextpad=0.2, borderaxespad=0.0, borderpad=0.2, labelspacing=0.2,
        )  # fmt: skip
    return figure


def draw_residuals(info: ResponseInfo, one: ResponseAnalysis) -> Figure:
    """Draw residuals against fitted values, and against a normal distribution. Raises NothingToDraw."""
    if not _has_residuals(one):
        raise NothingToDraw("The model leaves no residuals." if one.residuals else NO_MODEL)
    residuals = np.sort(one.residuals)
    figure = new_figure(48.0)
    left, right = figure.subplots(1, 2, sharey=True)
    plain_ticks(left, right)
    left.axhline(0.0, color=GREY, linewidth=0.6)
    left.plot(one.fitted, one.residuals, "o", color=BLUE, markersize=2.6, linestyle="none")
    left.set_xlabel(f"fitted{_scale(info, one)}")
    left.set_ylabel(f"residual{_scale(info, one)}")
    left.locator_params(axis="x", nbins=4)
    quantiles = special.ndtri((np.arange(len(residuals)) + 0.625) / (len(residuals) + 0.25))
    ends = quantiles[[0, -1]]
    right.plot(ends, residuals.std() * ends, color=GREY, linewidth=0.6)
    right.plot(quantiles, residuals, "o", color=BLUE, markersize=2.6, linestyle="none")
    right.set_xlabel("normal quantile (1)")
    letter_panels([left, right])
    return figure


def _has_residuals(one: ResponseAnalysis) -> bool:
    return bool(one.residuals) and one.anova is not None and one.anova.error.dof > 0


def _scale(info: ResponseInfo, one: ResponseAnalysis) -> str:
    """Return the scale of a model as the end of a label."""
    return ", ln" if one.is_log else f" ({info.unit})" if info.unit else ""


def draw_order(info: ResponseInfo, one: ResponseAnalysis, runs: Sequence[StudyRun]) -> Figure:
    """Draw a response in the order of the runs, and the residuals of the model. Raises NothingToDraw."""
    if not one.used:
        raise NothingToDraw("No run has a value.")
    order = sorted(range(len(one.used)), key=lambda n: runs[one.used[n]].planned.number)
    shown = [runs[one.used[n]] for n in order]
    number = np.array([run.planned.number for run in shown])
    values = np.array(one.values)[order]
    u95 = np.array([plain_number(run.u95(info.name)) for run in shown])
    is_center = np.array([run.planned.kind is RunKind.CENTER for run in shown])
    has_residuals = _has_residuals(one)
    figure = new_figure(82.0 if has_residuals else 50.0)
    panels = figure.subplots(1 + has_residuals, 1, sharex=True, squeeze=False).ravel()
    plain_ticks(*panels)
    for axes in panels:
        _shade_blocks(axes, shown)
    if has_residuals:
        residuals = np.array(one.residuals)[order]
        panels[1].axhline(0.0, color=GREY, linewidth=0.6)
        panels[1].plot(number, residuals, color=BLUE, linewidth=0.5)
        panels[1].set_ylabel(f"residual{_scale(info, one)}")
    for chosen, colour, mark, label in (
        (~is_center, BLUE, "o", "run"),
        (is_center, VERMILION, "D", "centre run"),
    ):
        if chosen.any():
            bars = u95[chosen] if np.isfinite(u95[chosen]).all() else None
            at = number[chosen], values[chosen], bars, colour
            draw_points(panels[0], *at, marker=mark, size=2.6, label=label)
        if has_residuals:
            panels[1].plot(
                number[chosen], residuals[chosen], mark, color=colour, markersize=2.6, linestyle="none"
            )
    panels[0].set_ylabel(wrapped(printable(info.label), 30.0))
    panels[-1].set_xlabel("run, in the order they were made")
    panels[-1].set_xlim(number[0] - 0.7, number[-1] + 0.7)
    panels[-1].xaxis.get_major_locator().set_params(integer=True)
    if is_center.any():
        shared_legend(figure, [panels[0]])
    figure.align_ylabels()
    return figure


def _shade_blocks(axes: Axes, runs: Sequence[StudyRun]) -> None:
    """Shade every second series of runs of one block."""
    for n, (_, members) in enumerate(itertools.groupby(runs, lambda run: run.planned.block)):
        numbers = [run.planned.number for run in members]
        if n % 2:
            axes.axvspan(numbers[0] - 0.5, numbers[-1] + 0.5, color=LIGHT, alpha=0.6, zorder=0, linewidth=0)


def draw_front(plan: StudyPlan, choices: Sequence[Choice]) -> Figure:
    """Draw the points over the first two objectives. Raises NothingToDraw."""
    names = [name for name, _ in plan.objectives] or [info.name for info in plan.responses]
    pair = [info for name in names[:2] if (info := plan.response(name)) is not None]
    if len(pair) < 2:
        raise NothingToDraw("A front needs two objectives, and this study has one.")
    x, y = (np.array([plain_number(one.means.get(info.name)) for one in choices]) for info in pair)
    is_known = np.isfinite(x) & np.isfinite(y)
    if not is_known.any():
        raise NothingToDraw(f"No point has means of both {pair[0].name} and {pair[1].name}.")
    front = is_known & [one.is_pareto for one in choices]
    feasible = is_known & [one.is_feasible for one in choices]
    figure = new_figure(66.0)
    axes = figure.subplots()
    plain_ticks(axes)
    other = "feasible" if plan.constraints else "other points"
    for chosen, label, mark, colour, fill in (
        (is_known & ~feasible, "constraint not kept", "x", GREY, GREY),
        (feasible & ~front, other, "o", BLUE, "white"),
        (front, "front", "o", VERMILION, VERMILION),
    ):
        if chosen.any():
            axes.plot(x[chosen], y[chosen], mark, color=colour, markerfacecolor=fill, markersize=3.8,
                      linestyle="none", label=label)  # fmt: skip
    for n in np.flatnonzero(front).tolist():
        axes.annotate(
            str(choices[n].point), (x[n], y[n]), xytext=(3, 3), textcoords="offset points", fontsize=5.8
        )
    axes.margins(0.08)
    axes.locator_params(nbins=6)
    labels = [f"{printable(info.label)}, {target_text(info)}" for info in pair]
    axes.set_xlabel(wrapped(labels[0], 70.0))
    axes.set_ylabel(wrapped(labels[1], 48.0))
    shared_legend(figure, [axes], ncols=3)
    return figure


def surface_factors(plan: StudyPlan, one: ResponseAnalysis) -> list[FactorInfo]:
    """Return the two number factors that explain most of a response, the strongest first; fewer where there are."""
    if one.model is None or one.anova is None or plan.model == "levels":
        return []
    explained = {row.name: row.adjusted_ss for row in one.anova.rows}
    strength: dict[str, float] = {}
    for term in one.model.terms:
        for name, _ in term:
            strength[name] = strength.get(name, 0.0) + explained.get(term_name(term), 0.0)
    numbers = [factor for factor in plan.factors if factor.is_number and factor.name in strength]
    return sorted(numbers, key=lambda factor: -strength[factor.name])[:2]


def other_settings(plan: StudyPlan, shown: Sequence[FactorInfo]) -> str:
    """Return the settings of the factors that a surface does not show."""
    held = [
        f"{one.name} = {level_text(uncoded(one, 0.0) if one.is_number else one.values[0])}"
        for one in plan.factors
        if one not in shown
    ]
    return f"At {', '.join(held)}." if held else ""


def draw_surface(
    plan: StudyPlan, info: ResponseInfo, one: ResponseAnalysis, runs: Sequence[StudyRun]
) -> Figure:
    """Draw the expected values over the two strongest numbers, the others in the middle. Raises NothingToDraw."""
    shown = surface_factors(plan, one)
    if one.model is None and one.anova is not None:
        raise NothingToDraw("The model needs every point: its expectations cannot be verified.")
    if len(shown) < 2 or one.model is None:
        raise NothingToDraw(
            "A surface needs a model of two numbers or more; this one has levels without order."
        )
    coded = np.linspace(-1.0, 1.0, GRID)
    grids = dict(zip([factor.name for factor in shown], np.meshgrid(coded, coded), strict=True))
    settings = _grid_settings(plan, one, runs, {name: grid.ravel() for name, grid in grids.items()})
    expected = one.model.predict(settings)[0].reshape(GRID, GRID)
    if np.ptp(expected) <= 1e-9 * max(1.0, float(np.abs(expected).max())):
        raise NothingToDraw("The model is flat over these two numbers.")
    figure = new_figure(66.0)
    axes = figure.subplots()
    plain_ticks(axes)
    x, y = (uncoded(factor, coded) for factor in shown)
    filled = axes.contourf(x, y, expected, levels=9, cmap="Blues")
    axes.contour(x, y, expected, levels=filled.levels, colors=FAINT, linewidths=0.4)
    at = {tuple(float(runs[row].planned.settings[factor.key]) for factor in shown) for row in one.used}
    axes.plot(*zip(*sorted(at), strict=True), "o", color=BLACK, markersize=3.0, markeredgecolor="white",
              markeredgewidth=0.4, linestyle="none", clip_on=False, zorder=3.0)  # fmt: skip
    for factor, axis, set_scale in (
        (shown[0], axes.xaxis, axes.set_xscale),
        (shown[1], axes.yaxis, axes.set_yscale),
    ):
        if factor.is_log:
            set_scale("log")
            plain_log_ticks(axis)
    axes.set(xlim=x[[0, -1]], ylim=y[[0, -1]])
    axes.grid(visible=False)
    axes.set_xlabel(wrapped(factor_label(shown[0]), 55.0))
    axes.set_ylabel(wrapped(factor_label(shown[1]), 48.0))
    bar = figure.colorbar(filled, ax=axes, aspect=25.0, format="{x:g}")
    bar.set_label(wrapped(f"expected {printable(info.label)}", 48.0))
    bar.outline.set_linewidth(0.6)
    return figure


def _grid_settings(
    plan: StudyPlan, one: ResponseAnalysis, runs: Sequence[StudyRun], shown: Mapping[str, Array]
) -> Settings:
    """Return the settings of a grid: other numbers in the middle, categories at their first name."""
    count = GRID * GRID
    numbers = {f.name: shown.get(f.name, np.zeros(count)) for f in plan.factors if f.is_number}
    names = {}
    for factor in (factor for factor in plan.factors if not factor.is_number):
        used = {runs[row].planned.settings[factor.key] for row in one.used}
        names[factor.name] = [value for value in factor.values if value in used]
    return Settings(numbers, {name: of[:1] * count for name, of in names.items()}, names)
