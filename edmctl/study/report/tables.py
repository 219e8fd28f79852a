"""The tables of a study's page."""

from __future__ import annotations

import math
from collections.abc import Sequence

from edmctl.report.html import PageTable
from edmctl.study.report.words import (
    BLOCK,
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
    TRUTH,
    Choice,
    Confirmation,
    FactorInfo,
    Recommendation,
    ResponseInfo,
    StudyPlan,
    StudyRun,
)
from edmctl.study.statistics.anova import Anova, AnovaRow
from edmctl.study.statistics.choice import SobolIndices
from edmctl.study.statistics.response_analysis import LevelMeans, ResponseAnalysis
from edmctl.wording import UNKNOWN, decimal, plain_number, plural, significant, to_its_u95

MOST_CHOICES, MOST_RUNS = 60, 1000
"""Rows of the longest tables; the rest is counted."""
_POOLING = (
    "Pooling counts the weakest terms as error. It makes F of those that stay too large, because the weakest were "
    "chosen: it suggests what to confirm, and proves nothing."
)


def factors(plan: StudyPlan) -> PageTable:
    """Every factor with its levels."""
    rows = [
        [
            one.name,
            one.key,
            f"{level_text(one.values[0])} to {level_text(one.values[-1])}"
            if one.is_range
            else ", ".join(map(level_text, one.values)),
            _scale(one),
        ]
        for one in plan.factors
    ]
    return PageTable("Factors", ["factor", "key", "levels", "scale"], rows, words=True)


def _scale(one: FactorInfo) -> str:
    if not one.is_number:
        return "categories"
    return f"{'logarithmic' if one.is_log else 'linear'}{' range' if one.is_range else ''}"


def responses(plan: StudyPlan) -> PageTable:
    """Every response and what is wanted of it."""
    weights = dict(plan.objectives)
    rows = [
        [
            one.name,
            one.unit or "1",
            wanted(one),
            "logarithmic" if one.is_log else "linear",
            "told by hand" if one.is_manual else "the job",
            f"{weights[one.name]:g}" if one.name in weights else "",
            ", ".join(str(bound) for bound in plan.constraints if bound.response == one.name),
        ]
        for one in plan.responses
    ]
    header = ["response", "unit", "wanted", "modelled", "from", "weight as objective", "constraint"]
    return _without_empty(PageTable("Responses", header, rows, words=True))


def _without_empty(table: PageTable) -> PageTable:
    """The same table without columns that no row has something for."""
    kept = [n for n in range(len(table.header)) if n == 0 or any(row[n] for row in table.rows)]
    rows = [[row[n] for n in kept] for row in table.rows]
    return PageTable(table.caption, [table.header[n] for n in kept], rows, table.note, table.words)


def degrees_of_freedom(plan: StudyPlan) -> PageTable:
    """Degrees of freedom of the planned runs, by term."""
    rows = [[name, str(dof)] for name, dof in plan.dof.items()]
    rows.append(["total", str(sum(plan.dof.values()))])
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
    header = [
        "term",
        "dof",
        "seq. SS",
        "adj. SS",
        "mean square",
        "F",
        "p",
        "share of seq. SS, %",
        "less error, %",
    ]
    rows = [
        [
            row.name,
            str(row.dof),
            significant(row.sequential_ss, 4),
            significant(row.adjusted_ss, 4),
            significant(row.mean_square, 4),
            *_tested(row),
            decimal(row.contribution_pct),
            decimal(row.pure_pct),
        ]
        for row in (*table.rows, table.error, table.total)
    ]
    told = " ".join(filter(None, [why_no_f(table), differing_words(table), note]))
    return PageTable(caption, header, rows, told)


def _tested(row: AnovaRow | None) -> tuple[str, str]:
    return (significant(row.f, 4), p_text(row.p)) if row is not None else (UNKNOWN, UNKNOWN)


def why_no_f(table: Anova) -> str:
    """Return why no F of a term can be given; empty where there is one."""
    if not table.rows or all(math.isfinite(row.f) for row in table.rows):
        return ""
    if not table.error.dof:
        return "No F: no degrees of freedom are left to estimate the error."
    return "No F: the model leaves no error to compare with."


def measured_and_true(measured: ResponseAnalysis, true: ResponseAnalysis) -> PageTable | None:
    """What the analysis says of measured values beside what it says of true ones."""
    if measured.anova is None or true.anova is None:
        return None
    tables = measured.anova, true.anova
    by_name = [{row.name: row for row in (*table.rows, table.error)} for table in tables]
    rows = []
    for name in dict.fromkeys((*by_name[0], *by_name[1])):
        row = [name]
        for found in (of.get(name) for of in by_name):
            share = decimal(found.contribution_pct) if found is not None else UNKNOWN
            row += [str(found.dof) if found is not None else UNKNOWN, *_tested(found), share]
        rows.append(row)
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
    ordered = [in_order(plan, one) for one in found]
    most = max(len(pairs) for pairs in ordered)
    rows = [
        [
            one.factor,
            *(f"{level_text(level)}: {significant(mean, 4)}" for level, mean in pairs),
            *[""] * (most - len(pairs)),
            significant(one.delta, 4),
            str(one.rank),
        ]
        for one, pairs in zip(found, ordered, strict=True)
    ]
    header = ["factor", *(f"level {n + 1}" for n in range(most)), "delta", "rank"]
    return PageTable(caption, header, rows, note)


def coefficients(one: ResponseAnalysis) -> PageTable | None:
    """The model as numbers."""
    if not one.coefficients:
        return None
    rows = [[c.name, to_its_u95(c.estimate, c.u95), p_text(c.p)] for c in one.coefficients]
    notes = [
        "Numbers are coded to −1 … 1 between their bounds, levels and categories are deviations from the mean: that "
        "of the last level follows from the others."
    ]
    notes.append("The model is of the natural logarithm." if one.is_log else "")
    if all(math.isnan(c.u95) for c in one.coefficients):
        notes.append("No ±: nothing is left to estimate the error.")
    return PageTable("Coefficients", ["term", "estimate ± 95 %", "p"], rows, " ".join(filter(None, notes)))


def fit_quality(one: ResponseAnalysis, unit: str) -> PageTable | None:
    """How well the model reproduces and predicts."""
    if one.anova is None:
        return None
    lack, lack_text = one.lack, f"{UNKNOWN} (no point was run twice)"
    if lack is not None:
        lack_text = f"{UNKNOWN} (the model leaves no freedom to miss a point)"
        if lack.dof > 0 and math.isfinite(lack.f):
            p = p_text(lack.p) if p_text(lack.p).startswith("<") else f"= {p_text(lack.p)}"
            lack_text = f"F = {significant(lack.f, 4)} ({lack.dof} and {lack.pure_dof} dof), p {p}"
        elif lack.dof > 0:
            lack_text = f"{UNKNOWN} (runs of one point do not differ)"
    scale = "ln" if one.is_log else unit
    none = f"{UNKNOWN} (nothing is left to estimate the error)"
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
        [
            "S, error of a single run",
            f"{significant(one.error_sd)} {scale}".rstrip() if one.error_sd >= 0 else none,
        ],
        ["R²", _share(one.r2)],
        ["R², adjusted", _share(one.adjusted_r2)],
        ["R², predicted", predicted],
        ["lack of fit", lack_text],
        ["points left out one by one", held],
    ]
    return PageTable("Quality of the fit", ["quantity", "value"], rows, words=True)


def _share(r2: float) -> str:
    return f"{decimal(100 * r2, 1)} %" if math.isfinite(r2) else UNKNOWN


def expected(plan: StudyPlan, one: Recommendation) -> PageTable | None:
    """What is expected at the recommended settings."""
    if not one.expected:
        return None
    infos = {info.name: info for info in plan.responses}
    rows = [
        [name, interval_text(value, one.low.get(name), one.high.get(name), infos.get(name))]
        for name, value in one.expected.items()
    ]
    caption = f"Expected at {settings_text(plan.factors, one.settings)}"
    return PageTable(caption, ["response", "expected of a new run (95 % interval)"], rows, words=True)


def confirmation(plan: StudyPlan, one: Confirmation) -> PageTable | None:
    """What was measured against what was expected."""
    if not one.responses:
        return None
    infos = {info.name: info for info in plan.responses}
    rows = [
        [
            response.name,
            interval_text(response.expected, response.low, response.high, infos.get(response.name)),
            ", ".join(significant(value, 4) for value in response.measured) or UNKNOWN,
            f"{response.held} of {len(response.measured)}" if response.is_tested else UNKNOWN,
        ]
        for response in one.responses
    ]
    caption = (
        f"Confirmation at {settings_text(plan.factors, one.settings)}, runs {', '.join(map(str, one.runs))}"
    )
    return PageTable(
        caption, ["response", "expected (95 % interval)", "measured", "within"], rows, words=True
    )


def choices(plan: StudyPlan, found: Sequence[Choice]) -> PageTable | None:
    """Every point with its means, whether it keeps the constraints, and whether another is better in all."""
    if not found:
        return None
    named = [str(bound) for bound in plan.constraints]
    rows = [
        [
            str(one.point),
            *(level_text(one.settings[factor.key]) for factor in plan.factors),
            str(one.runs),
            *(significant(plain_number(one.means.get(info.name)), 4) for info in plan.responses),
            *(significant(plain_number(one.upper.get(name)), 4) for name in named),
            *([_yes(one.is_feasible)] if named else []),
            _yes(one.is_pareto),
        ]
        for one in sorted(
            found, key=lambda one: (not one.is_pareto, not one.is_feasible, -(one.grey_grade or 0.0))
        )
    ]
    header = ["point", *(factor.name for factor in plan.factors), "runs"]
    header += [info.label for info in plan.responses]
    for bound in plan.constraints:
        side, sign = ("upper", "≤") if bound.sign > 0 else ("lower", "≥")
        header.append(f"{bound.response}, {side} 95 % bound ({sign} {bound.limit:g})")
    header += [*(["keeps constraints"] if named else []), "on the front"]
    notes = [
        f"Means of all {sum(one.runs for one in found)} runs that are done, without confirmations.",
        f"On the front no other point{that_keeps(plan)} is as good in every objective and better in one: a fact of "
        "the means.",
    ]
    if named:
        notes.append(
            "A constraint is kept where the one-sided 95 % bound of the point's mean keeps it (of a single run, "
            f"the end of its own interval), not where the mean does; {UNKNOWN} where the runs tell no interval, "
            "which does not keep it."
        )
    return _cut(
        PageTable("Points: means, constraints and Pareto front", header, rows, " ".join(notes)), MOST_CHOICES
    )


def that_keeps(plan: StudyPlan) -> str:
    """Return which points a front is among; empty where it is all of them."""
    return " that keeps the constraints" if plan.constraints else ""


def _yes(is_so: bool) -> str:
    return "yes" if is_so else "no"


def preferences(plan: StudyPlan, found: Sequence[Choice]) -> PageTable | None:
    """Two rankings of the points, which are preferences."""
    if all(one.grey_grade is None and one.topsis_closeness is None for one in found):
        return None
    grades = _ranks([one.grey_grade for one in found])
    closeness = _ranks([one.topsis_closeness for one in found])
    rows = [
        [
            str(one.point),
            *(level_text(one.settings[factor.key]) for factor in plan.factors),
            decimal(plain_number(one.grey_grade), 3),
            grades[n],
            decimal(plain_number(one.topsis_closeness), 3),
            closeness[n],
            *([_yes(one.is_feasible)] if plan.constraints else []),
        ]
        for n, one in sorted(enumerate(found), key=lambda pair: -(pair[1].grey_grade or 0.0))
    ]
    header = ["point", *(factor.name for factor in plan.factors)]
    header += ["grey relational grade", "rank by grade", "TOPSIS closeness", "rank by closeness"]
    header += ["keeps constraints"] if plan.constraints else []
    weights = ", ".join(f"{name} {weight:g}" for name, weight in plan.objectives)
    if not weights:
        weights = (
            f"1 for each of {', '.join(info.name for info in plan.responses)}, as no objectives are given"
        )
    note = (
        f"Preferences, no findings: they follow from the weights ({weights}), from how the responses are scaled and "
        "from which points were run."
    )
    caption = "Rankings by preference: grey relational grade and TOPSIS"
    return _cut(PageTable(caption, header, rows, note), MOST_CHOICES)


def _ranks(values: Sequence[float | None]) -> list[str]:
    ordered = sorted((value for value in values if value is not None), reverse=True)
    return [str(ordered.index(value) + 1) if value is not None else UNKNOWN for value in values]


def _cut(table: PageTable, most: int) -> PageTable:
    """The same table with its first rows alone, which says so."""
    left = len(table.rows) - most
    if left <= 0:
        return table
    note = f"{table.note} {plural(left, 'more row')} not shown.".strip()
    return PageTable(table.caption, table.header, table.rows[:most], note, table.words)


def sobol(plan: StudyPlan, info: ResponseInfo, found: SobolIndices) -> PageTable:
    """Integers with their intervals."""
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


def all_runs(plan: StudyPlan, state: Sequence[StudyRun]) -> PageTable:
    """Every run with its settings, its responses and what somebody said of it, whether it counts or not."""
    several_tools = any(run.planned.tool for run in state)
    rows = [
        [
            str(run.planned.number),
            str(run.state),
            str(run.planned.kind),
            str(run.planned.point),
            str(run.planned.replicate),
            str(run.planned.block),
            str(run.planned.tool) if several_tools else str(run.planned.seed),
            *(level_text(run.planned.settings.get(factor.key, UNKNOWN)) for factor in plan.factors),
            *(_run_value(run, info.name) for info in plan.responses),
            _said(run),
        ]
        for run in state
    ]
    header = ["run", "state", "kind", "point", "replicate", BLOCK, "tool" if several_tools else "seed"]
    header += [*(factor.name for factor in plan.factors), *(info.label for info in plan.responses)]
    header += ["judgement or error"]
    note = "± is half the 95 % interval that the run itself gives. Only runs that are done count in other tables."
    return _cut(_without_empty(PageTable("All runs in their order", header, rows, note)), MOST_RUNS)


def _run_value(run: StudyRun, name: str) -> str:
    """A response as it stands, of failed and rejected runs too."""
    if name in run.told:
        return significant(run.told[name], 4)
    if run.row is None:
        return UNKNOWN
    if name.startswith(TRUTH):
        return significant(plain_number(run.row.truth.get(name.removeprefix(TRUTH))), 4)
    value, u95 = (plain_number(of.get(name)) for of in (run.row.responses, run.row.u95))
    return to_its_u95(value, u95) if u95 > 0 else significant(value, 4)


def _said(run: StudyRun) -> str:
    told = [str(run.judgement) if run.judgement is not None else "", run.reason]
    told.append(run.row.error or "" if run.row is not None else "")
    return "; ".join(filter(None, told))
