"""Figures of a study: effects, quality of the fit, the Pareto front, surfaces and Sobol indices."""

from __future__ import annotations

import itertools
import math
import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import special

from edmctl.report.panels import (
    draw_points,
    legend_above,
    letter_panels,
    new_figure,
    plain_log_ticks,
    shared_legend,
)
from edmctl.report.style import (
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
)
from edmctl.study.design import uncoded
from edmctl.study.report.words import factor_label, in_order, level_text, wanted
from edmctl.study.results import Choice, FactorInfo, ResponseInfo, RunKind, StudyPlan, StudyRun
from edmctl.study.statistics.choice import SobolIndices
from edmctl.study.statistics.linear_model import Settings, term_name
from edmctl.study.statistics.response_analysis import Interaction, ResponseAnalysis
from edmctl.wording import plain_number, printable

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


LETTER_MM, SMALL_LETTER_MM = 1.45, 1.35
"""Mean widths of a letter of a label, and of a tick."""
AXIS_MM = 14.0
"""What the labels of the vertical axis take."""
MOST_COLUMNS, ROW_MM = 4, 38.5
MOST_INTERACTIONS = 6
MOST_LETTERS = 20
"""Of a level below a panel or in a legend."""
LEVEL_COLOURS = (BLUE, VERMILION, GREEN, ORANGE, PURPLE, SKY, BLACK, GREY)
LEVEL_MARKS = "os^Dv<>P"
_MANY_LEVELS = "Means by level need factors of a few levels, and these runs have none."


def wrapped(text: str, mm: float) -> str:
    """Break a label into lines that are no longer than a side of its panel."""
    return "\n".join(textwrap.wrap(text, max(6, int(mm / LETTER_MM)))[:4])


def plain_ticks(*panels: Axes) -> None:
    """Write every tick in full: a power of ten above a panel would cover other text."""
    for axes in panels:
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_formatter("{x:g}")


def check_varies(one: ResponseAnalysis) -> None:
    """Raise NothingToDraw where all runs have the same value, or there are none."""
    if not one.values:
        raise NothingToDraw("No run has a value.")
    if min(one.values) == max(one.values):
        raise NothingToDraw("All runs have the same value.")


def _panels(count: int, most: int, row_mm: float, label: str) -> tuple[Figure, list[Axes]]:
    """A figure of panels in rows that share their vertical axis, with its label before each row."""
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


def _levels_across(axes: Axes, levels: Sequence[object], width_mm: float) -> None:
    """Write the levels of a factor below a panel, upright where they need more than its width."""
    texts = [level_text(level) for level in levels]
    is_turned = _is_turned(levels, width_mm)
    shown = [text if len(text) <= MOST_LETTERS else f"{text[: MOST_LETTERS - 1]}…" for text in texts]
    axes.set_xticks(range(len(texts)), shown, rotation=90.0 if is_turned else 0.0)
    axes.grid(visible=False, axis="x")


def _is_turned(levels: Sequence[object], width_mm: float) -> bool:
    longest = max(len(level_text(level)) for level in levels)
    return (SMALL_LETTER_MM * longest + 1.5) * len(levels) > width_mm


def draw_main_effects(
    plan: StudyPlan, info: ResponseInfo, one: ResponseAnalysis, runs: Sequence[StudyRun]
) -> Figure:
    """Draw the mean by level of every factor, with the 95 % interval of each mean. Raises NothingToDraw."""
    check_varies(one)
    table = {means.factor: in_order(plan, means) for means in one.level_means}
    halves = {
        name: [_half(plan, one, runs, name, level) for level, _ in pairs] for name, pairs in table.items()
    }
    return _means(plan, table, halves, printable(info.label), one.mean, is_log=one.is_log)


def draw_noise_effects(plan: StudyPlan, one: ResponseAnalysis) -> Figure:
    """Draw the mean signal-to-noise ratio by level of every factor. Raises NothingToDraw."""
    check_varies(one)
    if one.level_means and not one.noise_means:
        raise NothingToDraw(
            "The signal-to-noise ratio of a point is not defined: nominal is best asks for replicates that differ, "
            "the others for values that are not zero."
        )
    table = {means.factor: in_order(plan, means) for means in one.noise_means}
    middle = float(np.mean([mean for pairs in table.values() for _, mean in pairs])) if table else math.nan
    return _means(plan, table, {}, "S/N (dB)", middle)


def _half(
    plan: StudyPlan, one: ResponseAnalysis, runs: Sequence[StudyRun], name: str, level: object
) -> float:
    """Half the 95 % interval of a level's mean, on the model's scale, by what F compares with; NaN without that."""
    under = one.anova.under(name) if one.anova is not None else None
    if under is None or not under.dof or not math.isfinite(under.mean_square):
        return math.nan
    key = next(factor.key for factor in plan.factors if factor.name == name)
    count = sum(runs[row].planned.settings[key] == level for row in one.used)
    quantile = float(special.stdtrit(under.dof, 0.975))
    return quantile * math.sqrt(under.mean_square / count) if count else math.nan


def _means(
    plan: StudyPlan,
    table: dict[str, list[tuple[object, float]]],
    halves: dict[str, list[float]],
    label: str,
    middle: float,
    *,
    is_log: bool = False,
) -> Figure:
    if not table:
        raise NothingToDraw(_MANY_LEVELS)
    labels = {factor.name: factor_label(factor) for factor in plan.factors}
    levels = {name: [level for level, _ in pairs] for name, pairs in table.items()}
    width_mm = (COLUMN_MM - AXIS_MM) / min(MOST_COLUMNS, len(table))
    names = {name: wrapped(labels.get(name, name), width_mm) for name in table}
    row_mm = ROW_MM + 2.7 * max(text.count("\n") for text in names.values())
    if any(_is_turned(of, width_mm - 2.0) for of in levels.values()):
        longest = max(len(level_text(level)) for of in levels.values() for level in of)
        row_mm += SMALL_LETTER_MM * min(longest, MOST_LETTERS)
    figure, panels = _panels(len(table), MOST_COLUMNS, row_mm, label)
    for axes, (name, pairs) in zip(panels, table.items(), strict=True):
        means, half = np.array([mean for _, mean in pairs]), np.asarray(halves.get(name, [math.nan]))
        bars = np.array([means * (1 - np.exp(-half)), means * (np.exp(half) - 1)]) if is_log else half
        axes.axhline(middle, color=GREY, linewidth=0.6, linestyle=DASHED)
        axes.plot(range(len(means)), means, color=BLUE)
        draw_points(axes, range(len(means)), means, bars if np.isfinite(half).all() else None, BLUE)
        _levels_across(axes, levels[name], width_mm - 2.0)
        axes.set_xlim(-0.4, len(means) - 0.6)
        axes.set_xlabel(names[name])
    return figure


def departure(one: Interaction) -> float:
    """Return how far the lines of two factors are from parallel: the rms of what is left of the means."""
    cells = np.asarray(one.means)
    if not np.isfinite(cells).all():
        return -1.0
    rest = cells - cells.mean()
    rest = rest - rest.mean(axis=0) - rest.mean(axis=1)[:, None]
    return float(np.sqrt((rest**2).mean()))


def draw_interactions(plan: StudyPlan, info: ResponseInfo, one: ResponseAnalysis) -> Figure:
    """Draw means over pairs of factors, those whose lines are least parallel first. Raises NothingToDraw."""
    check_varies(one)
    if not one.interactions:
        raise NothingToDraw(
            "Interactions need two factors of a few levels, and these runs have not got them."
        )
    chosen = sorted(one.interactions, key=lambda pair: -departure(pair))[:MOST_INTERACTIONS]
    labels = {factor.name: factor_label(factor) for factor in plan.factors}
    width_mm = (COLUMN_MM - AXIS_MM) / min(2, len(chosen))
    lines = max(math.ceil(len(pair.other_levels) / _legend_columns(pair, width_mm)) for pair in chosen)
    figure, panels = _panels(len(chosen), 2, 34.0 + 3.0 * (1 + lines), printable(info.label))
    for axes, pair in zip(panels, chosen, strict=True):
        at = range(len(pair.one_levels))
        for n, level in enumerate(pair.other_levels):
            colour, mark = LEVEL_COLOURS[n % len(LEVEL_COLOURS)], LEVEL_MARKS[n % len(LEVEL_MARKS)]
            # A legend hides names that begin with an underscore.
            axes.plot(
                at, [row[n] for row in pair.means], color=colour, marker=mark, markersize=2.8, linewidth=0.7,
                label=f" {level_text(level)[:MOST_LETTERS]}",
            )  # fmt: skip
        _levels_across(axes, pair.one_levels, width_mm - 6.0)
        axes.set_xlim(-0.3, len(at) - 0.7)
        axes.set_xlabel(wrapped(labels.get(pair.one, pair.one), width_mm))
        axes.legend(
            title=wrapped(labels.get(pair.other, pair.other), width_mm), title_fontsize=6.5, alignment="left",
            loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=_legend_columns(pair, width_mm),
            handlelength=1.2, columnspacing=0.7, handletextpad=0.2, borderaxespad=0.0, borderpad=0.2,
            labelspacing=0.2,
        )  # fmt: skip
    return figure


def _legend_columns(pair: Interaction, width_mm: float) -> int:
    longest = max(len(level_text(level)) for level in pair.other_levels)
    entry_mm = 5.0 + SMALL_LETTER_MM * min(MOST_LETTERS, longest)
    return max(1, min(len(pair.other_levels), int((width_mm - 2.0) / entry_mm)))


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
    u95 = np.array([plain_number(run.u95(info.name)) for run in mine])
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


def _shade_blocks(axes: Axes, runs: Sequence[StudyRun], *, is_named: bool) -> None:
    """Shade every second stretch of runs of one block, and name the stretches where there is room."""
    stretches = [
        (block, [run.planned.number for run in members])
        for block, members in itertools.groupby(runs, lambda run: run.planned.block)
    ]
    for n, (block, numbers) in enumerate(stretches):
        low, high = numbers[0] - 0.5, numbers[-1] + 0.5
        if n % 2:
            axes.axvspan(low, high, color=LIGHT, alpha=0.6, zorder=0, linewidth=0)
        if is_named and 2 <= len(stretches) <= MOST_BLOCKS:
            axes.annotate(
                f"block {block}" if len(stretches) <= 4 else str(block), ((low + high) / 2, 1.0),
                xycoords=("data", "axes fraction"), xytext=(0, 2), textcoords="offset points",
                ha="center", va="bottom", fontsize=6.5, color=FAINT,
            )  # fmt: skip


GRID = 41
LEVELS = 9
"""Steps of a surface's colours."""
LABEL_PT = 5.8
SURFACE_MAP = "Blues"


def draw_front(plan: StudyPlan, choices: Sequence[Choice]) -> Figure:
    """Draw the points over the first two objectives. Raises NothingToDraw."""
    names = [name for name, _ in plan.objectives] or [info.name for info in plan.responses]
    pair = [info for name in names[:2] if (info := plan.response(name)) is not None]
    if len(pair) < 2:
        raise NothingToDraw("A front needs two objectives, and this study has one.")
    x, y = (np.array([plain_number(one.means.get(info.name)) for one in choices]) for info in pair)
    there = np.isfinite(x) & np.isfinite(y)
    if not there.any():
        raise NothingToDraw(f"No point has means of both {pair[0].name} and {pair[1].name}.")
    front = there & [one.is_pareto for one in choices]
    feasible = there & [one.is_feasible for one in choices]
    figure = new_figure(66.0)
    axes = figure.subplots()
    plain_ticks(axes)
    kinds = (
        (there & ~feasible, "constraint not kept", {"marker": "x", "color": GREY}),
        (feasible & ~front, "feasible" if plan.constraints else "other points",
         {"marker": "o", "color": BLUE, "markerfacecolor": "white"}),
        (front, "front", {"marker": "o", "color": VERMILION}),
    )  # fmt: skip
    for chosen, label, look in kinds:
        if chosen.any():
            axes.plot(x[chosen], y[chosen], linestyle="none", markersize=3.8, label=label, **look)  # type: ignore[arg-type]
    axes.margins(0.08)
    axes.locator_params(nbins=6)
    for set_label, info, mm in ((axes.set_xlabel, pair[0], 70.0), (axes.set_ylabel, pair[1], 48.0)):
        set_label(wrapped(f"{printable(info.label)}, {wanted(info)}", mm))
    shared_legend(figure, [axes], ncols=3)
    figure.draw_without_rendering()
    _name_points(axes, x, y, [str(one.point) if front[n] else "" for n, one in enumerate(choices)])
    return figure


def _name_points(axes: Axes, x: NDArray[np.float64], y: NDArray[np.float64], names: Sequence[str]) -> None:
    """Put names beside points where there is room: none lies on another, on a point or beyond the panel."""
    scale = axes.figure.dpi / 72.0
    there = np.isfinite(x) & np.isfinite(y)
    at = axes.transData.transform(np.column_stack([x, y]))
    box = axes.get_window_extent()
    taken = [(px - 2 * scale, py - 2 * scale, px + 2 * scale, py + 2 * scale) for px, py in at[there]]
    for n, name in enumerate(names):
        if not name or not there[n]:
            continue
        width, height = 0.66 * LABEL_PT * len(name) * scale, LABEL_PT * scale
        for right, up in ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, 1), (1, -1), (-1, -1)):
            middle = at[n] + np.array([right * (width / 2 + 3 * scale), up * (height / 2 + 3 * scale)])
            half = np.array([width / 2, height / 2])
            low, high = middle - half, middle + half
            inside = low[0] > box.x0 and low[1] > box.y0 and high[0] < box.x1 and high[1] < box.y1
            if inside and all(high[0] < a or low[0] > c or high[1] < b or low[1] > d for a, b, c, d in taken):
                taken.append((low[0], low[1], high[0], high[1]))
                offset = (middle - at[n]) / scale
                axes.annotate(
                    name, (x[n], y[n]), xytext=tuple(offset), textcoords="offset points", ha="center",
                    va="center", fontsize=LABEL_PT, color=BLACK,
                )  # fmt: skip
                break


def surface_factors(plan: StudyPlan, one: ResponseAnalysis) -> list[FactorInfo]:
    """Return the two number factors that explain most of a response, the strongest first; fewer where there are."""
    if one.model is None or one.anova is None or plan.model in ("levels", "sensitivity"):
        return []
    explained = {row.name: row.adjusted_ss for row in one.anova.rows}
    strength: dict[str, float] = {}
    for term in one.model.terms:
        for name, _ in term:
            strength[name] = strength.get(name, 0.0) + explained.get(term_name(term), 0.0)
    numbers = [factor for factor in plan.factors if factor.is_number and factor.name in strength]
    return sorted(numbers, key=lambda factor: -strength[factor.name])[:2]


def others_in_words(plan: StudyPlan, shown: Sequence[FactorInfo]) -> str:
    """Return where a surface holds the factors that it does not show."""
    told = [
        f"{one.name} = {level_text(uncoded(one, 0.0) if one.is_number else one.values[0])}"
        for one in plan.factors
        if one not in shown
    ]
    return f"At {', '.join(told)}." if told else ""


def draw_surface(
    plan: StudyPlan, info: ResponseInfo, one: ResponseAnalysis, runs: Sequence[StudyRun]
) -> Figure:
    """Draw what the model expects over its two strongest numbers, the others in the middle. Raises NothingToDraw."""
    shown = surface_factors(plan, one)
    if plan.model == "sensitivity":
        raise NothingToDraw("A study of sensitivity fits no surface.")
    if one.model is None and one.anova is not None:
        raise NothingToDraw("The model needs every point: there is nothing to judge what it expects by.")
    if len(shown) < 2 or one.model is None:
        raise NothingToDraw(
            "A surface needs a model of two numbers or more; this one takes levels as they come."
        )
    coded = np.linspace(-1.0, 1.0, GRID)
    across, up = (grid.ravel() for grid in np.meshgrid(coded, coded))
    settings = _held(plan, one, runs, {shown[0].name: across, shown[1].name: up}, GRID * GRID)
    expected = one.model.predict(settings)[0].reshape(GRID, GRID)
    figure = new_figure(66.0)
    axes = figure.subplots()
    x, y = (uncoded(factor, coded) for factor in shown)
    if np.ptp(expected) <= 1e-9 * max(1.0, float(np.abs(expected).max())):
        raise NothingToDraw("The model is flat over these two numbers.")
    plain_ticks(axes)
    filled = axes.contourf(x, y, expected, levels=LEVELS, cmap=SURFACE_MAP)
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
    axes.set_xlim(x[0], x[-1])
    axes.set_ylim(y[0], y[-1])
    axes.grid(visible=False)
    axes.set_xlabel(wrapped(factor_label(shown[0]), 55.0))
    axes.set_ylabel(wrapped(factor_label(shown[1]), 48.0))
    bar = figure.colorbar(filled, ax=axes, aspect=25.0, format="{x:g}")
    bar.set_label(wrapped(f"expected {printable(info.label)}", 48.0))
    bar.outline.set_linewidth(0.6)
    return figure


def _held(
    plan: StudyPlan,
    one: ResponseAnalysis,
    runs: Sequence[StudyRun],
    shown: Mapping[str, NDArray[np.float64]],
    count: int,
) -> Settings:
    """Settings of a grid: numbers that are not shown in the middle, categories at their first name."""
    numbers = {f.name: shown.get(f.name, np.zeros(count)) for f in plan.factors if f.is_number}
    names = {}
    for factor in (factor for factor in plan.factors if not factor.is_number):
        there = {runs[row].planned.settings[factor.key] for row in one.used}
        names[factor.name] = [value for value in factor.values if value in there]
    return Settings(numbers, {name: of[:1] * count for name, of in names.items()}, names)


def draw_indices(plan: StudyPlan, found: SobolIndices) -> Figure:
    """Draw the Sobol indices of a response with their intervals, the strongest factor above."""
    order = np.argsort(found.total)
    figure = new_figure(18.0 + 8.0 * len(order))
    axes = figure.subplots()
    at = np.arange(len(order))
    columns = (
        (0.2, found.first_order, found.first_order_u95, BLUE, "first order"),
        (-0.2, found.total, found.total_u95, ORANGE, "total"),
    )
    for offset, index, u95, colour, label in columns:
        axes.barh(
            at + offset, index[order], 0.36, xerr=u95[order], color=colour, label=label,
            error_kw={"elinewidth": 0.7, "capsize": 1.8, "capthick": 0.7},
        )  # fmt: skip
    axes.axvline(0.0, color=BLACK, linewidth=0.6)
    axes.set_yticks(at, [wrapped(printable(plan.factors[n].name), COLUMN_MM / 3) for n in order])
    axes.grid(visible=False, axis="y")
    top = float(np.nanmax(found.total + found.total_u95)) if np.isfinite(found.total).any() else math.nan
    axes.set_xlim(min(0.0, float(np.nanmin(found.first_order - found.first_order_u95, initial=0.0))), max(1.0, top)
                  if math.isfinite(top) else 1.0)  # fmt: skip
    axes.set_xlabel("share of the variance (1)")
    legend_above(axes)
    return figure
