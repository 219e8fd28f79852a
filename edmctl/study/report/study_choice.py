"""What to choose of a study: objectives against each other, a response over two factors, and what it depends on."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from edmctl.report.style import (
    BLACK,
    BLUE,
    COLUMN_MM,
    FAINT,
    GREY,
    ORANGE,
    VERMILION,
    NothingToDraw,
    legend_above,
    new_figure,
    plain_log_ticks,
    shared_legend,
)
from edmctl.study.report.study_effects import plain_ticks, wrapped
from edmctl.study.report.study_words import factor_label, level_text, wanted
from edmctl.study.results import Choice, FactorInfo, ResponseInfo, StudyPlan, StudyRun
from edmctl.study.statistics.linear_model import Settings, term_name
from edmctl.study.statistics.response_analysis import ResponseAnalysis
from edmctl.study.statistics.sensitivity import SobolIndices
from edmctl.wording import plain_number, printable

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

GRID = 41
LEVELS = 9
"""Steps of a surface's colours."""
LABEL_PT = 5.8
SURFACE_MAP = "Blues"


def shown_objectives(plan: StudyPlan) -> list[ResponseInfo]:
    """Return the two responses that the front is drawn over: the first objectives, or the first responses."""
    infos = {info.name: info for info in plan.responses}
    return [infos[name] for name in ([name for name, _ in plan.objectives] or list(infos))][:2]


def draw_front(plan: StudyPlan, choices: Sequence[Choice]) -> Figure:
    """Draw the points over the first two objectives. Raises NothingToDraw."""
    pair = shown_objectives(plan)
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
        f"{one.name} = {level_text(_value(one, 0.0) if one.is_number else one.values[0])}"
        for one in plan.factors
        if one not in shown
    ]
    return f"At {', '.join(told)}." if told else ""


def _value(factor: FactorInfo, coded: float) -> float:
    """The value of a coded number."""
    return float(_values(factor, np.array([coded]))[0])


def _values(factor: FactorInfo, coded: ArrayLike) -> NDArray[np.float64]:
    numbers = [float(value) for value in factor.values]
    low, high, share = min(numbers), max(numbers), (np.asarray(coded, float) + 1) / 2
    return low * (high / low) ** share if factor.is_log else low + (high - low) * share


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
    x, y = (_values(factor, coded) for factor in shown)
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
    numbers, categories, names = (
        dict[str, "ArrayLike"](),
        dict[str, list[object]](),
        dict[str, list[object]](),
    )
    for factor in plan.factors:
        if factor.is_number:
            numbers[factor.name] = shown.get(factor.name, np.zeros(count))
            continue
        there = {runs[row].planned.settings[factor.key] for row in one.used}
        names[factor.name] = [value for value in factor.values if value in there]
        categories[factor.name] = [names[factor.name][0]] * count
    return Settings(numbers, categories, names)


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
