"""The findings of a study as sentences and tables, for the terminal and for the page."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

from edmctl.report.html import PageTable
from edmctl.study.results import (
    Choice,
    Confirmation,
    FactorInfo,
    Interval,
    Recommendation,
    ResponseInfo,
    StudyPlan,
    StudyRun,
    Value,
)
from edmctl.study.statistics.linear_model import BLOCK, Anova, AnovaRow
from edmctl.study.statistics.response_analysis import LevelMeans, ResponseAnalysis
from edmctl.wording import (
    UNKNOWN,
    decimal,
    plain_number,
    plural,
    printable,
    setting_text,
    shortened,
    significant,
    to_its_u95,
    unit_in,
)

HARD = "\u00a0"
"""A space at which no line breaks."""
SURE = 0.05
"""An effect counts as shown below this probability."""
LARGE = 36.0
"""Sum of squares over the error variance of a term that has an effect of six standard errors."""
LONGEST = 60
MOST_CHOICES, MOST_RUNS = 60, 1000
"""Rows of the longest tables; further rows are counted."""
MODELS = {
    "levels": "main effects, with every level of a factor free",
    "main": "main effects, straight in every number",
    "interactions": "main effects and products of two factors",
    "quadratic": "second order: main effects, products of two factors and squares of numbers",
}


def level_text(value: object) -> str:
    """Return a level as tables and axes name it."""
    text = setting_text(value) if isinstance(value, bool | int | float) else printable(str(value))
    return shortened(text, LONGEST)


def factor_label(factor: FactorInfo) -> str:
    """Return a factor with its unit, which its key ends with."""
    unit = unit_in(factor.key)
    return f"{printable(factor.name)} ({unit})" if unit else printable(factor.name)


def settings_text(factors: Sequence[FactorInfo], settings: Mapping[str, Value]) -> str:
    """Return settings by the names of their factors: `duty = 0.2, frequency = 1500`."""
    return ", ".join(
        f"{one.name} = {level_text(settings[one.key])}" for one in factors if one.key in settings
    )


def p_text(p: float) -> str:
    """Return a probability with three decimals, or more where these do not show its side of the limit."""
    if not math.isfinite(p):
        return UNKNOWN
    return "< 0.001" if p < 0.0005 else decimal(p, 5 if abs(p - SURE) < 0.0005 else 3)


def p_words(p: float) -> str:
    """Return a probability for a sentence: `p < 0.001`, `p = 0.024`."""
    text = p_text(p)
    return (f"p {text}" if text.startswith("<") else f"p = {text}").replace(" ", HARD)


def interval_text(interval: Interval, info: ResponseInfo | None) -> str:
    """Return a value with its 95 % interval: `49.4 s (45.1 to 54.0)`."""
    value, low, high = interval
    text = f"{significant(value, 4)} {info.unit if info is not None else ''}".rstrip()
    if not (math.isfinite(low) and math.isfinite(high)):
        return f"{text} (interval unknown)"
    return f"{text} ({significant(low, 4)} to {significant(high, 4)})"


def sentence(text: str) -> str:
    """Return a note as a sentence: with a capital, where it begins with a word, and a full stop."""
    if text.split(" ", 1)[0].isalpha():
        text = text[:1].upper() + text[1:]
    return text if text.endswith((".", "!", "?")) else f"{text}."


def target_text(info: ResponseInfo) -> str:
    if info.better == "nominal":
        return f"nominal is best, {info.target:g}" if info.target is not None else "nominal is best"
    return f"{info.better} is better"


def design_text(plan: StudyPlan) -> str:
    """Return the design with its numbers of points, replicates, runs, blocks, and tools or machines."""
    tools = {run.tool for run in plan.runs} - {0}
    counts = [
        plural(plan.points, "point"),
        plural(plan.replicates, "replicate"),
        plural(len(plan.runs), "run"),
        plural(len({run.block for run in plan.runs}), "block"),
        plural(len(tools), "tool")
        if tools
        else plural(len({run.seed for run in plan.runs}), "virtual machine"),
    ]
    dof = ", ".join(f"{term} {dof}" for term, dof in plan.dof.items())
    return f"{plan.kind}: {', '.join(counts)}. Degrees of freedom: {dof}."


def limitations(
    plan: StudyPlan, runs: Sequence[StudyRun], responses: Sequence[ResponseAnalysis], notes: Sequence[str]
) -> list[str]:
    """Return the notes, and the questions that the study cannot answer."""
    points = [run.planned.point for run in runs]
    tests = sum(
        math.isfinite(row.p) for one in responses if one.anova is not None for row in _factor_rows(one.anova)
    )
    found = [sentence(note) for note in dict.fromkeys((*notes, *plan.notes))]
    if plan.aliases:
        found.append(
            "The design mixes effects (listed below): an effect shown for one may be that of another."
        )
    if runs and len(set(points)) == len(points):
        found.append(
            "No point was run twice: scatter of the runs and what the model misses are one error here."
        )
    if any(run.row is not None and run.row.truth for run in runs):
        found.append(
            "The runs are of virtual machines: effects beyond the simulator's model are not in them."
        )
    found.append(
        "The results hold between the levels below, with all other keys as in the profile, and not beyond."
    )
    if tests > 1:
        found.append(
            f"{tests} effects are tested. Without any effect, about {decimal(tests * SURE, 1)} of them would still "
            f"have p < {SURE:g} by chance."
        )
    return found


def what_matters(info: ResponseInfo, one: ResponseAnalysis) -> list[str]:
    """Return which terms act on a response, with their shares of the variation and their probabilities."""
    if one.anova is None:
        return [f"{one.name}: not analysed; {'; '.join(one.notes)}."]
    rows, error = _factor_rows(one.anova), one.anova.error
    variation = f"the variation of {'ln ' if one.is_log else ''}{one.name}"
    if not error.dof or not math.isfinite(error.mean_square):
        shares = ", ".join(f"{row.name} {_share(row)}" for row in rows)
        return [
            f"{one.name}: of {variation}, {shares}. Nothing is left to estimate the error: none of this is shown "
            "to be more than chance."
        ]
    acting = [row for row in rows if row.p < SURE]
    large = [row for row in rows if row not in acting and row.adjusted_ss >= LARGE * error.mean_square]
    others = [row for row in rows if row not in acting and row not in large]
    best = {means.factor: best_level(info, means) for means in one.level_means}
    found = [f"{one.name}: no effect is shown."]
    if acting:
        named = []
        for row in acting:
            level = best.get(row.name)
            at = f", best mean at {level_text(level)}" if level is not None else ""
            named.append(f"{row.name} ({_evidence(row)}{at})")
        verb = "act" if len(acting) > 1 else "acts"
        found = [f"{one.name}: {', '.join(named)} {verb}; shares are of {variation}."]
    for row in large:
        dof = plural(one.anova.under(row.name).dof, "degree")
        found.append(
            f"{row.name} is large ({_evidence(row)}): six standard errors or more, but the row that F compares with "
            f"has {dof} of freedom. More replicates would decide."
        )
    if others:
        found.append(f"Not shown to act: {', '.join(f'{row.name} ({_evidence(row)})' for row in others)}.")
    found += [
        f"Blocks (machines or tools) differ: {_evidence(row)}."
        for row in one.anova.rows
        if row.name == BLOCK and row.p < SURE
    ]
    found += _compared_with_blocks(one.anova)
    if one.lack is not None and one.lack.p < SURE:
        found.append(
            f"Significant lack of fit ({p_words(one.lack.p)}): the response depends on more than these terms."
        )
    if one.held < one.left_out:
        found.append(f"Left out one by one, {one.held} of {one.left_out} points were within their intervals.")
    return found


def _compared_with_blocks(table: Anova) -> list[str]:
    return [
        f"F of {row.name} is over {row.against}, its variation from machine to machine or tool to tool; that is no "
        "error of the others."
        for row in table.rows
        if row.against != table.error.name
    ]


def _factor_rows(table: Anova) -> list[AnovaRow]:
    """Return the rows of factors and their products, without blocks, the strongest first."""
    rows = [row for row in table.rows if row.name != BLOCK and row not in table.by_block]
    return sorted(rows, key=lambda row: -row.contribution_pct)


def _share(row: AnovaRow) -> str:
    return f"{decimal(row.contribution_pct, 1)}{HARD}%"


def _evidence(row: AnovaRow) -> str:
    return f"{_share(row)}, {p_words(row.p)}"


def best_level(info: ResponseInfo, table: LevelMeans) -> object:
    """Return the level with the best mean; None for a nominal response without a target."""
    pairs = list(zip(table.means, table.levels, strict=True))
    if info.better == "nominal":
        target = info.target
        return min(pairs, key=lambda pair: abs(pair[0] - target))[1] if target is not None else None
    choose = max if info.better == "larger" else min
    return choose(pairs, key=lambda pair: pair[0])[1]


def recommended(plan: StudyPlan, one: Recommendation | None) -> str:
    """Return the recommended settings, and what is expected there."""
    if one is None:
        return "No settings are recommended."
    text = f"Recommended: {settings_text(plan.factors, one.settings)}."
    if one.expected:
        expected = (f"{name} {interval_text(of, plan.response(name))}" for name, of in one.intervals.items())
        text += f" Expected of a new run there: {'; '.join(expected)}."
    if plan.constraints:
        kept = "are kept by the 95 % bounds of their means" if one.is_feasible else "are NOT kept"
        text += f" The constraints {kept}."
    return f"{text} {sentence(one.basis)}"


def confirmed(plan: StudyPlan, confirmations: Sequence[Confirmation]) -> list[str]:
    """Return whether confirmation runs were within their intervals, and whether they keep the constraints."""
    if not confirmations:
        return ["No confirmation run was made: what the models expect at new settings is not tested."]
    found = []
    for one in confirmations:
        tested = [response for response in one.responses if response.is_tested]
        broken = [response for response in tested if response.held < len(response.measured)]
        runs = plural(len(one.runs), "confirmation run")
        if not one.responses:
            text = f"{runs}, none with a value yet."
        elif not tested:
            text = f"{runs}, of which the study expected nothing."
        elif broken:
            named = ", ".join(f"{of.name} ({of.held} of {len(of.measured)} within)" for of in broken)
            text = f"confirmation did NOT hold for {named}, by {runs}."
        else:
            text = f"confirmation held. All values of {runs} were within the 95 % intervals."
        for limit in one.limits:
            upper = f", 95 % bound {significant(limit.upper, 3)}" if limit.upper is not None else ""
            text += f" {limit.constraint}: {limit.verdict} (mean of the runs {significant(limit.mean, 3)}{upper})."
        found.append(f"At {settings_text(plan.factors, one.settings)}: {text}")
    return found


def is_refuted(confirmations: Sequence[Confirmation]) -> bool:
    """Return whether a confirmation run was beyond an interval."""
    tested = [response for one in confirmations for response in one.responses if response.is_tested]
    return any(response.held < len(response.measured) for response in tested)


def _table(
    caption: str,
    columns: Iterable[tuple[str, Sequence[str]]],
    note: str = "",
    *,
    words: bool = False,
    most: int | None = None,
) -> PageTable:
    """Return a table of columns, without those that are empty; rows after the first `most` are counted."""
    kept = [(name, cells) for name, cells in columns if any(cells)]
    rows = list(zip(*(cells for _, cells in kept), strict=True))
    if most is not None and len(rows) > most:
        note = f"{note} {plural(len(rows) - most, 'more row')} not shown.".strip()
    return PageTable(caption, [name for name, _ in kept], rows[:most], note, words)


def factors(plan: StudyPlan) -> PageTable:
    scales = []
    for one in plan.factors:
        scale = f"{'logarithmic' if one.is_log else 'linear'}{' range' if one.is_range else ''}"
        scales.append(scale if one.is_number else "categories")
    columns = [
        ("factor", [one.name for one in plan.factors]),
        ("key", [one.key for one in plan.factors]),
        (
            "levels",
            [(" to " if one.is_range else ", ").join(map(level_text, one.values)) for one in plan.factors],
        ),
        ("scale", scales),
    ]
    return _table("Factors", columns, words=True)


def responses(plan: StudyPlan) -> PageTable:
    weights = {name: f"{weight:g}" for name, weight in plan.objectives}
    bounds = [
        [str(bound) for bound in plan.constraints if bound.response == one.name] for one in plan.responses
    ]
    columns = [
        ("response", [one.name for one in plan.responses]),
        ("unit", [one.unit or "1" for one in plan.responses]),
        ("target", [target_text(one) for one in plan.responses]),
        ("modelled", ["logarithmic" if one.is_log else "linear" for one in plan.responses]),
        ("from", ["by hand" if one.is_manual else "the job" for one in plan.responses]),
        ("weight as objective", [weights.get(one.name, "") for one in plan.responses]),
        ("constraint", [", ".join(of) for of in bounds]),
    ]
    return _table("Responses", columns, words=True)


def analysis_of_variance(one: ResponseAnalysis) -> list[PageTable]:
    name = f"Analysis of variance of {'ln ' if one.is_log else ''}{one.name}"
    found = [_anova(f"{name}, nothing pooled", one.anova)] if one.anova is not None else []
    if one.pooled is not None:
        note = (
            "Pooling counts the weakest terms as error. It makes F of the others too large, because the weakest "
            "were chosen: it suggests what to confirm, and proves nothing."
        )
        caption = f"{name}, pooled: {', '.join(one.pooled.pooled)} counted as error"
        found.append(_anova(caption, one.pooled, note))
    return found


def _anova(caption: str, table: Anova, note: str = "") -> PageTable:
    notes = _compared_with_blocks(table)
    if any(not math.isfinite(row.f) for row in table.rows):
        why = (
            "the model leaves no error to compare with"
            if table.error.dof
            else "no degrees of freedom are left to estimate the error"
        )
        notes.insert(0, f"No F: {why}.")
    rows = (*table.rows, table.error, table.total)
    columns = [
        ("term", [row.name for row in rows]),
        ("dof", [str(row.dof) for row in rows]),
        ("seq. SS", [significant(row.sequential_ss, 4) for row in rows]),
        ("adj. SS", [significant(row.adjusted_ss, 4) for row in rows]),
        ("mean square", [significant(row.mean_square, 4) for row in rows]),
        ("F", [significant(row.f, 4) for row in rows]),
        ("p", [p_text(row.p) for row in rows]),
        ("share of seq. SS, %", [decimal(row.contribution_pct) for row in rows]),
        ("less error, %", [decimal(row.pure_pct) for row in rows]),
    ]
    return _table(caption, columns, " ".join([*notes, note]).strip())


def response_table(caption: str, found: Sequence[LevelMeans], note: str = "") -> PageTable:
    """Return means by level with their range and rank."""
    columns = [("factor", [one.factor for one in found])]
    for n in range(max((len(one.levels) for one in found), default=0)):
        cells = [
            f"{level_text(one.levels[n])}: {significant(one.means[n], 4)}" if n < len(one.levels) else ""
            for one in found
        ]
        columns.append((f"level {n + 1}", cells))
    columns += [
        ("delta", [significant(one.delta, 4) for one in found]),
        ("rank", [str(one.rank) for one in found]),
    ]
    return _table(caption, columns, note)


def coefficients(one: ResponseAnalysis) -> PageTable:
    note = (
        "Numbers are coded to −1 … 1 between their bounds, levels and categories are deviations from the mean: that "
        "of the last level follows from the others."
    )
    if one.is_log:
        note += " The model is of the natural logarithm."
    if all(math.isnan(of.u95) for of in one.coefficients):
        note += " No ±: nothing is left to estimate the error."
    columns = [
        ("term", [of.name for of in one.coefficients]),
        ("estimate ± 95 %", [to_its_u95(of.estimate, of.u95) for of in one.coefficients]),
        ("p", [p_text(of.p) for of in one.coefficients]),
    ]
    return _table("Coefficients", columns, note)


def fit_quality(one: ResponseAnalysis, unit: str) -> PageTable | None:
    """Return how well the model reproduces and predicts the response; None without a model."""
    if one.anova is None:
        return None
    error = f"{UNKNOWN} (nothing is left to estimate the error)"
    if one.error_sd >= 0:
        error = f"{significant(one.error_sd)} {'ln' if one.is_log else unit}".rstrip()
    held = f"{UNKNOWN} (the model needs every point)"
    if one.left_out and one.model is not None:
        held = f"held {one.held} of {one.left_out}"
        if needed := round(len(one.used) / one.model.replicates) - one.left_out:
            held += f"; the model needs the other {plural(needed, 'point')}"
    predicted = _percent(one.predicted_r2)
    if predicted == UNKNOWN:
        predicted += " (the model cannot do without some runs)"
    mean = f"{len(one.values)}, {significant(one.mean, 4)}, {significant(one.sd)}"
    rows = {
        "values, mean, standard deviation": mean,
        "S, error of a single run": error,
        "R²": _percent(one.r2),
        "R², adjusted": _percent(one.adjusted_r2),
        "R², predicted": predicted,
        "lack of fit": _lack_text(one),
        "points left out one by one": held,
    }
    return _table(
        "Quality of the fit", [("quantity", list(rows)), ("value", list(rows.values()))], words=True
    )


def _lack_text(one: ResponseAnalysis) -> str:
    lack = one.lack
    if lack is None:
        return f"{UNKNOWN} (no point was run twice)"
    if lack.dof <= 0:
        return f"{UNKNOWN} (the model leaves no freedom to miss a point)"
    if not math.isfinite(lack.f):
        return f"{UNKNOWN} (runs of one point do not differ)"
    p = p_words(lack.p).replace(HARD, " ")
    return f"F = {significant(lack.f, 4)} ({lack.dof} and {lack.pure_dof} dof), {p}"


def _percent(share: float) -> str:
    return f"{decimal(100 * share, 1)} %" if math.isfinite(share) else UNKNOWN


def confirmation(plan: StudyPlan, one: Confirmation) -> PageTable:
    intervals = [(of.expected, of.low, of.high) for of in one.responses]
    columns = [
        ("response", [of.name for of in one.responses]),
        (
            "expected (95 % interval)",
            [
                interval_text(interval, plan.response(of.name))
                for interval, of in zip(intervals, one.responses, strict=True)
            ],
        ),
        ("measured", [", ".join(significant(value, 4) for value in of.measured) for of in one.responses]),
        (
            "within",
            [f"{of.held} of {len(of.measured)}" if of.is_tested else UNKNOWN for of in one.responses],
        ),
    ]
    runs = ", ".join(map(str, one.runs))
    caption = f"Confirmation at {settings_text(plan.factors, one.settings)}, runs {runs}"
    return _table(caption, columns, words=True)


def choices(plan: StudyPlan, found: Sequence[Choice]) -> PageTable:
    """Return every point with its means, bounds of the constraints, Pareto front and grey relational grade."""
    found = sorted(found, key=lambda one: (not one.is_pareto, not one.is_feasible, -(one.grey_grade or 0.0)))
    columns = [("point", [str(one.point) for one in found])]
    columns += [(of.name, [level_text(one.settings[of.key]) for one in found]) for of in plan.factors]
    columns.append(("runs", [str(one.runs) for one in found]))
    for info in plan.responses:
        means = [significant(plain_number(one.means.get(info.name)), 4) for one in found]
        columns.append((info.label, means))
    for bound in plan.constraints:
        side, sign = ("upper", "≤") if bound.sign > 0 else ("lower", "≥")
        uppers = [significant(plain_number(one.upper.get(str(bound))), 4) for one in found]
        columns.append((f"{bound.response}, {side} 95 % bound ({sign} {bound.limit:g})", uppers))
    if plan.constraints:
        columns.append(("keeps constraints", ["yes" if one.is_feasible else "no" for one in found]))
    columns += [
        ("on the front", ["yes" if one.is_pareto else "no" for one in found]),
        ("grey relational grade", [decimal(plain_number(one.grey_grade), 3) for one in found]),
    ]
    note = (
        f"Means of all {sum(one.runs for one in found)} runs that are done, without confirmations. On the front no "
        f"other point{that_keeps(plan)} is as good in every objective and better in one: a fact of the means."
    )
    if plan.constraints:
        note += (
            " A constraint is kept where the one-sided 95 % bound of the point's mean keeps it (of a single run, "
            f"the end of its own interval), not where the mean does; {UNKNOWN} where the runs have no interval, "
            "which does not keep it."
        )
    weights = ", ".join(f"{name} {weight:g}" for name, weight in plan.objectives)
    weights = weights or f"1 for each of {', '.join(info.name for info in plan.responses)}"
    note += (
        f" The grade is a preference, no finding: it follows from the weights ({weights}), from the scale of the "
        "responses and from the points that were run."
    )
    return _table("Points: means, constraints and Pareto front", columns, note, most=MOST_CHOICES)


def that_keeps(plan: StudyPlan) -> str:
    """Return the points a front is made of; empty if it is all of them."""
    return " that keeps the constraints" if plan.constraints else ""


def all_runs(plan: StudyPlan, runs: Sequence[StudyRun]) -> PageTable:
    """Return every run with its settings, its responses and its judgement, whether it counts or not."""
    planned = [run.planned for run in runs]
    columns = [
        ("run", [str(run.number) for run in planned]),
        ("state", [str(run.state) for run in runs]),
        ("kind", [str(run.kind) for run in planned]),
        ("point", [str(run.point) for run in planned]),
        ("replicate", [str(run.replicate) for run in planned]),
        (BLOCK, [str(run.block) for run in planned]),
    ]
    shared = "tool" if any(run.tool for run in planned) else "seed"
    columns.append((shared, [str(getattr(run, shared)) for run in planned]))
    columns += [
        (of.name, [level_text(run.settings.get(of.key, UNKNOWN)) for run in planned]) for of in plan.factors
    ]
    for info in plan.responses:
        cells = []
        for run in runs:
            value, u95 = plain_number(run.recorded(info.name)), plain_number(run.u95(info.name))
            cells.append(to_its_u95(value, u95) if u95 > 0 else significant(value, 4))
        columns.append((info.label, cells))
    errors = [run.row.error or "" if run.row is not None else "" for run in runs]
    notes = [
        "; ".join(filter(None, [str(run.judgement or ""), run.reason, error]))
        for run, error in zip(runs, errors, strict=True)
    ]
    columns.append(("judgement or error", notes))
    note = "± is half the 95 % interval that the run itself gives. Only runs that are done count in other tables."
    return _table("All runs in their order", columns, note, most=MOST_RUNS)
