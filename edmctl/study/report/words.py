"""The findings of a study in sentences, and how its settings, levels and probabilities are written."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from edmctl.study.results import (
    Confirmation,
    FactorInfo,
    Recommendation,
    ResponseInfo,
    RunKind,
    StudyPlan,
    StudyRun,
    Value,
)
from edmctl.study.statistics.linear_model import BLOCK, Anova, AnovaRow
from edmctl.study.statistics.response_analysis import LevelMeans, ResponseAnalysis
from edmctl.wording import UNKNOWN, decimal, plural, printable, shortened, significant, unit_in

HARD = "\u00a0"
"""A space that a line does not break."""
SURE = 0.05
"""An effect counts as shown below this probability."""
LARGE = 36.0
"""Sum of squares over the error variance of a term that has an effect of six standard errors."""
LONGEST = 60
MODELS = {
    "levels": "main effects, with every level of a factor free",
    "main": "main effects, straight in every number",
    "interactions": "main effects and products of two factors",
    "quadratic": "second order: main effects, products of two factors and squares of numbers",
    "sensitivity": "Sobol indices; the other tables are of main effects, straight in every number",
}


def level_text(value: object) -> str:
    """Return a level as tables and axes name it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return f"{value:.6g}".replace("-", "−")
    return shortened(printable(str(value)), LONGEST)


def factor_label(factor: FactorInfo) -> str:
    """Return a factor with its unit, which its key ends with."""
    unit = unit_in(factor.key)
    return f"{printable(factor.name)} ({unit})" if unit else printable(factor.name)


def settings_text(factors: Sequence[FactorInfo], settings: Mapping[str, Value]) -> str:
    """Return settings in words: `duty = 0.2, frequency = 1500`."""
    return ", ".join(
        f"{one.name} = {level_text(settings[one.key])}" for one in factors if one.key in settings
    )


def in_order(plan: StudyPlan, one: LevelMeans) -> list[tuple[object, float]]:
    """Levels with their means, in the order of the plan."""
    pairs = list(zip(one.levels, one.means, strict=True))
    for factor in plan.factors:
        values = list(factor.values)
        if (
            factor.name == one.factor
            and not factor.is_number
            and all(level in values for level in one.levels)
        ):
            pairs.sort(key=lambda pair: values.index(pair[0]))  # type: ignore[arg-type]
    return pairs


def p_text(p: float) -> str:
    """Return a probability with three decimals."""
    if not math.isfinite(p):
        return UNKNOWN
    # The last figure before the limit tells on which side of it a probability is.
    return "< 0.001" if p < 0.0005 else decimal(p, 5 if abs(p - SURE) < 0.0005 else 3)


def p_words(p: float) -> str:
    """Return a probability for a sentence: `p < 0.001`, `p = 0.024`."""
    text = p_text(p)
    return (f"p {text}" if text.startswith("<") else f"p = {text}").replace(" ", HARD)


def sentence(text: str) -> str:
    """Return a note as a sentence: with a capital, where it begins with a word, and a full stop."""
    first = text.split(" ", 1)[0]
    begun = text[:1].upper() + text[1:] if first.isalpha() else text
    return begun if begun.endswith((".", "!", "?")) else f"{begun}."


def wanted(info: ResponseInfo) -> str:
    """Return what is wanted of a response."""
    if info.better == "nominal":
        return f"nominal is best, {info.target:g}" if info.target is not None else "nominal is best"
    return f"{info.better} is better"


def design_words(plan: StudyPlan) -> str:
    """Return the design in a sentence: points, replicates, runs, and what they share."""
    blocks = {run.block for run in plan.runs}
    tools = {run.tool for run in plan.runs} - {0}
    seeds = sorted({run.seed for run in plan.runs})
    counted = {kind: sum(run.kind is kind for run in plan.runs) for kind in RunKind}
    others = "".join(
        f", {plural(counted[kind], name)} among them"
        for kind, name in ((RunKind.CENTER, "centre run"), (RunKind.SUGGESTED, "suggested run"))
        if counted[kind]
    )
    text = f"{plan.kind}: {plural(plan.points, 'point')}, {plural(plan.replicates, 'replicate')}, "
    text += f"{plural(len(plan.runs), 'run')}{others}, in {plural(len(blocks), 'block')}"
    if tools:
        return f"{text}, with {plural(len(tools), 'tool')}."
    shown = ", ".join(map(str, seeds)) if len(seeds) <= 10 else f"{seeds[0]} to {seeds[-1]}"
    many = "seeds" if len(seeds) > 1 else "seed"
    return f"{text}; {plural(len(seeds), 'virtual machine')} ({many} {shown})."


def unknowns(
    plan: StudyPlan, runs: Sequence[StudyRun], responses: Sequence[ResponseAnalysis], notes: Sequence[str]
) -> list[str]:
    """Return what the study cannot know, in plain words: what was noted first."""
    points = [run.planned.point for run in runs]
    of_factors = [row for one in responses if one.anova is not None for row in _of_factors(one.anova)]
    tests = sum(math.isfinite(row.p) for row in of_factors)
    cautions = (
        (
            bool(plan.aliases),
            "Effects that the design mixes (listed below) are not told apart: what is said of one may be of "
            "another.",
        ),
        (
            bool(runs) and len(set(points)) == len(points),
            "No point was run twice: scatter of the runs and what the model misses are one error here.",
        ),
        (
            any(run.row is not None and run.row.truth for run in runs),
            "The runs are of virtual machines: what a real one does beyond the simulator's model is not in them.",
        ),
        (
            True,
            "It tells of settings between the levels below, with all else as the profile has it, and of nothing "
            "beyond.",
        ),
        (
            tests > 1,
            f"{tests} effects are tested. Were none of them there, about {decimal(tests * SURE, 1)} would still "
            f"have p < {SURE:g} by chance.",
        ),
    )
    noted = [sentence(note) for note in dict.fromkeys((*notes, *plan.notes))]
    return [*noted, *(text for holds, text in cautions if holds)]


def what_matters(info: ResponseInfo, one: ResponseAnalysis) -> list[str]:
    """Return what acts on a response, with its share of the variation and its probability."""
    if one.anova is None:
        return [f"{one.name}: not analysed; {'; '.join(one.notes) or 'the runs do not tell'}."]
    rows, error = _of_factors(one.anova), one.anova.error
    of_what = f"the variation of ln {one.name}" if one.is_log else f"the variation of {one.name}"
    if not error.dof or not math.isfinite(error.mean_square):
        shares = ", ".join(f"{row.name} {_share(row)}" for row in rows)
        text = f"{one.name}: of {of_what}, {shares}" if shares else f"{one.name}: no term varies"
        return [
            f"{text}. Nothing is left to estimate the error: none of this is shown to be more than chance."
        ]
    shown = [row for row in rows if row.p < SURE]
    large = [row for row in rows if row not in shown and row.adjusted_ss >= LARGE * error.mean_square]
    others = [row for row in rows if row not in shown and row not in large]
    found = [f"{one.name}: no effect is shown."]
    if shown:
        named = ", ".join(f"{row.name} ({_evidence(row)}{_best(info, one, row)})" for row in shown)
        acts = "act" if len(shown) > 1 else "acts"
        found = [f"{one.name}: {named} {acts}; shares are of {of_what}."]
    found += [
        f"{row.name} is large ({_evidence(row)}): six standard errors or more, but the row that F compares with has "
        f"{plural(one.anova.under(row.name).dof, 'degree')} of freedom. More replicates would decide."
        for row in large
    ]
    if others:
        named = ", ".join(f"{row.name} ({_evidence(row)})" for row in others)
        found.append(f"Not shown to act: {named}.")
    found += [
        f"Blocks (machines or tools) differ: {_evidence(row)}."
        for row in one.anova.rows
        if row.name == BLOCK and row.p < SURE
    ]
    found += filter(None, [differing_words(one.anova)])
    lack = one.lack
    if lack is not None and math.isfinite(lack.f) and lack.p < SURE:
        found.append(
            f"The model misses more than runs of one point differ by (lack of fit, {p_words(lack.p)}): there is "
            "more to it than these terms."
        )
    if one.held < one.left_out:
        found.append(
            f"Left out one by one, {one.held} of {one.left_out} points lay within what was expected."
        )
    return found


def differing_words(table: Anova) -> str:
    """Return which factors are compared with what they do differently from block to block; empty for none."""
    names = [row.name for row in table.rows if row.against != table.error.name]
    return " ".join(
        f"F of {name} is over {table.under(name).name}, what it does differently from machine to machine or tool to "
        "tool; that is no error of the others."
        for name in names
    )


def _of_factors(table: Anova) -> list[AnovaRow]:
    """Rows of factors and their products, without blocks, the strongest first."""
    rows = [row for row in table.rows if row.name != BLOCK and row not in table.by_block]
    return sorted(rows, key=lambda row: -row.contribution_pct)


def _share(row: AnovaRow) -> str:
    return f"{decimal(row.contribution_pct, 1)}{HARD}%"


def _evidence(row: AnovaRow) -> str:
    return f"{_share(row)}, {p_words(row.p)}"


def _best(info: ResponseInfo, one: ResponseAnalysis, row: AnovaRow) -> str:
    """Which level of a factor has the best mean; empty where that cannot be said."""
    for means in one.level_means:
        if means.factor == row.name and (level := best_level(info, means)) is not None:
            return f", best mean at {level_text(level)}"
    return ""


def best_level(info: ResponseInfo, table: LevelMeans) -> object:
    """Return the level with the best mean; None where no level is better than another."""
    pairs = list(zip(table.means, table.levels, strict=True))
    if info.better == "nominal":
        if info.target is None:
            return None
        return min(pairs, key=lambda pair: abs(pair[0] - (info.target or 0.0)))[1]
    choose = max if info.better == "larger" else min
    return choose(pairs, key=lambda pair: pair[0])[1]


def recommended(plan: StudyPlan, one: Recommendation | None) -> str:
    """Return what is recommended, and what is expected there."""
    if one is None:
        return "No settings are recommended."
    text = f"Recommended: {settings_text(plan.factors, one.settings)}."
    expected = [
        f"{name} {interval_text(*interval, plan.response(name))}" for name, interval in one.intervals.items()
    ]
    if expected:
        text += f" Expected of a new run there: {'; '.join(expected)}."
    if plan.constraints:
        text += (
            " The constraints are kept by the 95 % bounds of their means."
            if one.is_feasible
            else " The constraints are NOT kept."
        )
    return f"{text} {sentence(one.basis)}" if one.basis else text


def interval_text(value: float, low: float, high: float, info: ResponseInfo | None) -> str:
    """Return a value with its 95 % interval: `49.4 s (45.1 to 54.0)`."""
    text = significant(value, 4) + (f" {info.unit}" if info is not None and info.unit else "")
    if not (math.isfinite(low) and math.isfinite(high)):
        return f"{text} (interval unknown)"
    return f"{text} ({significant(low, 4)} to {significant(high, 4)})"


def confirmed(plan: StudyPlan, confirmations: Sequence[Confirmation]) -> list[str]:
    """Return whether runs that no model had seen lay within what was expected of them."""
    if not confirmations:
        return ["No confirmation run was made: what the models expect at new settings is not tested."]
    found = []
    for one in confirmations:
        at = f"At {settings_text(plan.factors, one.settings)}"
        tested = [response for response in one.responses if response.is_tested]
        broken = [response for response in tested if response.held < len(response.measured)]
        runs = plural(len(one.runs), "confirmation run")
        if not one.responses:
            found.append(f"{at}: {runs}, none with a value yet.")
        elif not tested:
            found.append(f"{at}: {runs}, of which the study expected nothing.")
        elif not broken:
            found.append(f"{at}: confirmation held. All values of {runs} lay within the 95 % intervals.")
        else:
            named = ", ".join(
                f"{response.name} ({response.held} of {len(response.measured)} within)" for response in broken
            )
            found.append(f"{at}: confirmation did NOT hold for {named}, by {runs}.")
        for limit in one.limits:
            upper = f", 95 % bound {significant(limit.upper, 3)}" if limit.upper is not None else ""
            found[-1] += (
                f" {limit.constraint}: {limit.verdict} (mean of the runs {significant(limit.mean, 3)}{upper})."
            )
    return found


def points_needed(one: ResponseAnalysis) -> int:
    """Return how many points the model cannot do without: they are not left out one by one."""
    return round(len(one.used) / one.model.replicates) - one.left_out if one.model is not None else 0


def why_not_predicted(one: ResponseAnalysis) -> str:
    """Return why no R² of runs that are left out can be given."""
    return "the model cannot do without some runs" if one.anova is not None else "there is no model"


def held(confirmations: Sequence[Confirmation]) -> bool | None:
    """Return whether every confirmation held; None where nothing was tested."""
    tested = [response for one in confirmations for response in one.responses if response.is_tested]
    return all(response.held == len(response.measured) for response in tested) if tested else None
