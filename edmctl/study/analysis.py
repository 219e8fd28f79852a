"""The analysis of a study: each response, predictions at settings, and points compared with each other."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from edmctl import failures
from edmctl.dataclasses import dataclass
from edmctl.quantity import half_width
from edmctl.study.design import (
    AS_LEVELS,
    SENSITIVITY,
    settings_key,
    settings_matrix,
    terms_of,
    unit_points,
)
from edmctl.study.folder import StudyState
from edmctl.study.responses import TRUTHS, range_of
from edmctl.study.results import (
    TRUTH,
    Choice,
    ConfirmedLimit,
    Interval,
    ResponseInfo,
    RunKind,
    RunState,
    StudyPlan,
    StudyRun,
    Value,
)
from edmctl.study.statistics.linear_model import BLOCK
from edmctl.wording import plural

if TYPE_CHECKING:
    from edmctl.study.statistics.choice import SobolIndices
    from edmctl.study.statistics.response_analysis import ResponseAnalysis, ResponseModel, Runs


LEAST_RUNS = 5
"""Fewer runs with a response make no model."""


def has_suggestions(state: StudyState) -> bool:
    """Return whether the study has runs that were suggested."""
    return any(run.planned.kind is RunKind.SUGGESTED for run in state.runs)


def fitting_runs(state: StudyState) -> list[StudyRun]:
    """Return the runs that count: those that were made, failed ones too, without confirmations."""
    return [
        run
        for run in state.runs
        if run.planned.kind is not RunKind.CONFIRMATION and run.state in (RunState.DONE, RunState.FAILED)
    ]


def values_of(runs: Sequence[StudyRun], response: str) -> list[float]:
    """Return the values of the runs that have one."""
    return [float(value) for run in runs if (value := run.value(response)) is not None]


def expected_at(
    state: StudyState,
    analyses: Sequence[ResponseAnalysis],
    settings: Mapping[str, Value],
    runs: Sequence[StudyRun] | None = None,
) -> dict[str, Interval]:
    """Return, by response, what is expected of a run and the bounds of its 95 % interval; none without a model.

    After suggestions, which crowd where it is good, by Gaussian processes; else by the runs that were made at these
    settings, or the models of the analysis. What cannot be is cut off: a share below zero, or what a manual response
    cannot have. `runs` are those that processes are fitted to; by default all that count.
    """
    found: dict[str, Interval] = {}
    if has_suggestions(state):
        found = _by_processes(state.plan, settings, fitting_runs(state) if runs is None else runs)
    else:
        done = [run for run in fitting_runs(state) if run.state is RunState.DONE]
        for one in analyses:
            if expected := _by_analysis(state.plan, one, done, settings):
                found[one.name] = expected
    asked = {one.name: one for one in state.folder.source.file.responses}
    for name, values in found.items():
        least, most = range_of(name)
        least = least if (low := asked[name].low) is None else low
        most = most if (high := asked[name].high) is None else high
        found[name] = tuple(min(max(one, least), most) for one in values)  # type: ignore[assignment]
    return found


def _by_analysis(
    plan: StudyPlan, analysis: ResponseAnalysis, runs: Sequence[StudyRun], settings: Mapping[str, Value]
) -> Interval | None:
    """What runs at these settings say, where they were repeated; else the model, if it knows their levels."""
    key, points = settings_key(settings), len({run.planned.point for run in runs})
    own = [
        analysis.without_block(value, run.block)
        for run in runs
        if settings_key(run.planned.settings) == key and (value := run.value(analysis.name)) is not None
    ]
    by_runs = analysis.at_point(own, points)
    return by_runs or (predicted(plan, analysis.model, settings) if analysis.model is not None else None)


def predicted(plan: StudyPlan, model: ResponseModel, settings: Mapping[str, Value]) -> Interval | None:
    """Return what a model of the analysis expects of a run at settings, and the bounds of its 95 % interval.

    None where the model has seen no run at one of the levels.
    """
    matrix = settings_matrix(plan.factors, [settings], as_levels=plan.model in AS_LEVELS)
    if any(name not in model.names[factor] for factor, of in matrix.categories.items() for name in of):
        return None
    value, low, high = (float(one[0]) for one in model.predict(matrix))
    return value, low, high


def _by_processes(
    plan: StudyPlan, settings: Mapping[str, Value], runs: Sequence[StudyRun]
) -> dict[str, Interval]:
    """Return, by response, what a Gaussian process expects of a run on a new machine, and the 95 % interval."""
    from edmctl.study.statistics.surrogates import fit_process

    found: dict[str, Interval] = {}
    for response in plan.responses:
        having = [run for run in runs if run.value(response.name) is not None]
        values = values_of(having, response.name)
        if len(having) < LEAST_RUNS:
            continue
        is_log = response.is_log and min(values) > 0
        process = fit_process(
            unit_points(plan.factors, [run.planned.settings for run in having]),
            [math.log(value) for value in values] if is_log else values,
            blocks=[run.block for run in having],
        )
        mean, sd = (float(one[0]) for one in process.predict(unit_points(plan.factors, [settings])))
        half = half_width(math.sqrt(sd**2 + process.noise_sd**2 + process.block_sd**2))
        bounds = (mean, mean - half, mean + half)
        found[response.name] = tuple(map(math.exp, bounds)) if is_log else bounds  # type: ignore[assignment]
    return found


def wide_intervals(state: StudyState, expected: Mapping[str, Interval]) -> list[str]:
    """Return the responses whose interval is wider than all that was measured of them."""
    found = []
    for name, (_, low, high) in expected.items():
        values = values_of(fitting_runs(state), name)
        if values and high - low > max(values) - min(values):
            found.append(name)
    return found


@dataclass(frozen=True, slots=True)
class StudyAnalysis:
    """The results of a study.

    runs : the design's runs that are done, in the order of the rows of every analysis; design tables use these alone
    added : runs that were suggested or added; `choices` use them too
    truths : analyses of the virtual machine's true values, by response
    """

    plan: StudyPlan
    runs: tuple[StudyRun, ...]
    added: tuple[StudyRun, ...]
    responses: tuple[ResponseAnalysis, ...]
    truths: dict[str, ResponseAnalysis]
    indices: dict[str, SobolIndices]
    choices: tuple[Choice, ...]
    notes: tuple[str, ...]


def analysis_of(state: StudyState) -> StudyAnalysis:
    """Analyse the runs that are done. Raises PreconditionError E8206 if there are none."""
    plan = state.plan
    done = [run for run in state.runs if run.state is RunState.DONE]
    if not done:
        raise failures.study_without_runs(folder=state.folder.path)
    designed = tuple(run for run in done if plan.is_of_design(run.planned))
    others = (run for run in done if not plan.is_of_design(run.planned))
    added = tuple(run for run in others if run.planned.kind is not RunKind.CONFIRMATION)
    runs = doe_runs(plan, designed)
    analyses, truths, indices = [], {}, {}
    for response in plan.responses:
        analyses.append(_analysis(plan, response.name, response, designed, runs))
        has_truth = response.name in TRUTHS and not response.is_manual  # a manual one may be something else
        if has_truth and any(run.row and run.row.truth for run in designed):
            truths[response.name] = _analysis(plan, f"{TRUTH}{response.name}", response, designed, runs)
        if plan.model == SENSITIVITY and (found := _indices(plan, response, designed)) is not None:
            indices[response.name] = found
    return StudyAnalysis(
        plan,
        designed,
        added,
        tuple(analyses),
        truths,
        indices,
        _choices(state, (*designed, *added), analyses),
        _notes(state, designed, added),
    )


def doe_runs(plan: StudyPlan, runs: Sequence[StudyRun]) -> Runs:
    """Return runs in the form that the statistics read.

    Runs that share no block with another have no block term: the difference between machines is in their error.
    """
    from edmctl.study.statistics.response_analysis import Runs

    settings = [run.planned.settings for run in runs]
    blocks = [run.block for run in runs]
    if len(set(blocks)) == len(blocks):
        blocks = [0] * len(blocks)
    design = {run.planned.point for run in runs if run.planned.kind is RunKind.DESIGN}
    return Runs(
        settings_matrix(plan.factors, settings, blocks, as_levels=plan.model in AS_LEVELS),
        {factor.name: [one[factor.key] for one in settings] for factor in plan.factors},
        [run.planned.point for run in runs],
        blocks,
        frozenset(run.planned.point for run in runs) - design,
        is_one_machine=is_one_machine(runs),
    )


def is_one_machine(runs: Sequence[StudyRun]) -> bool:
    """Return whether one machine with one tool made all of these runs: its errors are in all of them alike."""
    return len({run.tool or f"seed {run.planned.seed}" for run in runs}) == 1


def _analysis(
    plan: StudyPlan, name: str, response: ResponseInfo, designed: Sequence[StudyRun], runs: Runs
) -> ResponseAnalysis:
    from edmctl.study.statistics.response_analysis import analyse

    model = "main" if plan.model == SENSITIVITY else plan.model
    return analyse(
        name,
        runs,
        [_number(run.value(name)) for run in designed],
        terms_of(model, plan.factors, blocks=BLOCK in runs.settings.categories),
        response.better,  # type: ignore[arg-type]
        is_log=response.is_log,
        u=[_number(run.row.u.get(name) if run.row is not None else None) for run in designed],
    )


def _indices(plan: StudyPlan, response: ResponseInfo, runs: Sequence[StudyRun]) -> SobolIndices | None:
    """Sobol indices over the points in their order, means over replicates; None if there are too few."""
    from edmctl.study.statistics.choice import sobol_indices

    values: dict[int, list[float]] = {run.point: [] for run in plan.runs if run.kind is RunKind.DESIGN}
    for run in runs:
        if run.planned.kind is RunKind.DESIGN:
            values[run.planned.point].append(_number(run.value(response.name)))
    try:
        return sobol_indices([_mean(values[point]) for point in sorted(values)], len(plan.factors))
    except ValueError:
        return None


def _choices(
    state: StudyState, runs: Sequence[StudyRun], analyses: Sequence[ResponseAnalysis]
) -> tuple[Choice, ...]:
    """Every point with its means, whether another point dominates it, and two rankings, which are preferences.

    Values are corrected by the effect of their block, if the design estimates it. A machine that the design did not
    use has no known effect: its values count as measured.
    """
    import numpy as np

    from edmctl.study.statistics.choice import grey_relational_grade, pareto_front, topsis_closeness

    plan, broken = state.plan, broken_limits(state)
    by_point: dict[int, list[StudyRun]] = {}
    for run in runs:
        by_point.setdefault(run.planned.point, []).append(run)
    ranked = [info for name in ranked_by(plan) if (info := plan.response(name)) is not None]
    weights = dict(plan.objectives)
    means, upper, feasible = [], [], []
    for members in by_point.values():
        of_point = {
            one.name: _mean([one.without_block(_number(run.value(one.name)), run.block) for run in members])
            for one in analyses
        }
        bounds = limits_of(plan, members, of_point, analyses)
        is_broken = bool(broken.get(settings_key(members[0].planned.settings)))
        means.append(of_point)
        upper.append({str(one.constraint): one.upper for one in bounds})
        feasible.append(all(one.is_shown for one in bounds) and not is_broken)
    table = np.array([[cost_of(info, of_point[info.name]) for info in ranked] for of_point in means])
    front = pareto_front(np.where(np.array(feasible)[:, None], table, np.nan))
    whole = np.isfinite(table).all(axis=1)
    grades, closeness = np.full(len(table), np.nan), np.full(len(table), np.nan)
    if whole.sum() > 1:
        shares = [weights.get(info.name, 1.0) for info in ranked]
        grades[whole] = grey_relational_grade(table[whole], shares)
        closeness[whole] = topsis_closeness(table[whole], shares)
    return tuple(
        Choice(
            point=point,
            settings=members[0].planned.settings,
            runs=len(members),
            means={name: _or_none(value) for name, value in means[n].items()},
            upper=upper[n],
            is_feasible=feasible[n],
            is_pareto=bool(front[n]),
            grey_grade=_or_none(float(grades[n])),
            topsis_closeness=_or_none(float(closeness[n])),
        )
        for n, (point, members) in enumerate(by_point.items())
    )


def ranked_by(plan: StudyPlan) -> list[str]:
    """Return the responses that points are ranked by: the objectives, else all with a direction."""
    return [name for name, _ in plan.objectives] or [
        one.name
        for one in plan.responses
        if (one.better != "nominal" or one.target is not None) and not one.name.startswith(TRUTH)
    ]


def cost_of(info: ResponseInfo, value: float) -> float:
    """Return a response as a cost: the smaller the better."""
    if info.better == "larger":
        return -value
    return abs(value - info.target) if info.better == "nominal" and info.target is not None else value


def limits_of(
    plan: StudyPlan,
    runs: Sequence[StudyRun],
    means: Mapping[str, float] | None = None,
    analyses: Sequence[ResponseAnalysis] = (),
) -> tuple[ConfirmedLimit, ...]:
    """Return each constraint with the mean of a point's runs, and the bound of its 95 % interval towards the limit.

    Of several runs half of the interval is after Student, of their values as they were measured; of a single one
    that of its own interval, or of a run there by the model. The bound is None where neither is known. Without
    `means` they are those of the measured values, and constraints without any are left out.
    """
    from scipy import special

    found = []
    models = {one.name: one.model for one in analyses}
    for bound in plan.constraints:
        having = [run for run in runs if run.value(bound.response) is not None]
        values = values_of(having, bound.response)
        if means is None and not values:
            continue
        mean = _mean(values) if means is None else means[bound.response]
        own = _number(having[0].row.u95.get(bound.response) if having and having[0].row else None)
        model = models.get(bound.response)
        half = own
        if len(values) > 1:
            root = math.sqrt(len(values))
            half = float(special.stdtrit(len(values) - 1, 0.95)) * statistics.stdev(values) / root
            half = max(half, own / root if math.isfinite(own) else 0.0)
        elif not math.isfinite(own) and model is not None and values:
            there = predicted(plan, model, runs[0].planned.settings)
            expected, low, high = there or (math.nan, math.nan, math.nan)
            half = high - expected if bound.sign > 0 else expected - low
        found.append(ConfirmedLimit(bound, mean, _or_none(mean + bound.sign * half)))
    return tuple(found)


def confirmed_settings(state: StudyState) -> dict[str, list[StudyRun]]:
    """Return the confirmation runs that are done, by their settings."""
    found: dict[str, list[StudyRun]] = {}
    for run in state.runs:
        if run.planned.kind is RunKind.CONFIRMATION and run.state is RunState.DONE:
            found.setdefault(settings_key(run.planned.settings), []).append(run)
    return found


def broken_limits(state: StudyState) -> dict[str, tuple[str, ...]]:
    """Return, by settings, the constraints that the mean of confirmation runs did not keep; no others."""
    found = {
        key: tuple(str(one.constraint) for one in limits_of(state.plan, runs) if not one.is_kept)
        for key, runs in confirmed_settings(state).items()
    }
    return {key: texts for key, texts in found.items() if texts}


def _notes(state: StudyState, designed: Sequence[StudyRun], added: Sequence[StudyRun]) -> tuple[str, ...]:
    """What a reader has to know before the tables."""
    plan, notes = state.plan, []
    left = [run for run in state.runs if run.state is RunState.OPEN]
    failed = [run for run in state.runs if run.state is RunState.FAILED]
    if left:
        notes.append(f"{len(left)} of {len(state.runs)} runs are not made yet; tables are of those that are")
    if failed:
        numbers = ", ".join(str(run.planned.number) for run in failed[:10])
        notes.append(f"runs that failed are left out until somebody judges them: {numbers}")
    if extended := [run for run in designed if run.planned.number > len(plan.runs)]:
        notes.append(
            f"runs {number_ranges(extended)} are replicates or fold-overs of the design that were added later, in "
            "blocks of their own"
        )
    if added:
        notes.append(
            f"the tables of each response use the {plural(len(designed), 'run')} of the design; "
            f"{plural(len(added), 'run')} suggested or added later ({number_ranges(added)}) are in the list of "
            "points and in the Gaussian processes of the recommendation"
        )
    if is_one_machine(designed):
        notes.append(
            "all runs of the design are of one machine or tool: its errors are in every value alike, may follow "
            "time or wear, and look like an effect; this study cannot show how another machine would do"
        )
    return (*notes, *plan.notes)


def number_ranges(runs: Sequence[StudyRun]) -> str:
    """Return the numbers of runs as text, neighbours as a range: `1–8, 11`."""
    parts: list[list[int]] = []
    for number in sorted(run.planned.number for run in runs):
        if parts and number == parts[-1][-1] + 1:
            parts[-1] = [parts[-1][0], number]
        else:
            parts.append([number])
    return ", ".join("–".join(map(str, part)) for part in parts)


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _or_none(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _mean(values: Sequence[float]) -> float:
    found = [value for value in values if math.isfinite(value)]
    return math.fsum(found) / len(found) if found else math.nan
