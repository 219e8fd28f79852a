"""The analysis of a study: each response, predictions at settings, and points compared with each other."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from edmctl import failures
from edmctl.dataclasses import dataclass, replace
from edmctl.quantity import half_width
from edmctl.study.design import (
    AS_LEVELS,
    settings_key,
    settings_matrix,
    terms_of,
    unit_points,
)
from edmctl.study.folder import StudyState
from edmctl.study.responses import range_of
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
from edmctl.wording import plain_number, plural

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from edmctl.study.statistics.response_analysis import (
        ResponseAnalysis,
        ResponseModel,
        Runs,
    )

LEAST_RUNS = 5
"""Fewer runs with a response make no model."""
DISTINGUISHING = 0.5
"""Distinguishing coefficient of grey relational grades."""


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
    settings, or the models of the analysis. Bounds are limited to possible values of the response. `runs` are those
    that processes are fitted to; by default all that count.
    """
    expected: dict[str, Interval | None]
    if has_suggestions(state):
        expected = _by_processes(state.plan, settings, fitting_runs(state) if runs is None else runs)
    else:
        done = [run for run in fitting_runs(state) if run.state is RunState.DONE]
        expected = {one.name: _by_analysis(state.plan, one, done, settings) for one in analyses}
    given = {one.name: one for one in state.folder.source.file.responses}
    found = {}
    for name, interval in expected.items():
        least, most = range_of(name)
        low, high = given[name].low, given[name].high
        low, high = least if low is None else low, most if high is None else high
        if interval is not None:
            found[name] = tuple(min(max(value, low), high) for value in interval)
    return found  # type: ignore[return-value]


def _by_analysis(
    plan: StudyPlan, analysis: ResponseAnalysis, runs: Sequence[StudyRun], settings: Mapping[str, Value]
) -> Interval | None:
    """Return what repeated runs at these settings show; else the model, if it knows their levels."""
    key = settings_key(settings)
    at_settings = [
        analysis.without_block(value, run.block)
        for run in runs
        if settings_key(run.planned.settings) == key and (value := run.value(analysis.name)) is not None
    ]
    by_runs = analysis.at_point(at_settings, len({run.planned.point for run in runs}))
    return by_runs or (predicted(plan, analysis.model, settings) if analysis.model is not None else None)


def predicted(plan: StudyPlan, model: ResponseModel, settings: Mapping[str, Value]) -> Interval | None:
    """Return what a model of the analysis expects of a run at settings, and the bounds of its 95 % interval.

    None where the model has seen no run at one of the levels.
    """
    matrix = settings_matrix(plan.factors, [settings], as_levels=plan.model in AS_LEVELS)
    if any(name not in model.names[factor] for factor, of in matrix.categories.items() for name in of):
        return None
    value, low, high = (float(bound[0]) for bound in model.predict(matrix))
    return value, low, high


def _by_processes(
    plan: StudyPlan, settings: Mapping[str, Value], runs: Sequence[StudyRun]
) -> dict[str, Interval | None]:
    """Return, by response, what a Gaussian process expects of a run on a new machine, and the 95 % interval."""
    from edmctl.study.statistics.surrogates import fit_process

    found: dict[str, Interval | None] = {}
    for response in plan.responses:
        having = [run for run in runs if run.value(response.name) is not None]
        values = values_of(having, response.name)
        if len(having) < LEAST_RUNS:
            continue
        is_log = response.is_log and min(values) > 0
        process = fit_process(
            unit_points(plan.factors, [run.planned.settings for run in having]),
            list(map(math.log, values)) if is_log else values,
            blocks=[run.block for run in having],
        )
        mean, sd = (float(of[0]) for of in process.predict(unit_points(plan.factors, [settings])))
        half = half_width(math.hypot(sd, process.noise_sd, process.block_sd))
        bounds = mean, mean - half, mean + half
        found[response.name] = tuple(map(math.exp, bounds)) if is_log else bounds  # type: ignore[assignment]
    return found


@dataclass(frozen=True, slots=True)
class StudyAnalysis:
    """The results of a study.

    runs : the design's runs that are done, in the order of the rows of every analysis; design tables use these alone
    added : runs that were suggested or added; `choices` use them too
    """

    plan: StudyPlan
    runs: tuple[StudyRun, ...]
    added: tuple[StudyRun, ...]
    responses: tuple[ResponseAnalysis, ...]
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
    table = doe_runs(plan, designed)
    analyses = [_analysis(plan, response, designed, table) for response in plan.responses]
    choices = _choices(state, (*designed, *added), analyses)
    notes = _notes(state, designed, added)
    return StudyAnalysis(plan, designed, added, tuple(analyses), choices, notes)


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
    plan: StudyPlan, response: ResponseInfo, designed: Sequence[StudyRun], runs: Runs
) -> ResponseAnalysis:
    from edmctl.study.statistics.response_analysis import analyse

    name = response.name
    return analyse(
        name,
        runs,
        [plain_number(run.value(name)) for run in designed],
        terms_of(plan.model, plan.factors, blocks=BLOCK in runs.settings.categories),
        response.better,  # type: ignore[arg-type]
        is_log=response.is_log,
        u=[plain_number(run.row.u.get(name) if run.row is not None else None) for run in designed],
    )


def pareto_front(costs: ArrayLike) -> Any:
    """Return which rows of (points, costs) no other dominates; a point that lacks a cost is not among them."""
    import numpy as np

    values = np.asarray(costs, float)
    as_good = (values[None, :, :] <= values[:, None, :]).all(axis=2)
    better_once = (values[None, :, :] < values[:, None, :]).any(axis=2)
    dominated = np.any(as_good & better_once, axis=1)
    return np.isfinite(values).all(axis=1) & ~dominated


def grey_relational_grade(costs: ArrayLike, weights: Sequence[float]) -> Any:
    """Return the grade of each point, 0 … 1 (Deng, J. Grey Syst. 1, 1989; normalised over these points)."""
    import numpy as np

    values = np.asarray(costs, float)
    spread = np.ptp(values, axis=0)
    missed = (values - values.min(axis=0)) / np.where(spread > 0, spread, 1.0)
    return DISTINGUISHING / (missed + DISTINGUISHING) @ (np.asarray(weights) / np.sum(weights))


def _choices(
    state: StudyState, runs: Sequence[StudyRun], analyses: Sequence[ResponseAnalysis]
) -> tuple[Choice, ...]:
    """Return every point with its means, whether another point dominates it, and its grade, which is a preference.

    Values are corrected by the effect of their block, if the design estimates it. A machine that the design did not
    use has no known effect: its values count as measured.
    """
    import numpy as np

    plan, broken = state.plan, broken_limits(state)
    points: dict[int, list[StudyRun]] = {}
    for run in runs:
        points.setdefault(run.planned.point, []).append(run)
    choices = []
    for point, members in points.items():
        settings = members[0].planned.settings
        means = {}
        for one in analyses:
            values = [one.without_block(plain_number(run.value(one.name)), run.block) for run in members]
            means[one.name] = _mean(values)
        limits = limits_of(plan, members, means, analyses)
        choices.append(
            Choice(
                point=point,
                settings=settings,
                runs=len(members),
                means={name: _or_none(value) for name, value in means.items()},
                upper={str(limit.constraint): limit.upper for limit in limits},
                is_feasible=all(limit.is_shown for limit in limits) and settings_key(settings) not in broken,
            )
        )
    ranked = [info for name in ranked_by(plan) if (info := plan.response(name)) is not None]
    table = np.array(
        [[cost_of(info, plain_number(one.means[info.name])) for info in ranked] for one in choices], float
    )
    front = pareto_front(np.where([[one.is_feasible] for one in choices], table, np.nan))
    is_whole = np.isfinite(table).all(axis=1)
    grades = np.full(len(table), np.nan)
    if is_whole.sum() > 1:
        weights = dict(plan.objectives)
        shares = [weights.get(info.name, 1.0) for info in ranked]
        grades[is_whole] = grey_relational_grade(table[is_whole], shares)
    return tuple(
        replace(one, is_pareto=bool(is_front), grey_grade=_or_none(float(grade)))
        for one, is_front, grade in zip(choices, front, grades, strict=True)
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
        half = plain_number(having[0].u95(bound.response)) if having else math.nan
        model = models.get(bound.response)
        if len(values) > 1:
            student = float(special.stdtrit(len(values) - 1, 0.95)) * statistics.stdev(values)
            half = max(student, half if math.isfinite(half) else 0.0) / math.sqrt(len(values))
        elif values and model is not None and not math.isfinite(half):
            interval = predicted(plan, model, runs[0].planned.settings)
            if interval is not None:
                expected, low, high = interval
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
        key: tuple(str(limit.constraint) for limit in limits_of(state.plan, runs) if not limit.is_kept)
        for key, runs in confirmed_settings(state).items()
    }
    return {key: texts for key, texts in found.items() if texts}


def _notes(state: StudyState, designed: Sequence[StudyRun], added: Sequence[StudyRun]) -> tuple[str, ...]:
    """Return the notes to be read before the tables."""
    plan, notes = state.plan, []
    if count := sum(run.state is RunState.OPEN for run in state.runs):
        notes.append(f"{count} of {len(state.runs)} runs are not made yet; tables are of those that are")
    if failed := [run for run in state.runs if run.state is RunState.FAILED]:
        notes.append(f"runs that failed are left out until somebody judges them: {number_ranges(failed)}")
    if extended := [run for run in designed if run.planned.number > len(plan.runs)]:
        notes.append(
            f"runs {number_ranges(extended)} are replicates of the design that were added later, in blocks of "
            "their own"
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


def _or_none(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _mean(values: Sequence[float]) -> float:
    known = [value for value in values if math.isfinite(value)]
    return math.fsum(known) / len(known) if known else math.nan
