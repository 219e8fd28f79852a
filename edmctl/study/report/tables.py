"""The tables of a study's page: each is declared by its columns, a header and the cell of a record."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import TypeVar

from edmctl.report.html import PageTable
from edmctl.study.report.words import (
    differing_words,
    in_order,
    interval_text,
    level_text,
    p_text,
    points_needed,
    settings_text,
    wanted,
    why_not_predicted,
)
from edmctl.study.results import (
    Choice,
    Confirmation,
    ConfirmedResponse,
    FactorInfo,
    Recommendation,
    ResponseInfo,
    StudyPlan,
    StudyRun,
)
from edmctl.study.statistics.choice import SobolIndices
from edmctl.study.statistics.linear_model import BLOCK, Anova, AnovaRow
from edmctl.study.statistics.response_analysis import LevelMeans, ResponseAnalysis
from edmctl.wording import UNKNOWN, decimal, plain_number, plural, significant, to_its_u95

Record = TypeVar("Record")
Columns = Iterable[tuple[str, Callable[[Record], str]]]

MOST_CHOICES, MOST_RUNS = 60, 1000
"""Rows of the longest tables; the rest is counted."""
_POOLING = (
    "Pooling counts the weakest terms as error. It makes F of those that stay too large, because the weakest were "
    "chosen: it suggests what to confirm, and proves nothing."
)


def _table(
    caption: str,
    records: Iterable[Record],
    columns: Columns[Record],
    note: str = "",
    *,
    words: bool = False,
    most: int | None = None,
    without_empty: bool = False,
) -> PageTable:
    """Return a table of records.

    most : further rows are counted in the note
    without_empty : columns in which all cells are empty are left out
    """
    header, cells = zip(*columns, strict=True)
    rows = [[cell(one) for cell in cells] for one in records]
    kept = [n for n in range(len(header)) if not without_empty or n == 0 or any(row[n] for row in rows)]
    shown = [[row[n] for n in kept] for row in rows[:most]]
    if len(rows) > len(shown):
        note = f"{note} {plural(len(rows) - len(shown), 'more row')} not shown.".strip()
    return PageTable(caption, [header[n] for n in kept], shown, note, words)


def factors(plan: StudyPlan) -> PageTable:
    """Every factor with its levels."""

    def levels(one: FactorInfo) -> str:
        return (" to " if one.is_range else ", ").join(map(level_text, one.values))

    def scale(one: FactorInfo) -> str:
        if not one.is_number:
            return "categories"
        return f"{'logarithmic' if one.is_log else 'linear'}{' range' if one.is_range else ''}"

    columns: Columns[FactorInfo] = [
        ("factor", lambda one: one.name),
        ("key", lambda one: one.key),
        ("levels", levels),
        ("scale", scale),
    ]
    return _table("Factors", plan.factors, columns, words=True)


def responses(plan: StudyPlan) -> PageTable:
    """Every response and what is wanted of it."""
    weights = dict(plan.objectives)
    columns: Columns[ResponseInfo] = [
        ("response", lambda one: one.name),
        ("unit", lambda one: one.unit or "1"),
        ("wanted", wanted),
        ("modelled", lambda one: "logarithmic" if one.is_log else "linear"),
        ("from", lambda one: "told by hand" if one.is_manual else "the job"),
        ("weight as objective", lambda one: f"{weights[one.name]:g}" if one.name in weights else ""),
        (
            "constraint",
            lambda one: ", ".join(str(bound) for bound in plan.constraints if bound.response == one.name),
        ),
    ]
    return _table("Responses", plan.responses, columns, words=True, without_empty=True)


def degrees_of_freedom(plan: StudyPlan) -> PageTable:
    """Degrees of freedom of the planned runs, by term."""
    rows = [[name, str(dof)] for name, dof in (*plan.dof.items(), ("total", sum(plan.dof.values())))]
    return PageTable("Degrees of freedom, as planned", ["term", "degrees of freedom"], rows)


def analysis_of_variance(one: ResponseAnalysis) -> list[PageTable]:
    """The table without and with pooling."""
    if one.anova is None:
        return []
    of_what = f"ln {one.name}" if one.is_log else one.name
    made = [_anova(f"Analysis of variance of {of_what}, nothing pooled", one.anova)]
    if one.pooled is not None:
        caption = (
            f"Analysis of variance of {of_what}, pooled: {', '.join(one.pooled.pooled)} counted as error"
        )
        made.append(_anova(caption, one.pooled, _POOLING))
    return made


def _anova(caption: str, table: Anova, note: str = "") -> PageTable:
    columns: Columns[AnovaRow] = [
        ("term", lambda row: row.name),
        ("dof", lambda row: str(row.dof)),
        ("seq. SS", lambda row: significant(row.sequential_ss, 4)),
        ("adj. SS", lambda row: significant(row.adjusted_ss, 4)),
        ("mean square", lambda row: significant(row.mean_square, 4)),
        ("F", lambda row: significant(row.f, 4)),
        ("p", lambda row: p_text(row.p)),
        ("share of seq. SS, %", lambda row: decimal(row.contribution_pct)),
        ("less error, %", lambda row: decimal(row.pure_pct)),
    ]
    notes = " ".join(filter(None, [why_no_f(table), differing_words(table), note]))
    return _table(caption, (*table.rows, table.error, table.total), columns, notes)


def why_no_f(table: Anova) -> str:
    """Return why no F of a term can be given; empty where there is one."""
    if not table.rows or all(math.isfinite(row.f) for row in table.rows):
        return ""
    if not table.error.dof:
        return "No F: no degrees of freedom are left to estimate the error."
    return "No F: the model leaves no error to compare with."


def measured_and_true(measured: ResponseAnalysis, true: ResponseAnalysis) -> PageTable | None:
    """The analysis of measured values beside that of true ones."""
    if measured.anova is None or true.anova is None:
        return None
    both = [{row.name: row for row in (*table.rows, table.error)} for table in (measured.anova, true.anova)]
    rows = []
    for name in dict.fromkeys((*both[0], *both[1])):
        cells = [name]
        for row in (of.get(name) for of in both):
            cells += (
                [str(row.dof), significant(row.f, 4), p_text(row.p), decimal(row.contribution_pct)]
                if row is not None
                else [UNKNOWN] * 4
            )
        rows.append(cells)
    header = [
        "term",
        *(f"{what}, {of}" for of in ("measured", "true") for what in ("dof", "F", "p", "seq. share %")),
    ]
    note = (
        f"True values are what the virtual machine knows: mean {significant(true.mean, 4)}, measured "
        f"{significant(measured.mean, 4)}. What acts on the measured value alone "
        "may be an effect on the measurement."
    )
    return PageTable("Measured and true (simulated)", header, rows, note)


def response_table(
    caption: str, plan: StudyPlan, found: Sequence[LevelMeans], note: str = ""
) -> PageTable | None:
    """Means by level with their range and rank."""
    if not found:
        return None

    def means(one: LevelMeans) -> list[str]:
        return [f"{level_text(level)}: {significant(mean, 4)}" for level, mean in in_order(plan, one)]

    most = max(len(one.levels) for one in found)
    rows = [
        [
            one.factor,
            *means(one),
            *[""] * (most - len(one.levels)),
            significant(one.delta, 4),
            str(one.rank),
        ]
        for one in found
    ]
    header = ["factor", *(f"level {n + 1}" for n in range(most)), "delta", "rank"]
    return PageTable(caption, header, rows, note)


def coefficients(one: ResponseAnalysis) -> PageTable | None:
    """The model as numbers."""
    if not one.coefficients:
        return None
    rows = [[c.name, to_its_u95(c.estimate, c.u95), p_text(c.p)] for c in one.coefficients]
    note = (
        "Numbers are coded to −1 … 1 between their bounds, levels and categories are deviations from the mean: that "
        "of the last level follows from the others."
    )
    if one.is_log:
        note += " The model is of the natural logarithm."
    if all(math.isnan(c.u95) for c in one.coefficients):
        note += " No ±: nothing is left to estimate the error."
    return PageTable("Coefficients", ["term", "estimate ± 95 %", "p"], rows, note)


def fit_quality(one: ResponseAnalysis, unit: str) -> PageTable | None:
    """How well the model reproduces and predicts."""
    if one.anova is None:
        return None
    error = f"{UNKNOWN} (nothing is left to estimate the error)"
    if one.error_sd >= 0:
        error = f"{significant(one.error_sd)} {'ln' if one.is_log else unit}".rstrip()
    held = (
        f"held {one.held} of {one.left_out}" if one.left_out else f"{UNKNOWN} (the model needs every point)"
    )
    if one.left_out and (needed := points_needed(one)):
        held += f"; the model needs the other {plural(needed, 'point')}"
    predicted = _share(one.predicted_r2)
    if not math.isfinite(one.predicted_r2):
        predicted += f" ({why_not_predicted(one)})"
    rows = [
        [
            "values, mean, standard deviation",
            f"{len(one.values)}, {significant(one.mean, 4)}, {significant(one.sd)}",
        ],
        ["S, error of a single run", error],
        ["R²", _share(one.r2)],
        ["R², adjusted", _share(one.adjusted_r2)],
        ["R², predicted", predicted],
        ["lack of fit", _lack_text(one)],
        ["points left out one by one", held],
    ]
    return PageTable("Quality of the fit", ["quantity", "value"], rows, words=True)


def _lack_text(one: ResponseAnalysis) -> str:
    lack = one.lack
    if lack is None:
        return f"{UNKNOWN} (no point was run twice)"
    if lack.dof <= 0:
        return f"{UNKNOWN} (the model leaves no freedom to miss a point)"
    if not math.isfinite(lack.f):
        return f"{UNKNOWN} (runs of one point do not differ)"
    p = p_text(lack.p) if p_text(lack.p).startswith("<") else f"= {p_text(lack.p)}"
    return f"F = {significant(lack.f, 4)} ({lack.dof} and {lack.pure_dof} dof), p {p}"


def _share(r2: float) -> str:
    return f"{decimal(100 * r2, 1)} %" if math.isfinite(r2) else UNKNOWN


def expected(plan: StudyPlan, one: Recommendation) -> PageTable | None:
    """What is expected at the recommended settings."""
    if not one.expected:
        return None
    rows = [[name, interval_text(*interval, plan.response(name))] for name, interval in one.intervals.items()]
    caption = f"Expected at {settings_text(plan.factors, one.settings)}"
    return PageTable(caption, ["response", "expected of a new run (95 % interval)"], rows, words=True)


def confirmation(plan: StudyPlan, one: Confirmation) -> PageTable | None:
    """What was measured against what was expected."""
    if not one.responses:
        return None
    columns: Columns[ConfirmedResponse] = [
        ("response", lambda of: of.name),
        (
            "expected (95 % interval)",
            lambda of: interval_text(of.expected, of.low, of.high, plan.response(of.name)),
        ),
        ("measured", lambda of: ", ".join(significant(value, 4) for value in of.measured) or UNKNOWN),
        ("within", lambda of: f"{of.held} of {len(of.measured)}" if of.is_tested else UNKNOWN),
    ]
    caption = (
        f"Confirmation at {settings_text(plan.factors, one.settings)}, runs {', '.join(map(str, one.runs))}"
    )
    return _table(caption, one.responses, columns, words=True)


def _setting(factor: FactorInfo) -> Callable[[Choice], str]:
    return lambda one: level_text(one.settings[factor.key])


def _keeps(plan: StudyPlan) -> list[tuple[str, Callable[[Choice], str]]]:
    return [("keeps constraints", lambda one: _yes(one.is_feasible))] if plan.constraints else []


def _yes(is_so: bool) -> str:
    return "yes" if is_so else "no"


def choices(plan: StudyPlan, found: Sequence[Choice]) -> PageTable | None:
    """Every point with its means, whether it keeps the constraints, and whether another is better in all."""
    if not found:
        return None

    def number(of: str, name: str) -> Callable[[Choice], str]:
        return lambda one: significant(plain_number(getattr(one, of).get(name)), 4)

    sides = {1: ("upper", "≤"), -1: ("lower", "≥")}
    columns: list[tuple[str, Callable[[Choice], str]]] = [
        ("point", lambda one: str(one.point)),
        *((factor.name, _setting(factor)) for factor in plan.factors),
        ("runs", lambda one: str(one.runs)),
        *((info.label, number("means", info.name)) for info in plan.responses),
    ]
    for bound in plan.constraints:
        side, sign = sides[bound.sign]
        header = f"{bound.response}, {side} 95 % bound ({sign} {bound.limit:g})"
        columns.append((header, number("upper", str(bound))))
    columns += [*_keeps(plan), ("on the front", lambda one: _yes(one.is_pareto))]
    note = (
        f"Means of all {sum(one.runs for one in found)} runs that are done, without confirmations. On the front no "
        f"other point{that_keeps(plan)} is as good in every objective and better in one: a fact of the means."
    )
    if plan.constraints:
        note += (
            " A constraint is kept where the one-sided 95 % bound of the point's mean keeps it (of a single run, "
            f"the end of its own interval), not where the mean does; {UNKNOWN} where the runs tell no interval, "
            "which does not keep it."
        )
    best_first = sorted(
        found, key=lambda one: (not one.is_pareto, not one.is_feasible, -(one.grey_grade or 0.0))
    )
    caption = "Points: means, constraints and Pareto front"
    return _table(caption, best_first, columns, note, most=MOST_CHOICES)


def that_keeps(plan: StudyPlan) -> str:
    """Return which points a front is among; empty where it is all of them."""
    return " that keeps the constraints" if plan.constraints else ""


def preferences(plan: StudyPlan, found: Sequence[Choice]) -> PageTable | None:
    """Two rankings of the points, which are preferences."""
    if all(one.grey_grade is None and one.topsis_closeness is None for one in found):
        return None

    def ranks(values: Iterable[float | None]) -> dict[float | None, int]:
        ordered = sorted((value for value in values if value is not None), reverse=True)
        return {value: rank for rank, value in reversed(list(enumerate(ordered, 1)))}

    by_grade, by_closeness = (
        ranks(getattr(one, name) for one in found) for name in ("grey_grade", "topsis_closeness")
    )
    columns: Columns[Choice] = [
        ("point", lambda one: str(one.point)),
        *((factor.name, _setting(factor)) for factor in plan.factors),
        ("grey relational grade", lambda one: decimal(plain_number(one.grey_grade), 3)),
        ("rank by grade", lambda one: str(by_grade.get(one.grey_grade, UNKNOWN))),
        ("TOPSIS closeness", lambda one: decimal(plain_number(one.topsis_closeness), 3)),
        ("rank by closeness", lambda one: str(by_closeness.get(one.topsis_closeness, UNKNOWN))),
        *_keeps(plan),
    ]
    weights = ", ".join(f"{name} {weight:g}" for name, weight in plan.objectives)
    if not weights:
        weights = (
            f"1 for each of {', '.join(info.name for info in plan.responses)}, as no objectives are given"
        )
    note = (
        f"Preferences, no findings: they follow from the weights ({weights}), from how the responses are scaled and "
        "from which points were run."
    )
    best_first = sorted(found, key=lambda one: -(one.grey_grade or 0.0))
    caption = "Rankings by preference: grey relational grade and TOPSIS"
    return _table(caption, best_first, columns, note, most=MOST_CHOICES)


def sobol(plan: StudyPlan, info: ResponseInfo, found: SobolIndices) -> PageTable:
    """Sobol indices with their intervals."""
    columns = (found.first_order, found.first_order_u95, found.total, found.total_u95)
    rows = [
        [factor.name, to_its_u95(float(first), float(first_u95)), to_its_u95(float(total), float(total_u95))]
        for factor, first, first_u95, total, total_u95 in zip(plan.factors, *columns, strict=True)
    ]
    note = (
        "Shares of the variance over the whole range of the factors: of a factor alone, and with all that it "
        "interacts with. Intervals (95 %) by bootstrap; a share within its ± of zero is not shown to be there."
    )
    return PageTable(f"Sobol indices of {info.name}", ["factor", "first order", "total"], rows, note)


def all_runs(plan: StudyPlan, runs: Sequence[StudyRun]) -> PageTable:
    """Every run with its settings, its responses and its judgement, whether it counts or not."""

    def setting(factor: FactorInfo) -> Callable[[StudyRun], str]:
        return lambda run: level_text(run.planned.settings.get(factor.key, UNKNOWN))

    def value(info: ResponseInfo) -> Callable[[StudyRun], str]:
        def cell(run: StudyRun) -> str:
            value, u95 = plain_number(run.recorded(info.name)), plain_number(run.u95(info.name))
            return to_its_u95(value, u95) if u95 > 0 else significant(value, 4)

        return cell

    def said(run: StudyRun) -> str:
        error = run.row.error or "" if run.row is not None else ""
        return "; ".join(filter(None, [str(run.judgement or ""), run.reason, error]))

    shared = "tool" if any(run.planned.tool for run in runs) else "seed"
    columns: Columns[StudyRun] = [
        ("run", lambda run: str(run.planned.number)),
        ("state", lambda run: str(run.state)),
        ("kind", lambda run: str(run.planned.kind)),
        ("point", lambda run: str(run.planned.point)),
        ("replicate", lambda run: str(run.planned.replicate)),
        (BLOCK, lambda run: str(run.planned.block)),
        (shared, lambda run: str(getattr(run.planned, shared))),
        *((factor.name, setting(factor)) for factor in plan.factors),
        *((info.label, value(info)) for info in plan.responses),
        ("judgement or error", said),
    ]
    note = "± is half the 95 % interval that the run itself gives. Only runs that are done count in other tables."
    caption = "All runs in their order"
    return _table(caption, runs, columns, note, most=MOST_RUNS, without_empty=True)
