"""What the factors of a study do on average: means by level, and whether one factor changes what another does."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from scipy import special

from edmctl.report.style import (
    BLACK,
    BLUE,
    COLUMN_MM,
    DASHED,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    VERMILION,
    NothingToDraw,
    draw_points,
    new_figure,
)
from edmctl.study.report.study_words import factor_label, in_order, level_text
from edmctl.study.results import ResponseInfo, StudyPlan, StudyRun
from edmctl.study.statistics.response_analysis import Interaction, ResponseAnalysis
from edmctl.wording import printable

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LETTER_MM, SMALL_LETTER_MM = 1.45, 1.35
"""Mean widths of a letter of a label, and of a tick."""
AXIS_MM = 14.0
"""What the labels of the vertical axis take."""
MOST_COLUMNS, ROW_MM = 4, 38.0
MOST_INTERACTIONS = 6
LEVEL_COLOURS = (BLUE, VERMILION, GREEN, ORANGE, PURPLE, SKY, BLACK, GREY)
LEVEL_MARKS = "os^Dv<>P"
_MANY_LEVELS = "Means by level need factors of a few levels, and these runs have none."


def wrapped(text: str, mm: float) -> str:
    """Break a label into lines that are no longer than a side of its panel."""
    return "\n".join(textwrap.wrap(text, max(6, int(mm / LETTER_MM)))[:4])


def plain_ticks(*panels: Axes) -> None:
    """Write every tick out: a power of ten above a panel would lie on what stands there."""
    for axes in panels:
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_formatter("{x:g}")


def check_varies(one: ResponseAnalysis) -> None:
    """Raise NothingToDraw where all runs have the same value, or there are none."""
    if not one.values:
        raise NothingToDraw("No run has a value.")
    if min(one.values) == max(one.values):
        raise NothingToDraw("All runs have the same value.")


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
    columns = min(MOST_COLUMNS, len(table))
    width_mm = (COLUMN_MM - AXIS_MM) / columns
    rows = math.ceil(len(table) / columns)
    names = {name: wrapped(labels.get(name, name), width_mm) for name in table}
    turned = any(
        (SMALL_LETTER_MM * max(len(level_text(level)) for level, _ in pairs) + 1.5) * len(pairs)
        > width_mm - 2.0
        for pairs in table.values()
    )
    longest = max(len(level_text(level)) for pairs in table.values() for level, _ in pairs)
    lines = max(text.count("\n") for text in names.values())
    row_mm = ROW_MM + 2.7 * lines + (SMALL_LETTER_MM * min(longest, 20) if turned else 0.0)
    figure = new_figure(6.0 + row_mm * rows)
    panels = figure.subplots(rows, columns, sharey=True, squeeze=False).ravel()
    for axes, (name, pairs) in zip(panels, table.items(), strict=False):
        plain_ticks(axes)
        means = np.array([mean for _, mean in pairs])
        axes.axhline(middle, color=GREY, linewidth=0.6, linestyle=DASHED)
        axes.plot(range(len(means)), means, color=BLUE)
        draw_points(axes, range(len(means)), means, _bars(means, halves.get(name), is_log), BLUE)
        texts = [level_text(level) for level, _ in pairs]
        axes.set_xticks(range(len(means)), [text if len(text) <= 20 else f"{text[:19]}…" for text in texts])
        axes.tick_params(axis="x", rotation=90.0 if turned else 0.0)
        axes.set_xlim(-0.4, len(means) - 0.6)
        axes.grid(visible=False, axis="x")
        axes.set_xlabel(names[name])
    for axes in panels[len(table) :]:
        axes.remove()
    for axes in panels[::columns]:
        axes.set_ylabel(wrapped(label, 30.0))
    return figure


def _bars(means: np.ndarray, halves: list[float] | None, is_log: bool) -> np.ndarray | None:
    if halves is None or not np.isfinite(halves).all():
        return None
    half = np.asarray(halves)
    return np.array([means * (1 - np.exp(-half)), means * (np.exp(half) - 1)]) if is_log else half


def departure(one: Interaction) -> float:
    """Return how far the lines of two factors are from parallel: the rms of what is left of the means."""
    cells = np.asarray(one.means)
    rest = cells - np.nanmean(cells) if np.isfinite(cells).all() else np.full((1, 1), math.nan)
    if not np.isfinite(rest).all():
        return -1.0
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
    columns = min(2, len(chosen))
    width_mm = (COLUMN_MM - AXIS_MM) / columns
    rows = math.ceil(len(chosen) / columns)
    legend_lines = 1 + max(
        math.ceil(len(pair.other_levels) / _legend_columns(pair, width_mm)) for pair in chosen
    )
    figure = new_figure(4.0 + rows * (34.0 + 3.0 * legend_lines))
    panels = figure.subplots(rows, columns, sharey=True, squeeze=False).ravel()
    for axes, pair in zip(panels, chosen, strict=False):
        _draw_interaction(axes, pair, labels, width_mm)
    for axes in panels[len(chosen) :]:
        axes.remove()
    for axes in panels[::columns]:
        axes.set_ylabel(wrapped(printable(info.label), 30.0))
    return figure


def _legend_columns(pair: Interaction, width_mm: float) -> int:
    entry_mm = 5.0 + SMALL_LETTER_MM * min(20, max(len(level_text(level)) for level in pair.other_levels))
    return max(1, min(len(pair.other_levels), int((width_mm - 2.0) / entry_mm)))


def _draw_interaction(axes: Axes, pair: Interaction, labels: dict[str, str], width_mm: float) -> None:
    plain_ticks(axes)
    at = range(len(pair.one_levels))
    for n, level in enumerate(pair.other_levels):
        colour, mark = LEVEL_COLOURS[n % len(LEVEL_COLOURS)], LEVEL_MARKS[n % len(LEVEL_MARKS)]
        means = [row[n] for row in pair.means]
        # A space before it: names that begin with a line are no secret to a legend.
        text = f" {level_text(level)[:20]}"
        axes.plot(at, means, color=colour, marker=mark, markersize=2.8, linewidth=0.7, label=text)
    turned = (max(len(level_text(level)) for level in pair.one_levels) * SMALL_LETTER_MM + 1.5) * len(
        at
    ) > width_mm - 6.0
    axes.set_xticks(at, [level_text(level)[:20] for level in pair.one_levels], rotation=90 if turned else 0)
    axes.set_xlim(-0.3, len(at) - 0.7)
    axes.grid(visible=False, axis="x")
    axes.set_xlabel(wrapped(labels.get(pair.one, pair.one), width_mm))
    axes.legend(
        title=wrapped(labels.get(pair.other, pair.other), width_mm), title_fontsize=6.5, alignment="left",
        loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=_legend_columns(pair, width_mm), handlelength=1.2,
        columnspacing=0.7, handletextpad=0.2, borderaxespad=0.0, borderpad=0.2, labelspacing=0.2,
    )  # fmt: skip
