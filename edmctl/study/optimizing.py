"""Suggestions by Gaussian processes: where the next run is worth most, and what is recommended in the end.

The state of the optimiser is the rows: the same study and rows give the same suggestion, in any process.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from edmctl.errors import PreconditionError, ProfileError
from edmctl.jobs.plan import check
from edmctl.jobs.surroundings import NONE, Surroundings
from edmctl.study.analysis import broken_limits, confirmed_settings, cost_of
from edmctl.study.confirming import (
    best_of_points,
    nothing_left,
    recommendation,
    refuse_without_room,
    refuted_words,
    suggested_runs,
)
from edmctl.study.expectations import LEAST_RUNS, expected_at, fitting_runs, has_suggestions
from edmctl.study.factors import coded, settings_key, unit_points, value_at
from edmctl.study.planning import request_of
from edmctl.study.results import (
    ConstraintInfo,
    FactorInfo,
    PlannedRun,
    Recommendation,
    ResponseInfo,
    RunKind,
    RunState,
    StudyPlan,
    StudyRun,
    Value,
)
from edmctl.wording import plural

if TYPE_CHECKING:
    from edmctl.study.folder import StudyState

CANDIDATES = 1024
AROUND, BEST, NEAR = 64, 4, 0.15
"""So many candidates about each of the runs with the best objectives, within this share of half a factor's range."""
MOST_REFUSED = 200


def next_batch(state: StudyState, surroundings: Surroundings = NONE) -> list[PlannedRun]:
    """Return the runs that come next in an optimisation; none when all of its runs are made.

    Raises PreconditionError E8216 where a suggested run waits for values that people measure, and what
    `suggestions` raises.
    """
    optimize = state.folder.source.file.optimize
    if waiting := [run for run in _untold(state) if run.planned.kind is RunKind.SUGGESTED]:
        number = waiting[0].planned.number
        names = [name for name in _by_hand(state) if waiting[0].value(name) is None]
        raise PreconditionError(
            f"Run {number} was suggested and waits for {', '.join(names)}: nothing follows from it before.",
            hint=f"Measure it: `{state.folder.command('tell', str(number), f'{names[0]}=VALUE')}`, then go on with "
            f"`{state.making_command('optimize')}`.",
            code="E8216",
        )
    left = min(optimize.batch, optimize.runs - counted(state))
    return suggestions(state, left, surroundings) if left > 0 else []


def counted(state: StudyState) -> int:
    """Return how many runs count against the number in [optimize]: those of the design, and suggestions."""
    is_of_design = state.folder.plan.is_of_design
    return sum(run.planned.kind is RunKind.SUGGESTED or is_of_design(run.planned) for run in state.runs)


def suggestions(state: StudyState, count: int, surroundings: Surroundings = NONE) -> list[PlannedRun]:
    """Return so many runs where objectives and constraints are expected to gain most, each checked as a job is.

    Each has a virtual machine of its own. Raises PreconditionError: E8209 there is nothing to optimise, E8210 too
    few runs have a response, E8211 the rules refuse whatever is suggested, E8217 confirmation has refuted all
    settings.
    """
    from edmctl.study.statistics.suggestion import suggest

    plan, file = state.folder.plan, state.folder.source.file
    runs, objective, constraints = _data(state)
    settings = _candidates(state, runs, objective)
    pending = [run for run in state.runs if run.state is RunState.OPEN] + _untold(state)
    refuse_without_room(state, count)
    budget = max(file.optimize.runs, len(runs) + count)
    for _ in range(MOST_REFUSED):
        found = suggest(
            unit_points(plan.factors, [run.planned.settings for run in runs]),
            objective,
            constraints,
            unit_points(plan.factors, settings),
            runs=count,
            pending=unit_points(plan.factors, [run.planned.settings for run in pending]) if pending else (),
            budget=budget,
            blocks=[run.block for run in runs],
        )
        chosen = [settings[one.candidate] for one in found]
        refused = [one for one in chosen if not _is_allowed(state, one, surroundings)]
        if not refused:
            return suggested_runs(state, chosen)
        settings = [one for one in settings if one not in refused]
        if not settings:
            break
    raise PreconditionError(
        "The rules of recipes refuse whatever is suggested.",
        hint="Narrow the factors: `edmctl study plan` tells which settings are refused.",
        code="E8211",
    )


def recommended(state: StudyState, surroundings: Surroundings = NONE) -> Recommendation:
    """Return the settings that are expected best and keep every constraint by its 95 % bound.

    Without suggestions it is one of the points that were run. Raises what `suggestions` and `best_of_points` raise.
    """
    if not has_suggestions(state):
        return best_of_points(state)
    from edmctl.study.statistics.suggestion import recommend

    plan = state.folder.plan
    runs, objective, constraints = _data(state)
    settings = _candidates(state, runs, objective)
    while True:
        found = recommend(
            unit_points(plan.factors, [run.planned.settings for run in runs]),
            objective,
            constraints,
            unit_points(plan.factors, settings),
            blocks=[run.block for run in runs],
        )
        chosen = settings[found.least_violating]
        if _is_allowed(state, chosen, surroundings) or len(settings) == 1:
            break
        settings = [one for one in settings if one is not chosen]
    names = ", ".join(name for name, _ in plan.objectives)
    designed = sum(plan.is_of_design(run.planned) for run in runs)
    basis = (
        f"Best expected {names} by Gaussian processes over {len(runs)} runs ({designed} of the design, "
        f"{len(runs) - designed} suggested or added).{refuted_words(state)}"
    )
    return recommendation(
        state,
        chosen,
        expected_at(state, (), chosen, runs),
        basis,
        is_feasible=found.candidate is not None,
    )


def _data(state: StudyState) -> tuple[list[StudyRun], list[float], list[tuple[list[float], float]]]:
    """The runs, the objective to be minimised, and each constraint's values with the limit they shall not exceed."""
    plan = state.folder.plan
    if not plan.objectives:
        raise PreconditionError(
            "The study has no objective.",
            hint="Add [[objectives]] with a response to the study file, and plan it anew.",
            code="E8209",
        )
    wanted = _wanted(plan)
    # A value that nobody has told yet is not known; only a run that failed tells where runs fail.
    runs = [
        run
        for run in (*fitting_runs(state), *_disproving(state))
        if run.state is RunState.FAILED or all(run.value(name) is not None for name in wanted)
    ]
    infos = {one.name: one for one in plan.responses}
    objective = _objective(plan.objectives, infos, runs)
    known = sum(math.isfinite(value) for value in objective)
    if known < LEAST_RUNS:
        raise PreconditionError(
            f"{plural(known, 'run')} of {LEAST_RUNS} that a suggestion needs have a value of every objective.",
            hint=f"Make the design's runs first: `{state.making_command('resume')}`."
            if any(run.state is RunState.OPEN for run in state.runs)
            else f"Tell responses that are measured by hand: `{state.folder.command('tell')} RUN NAME=VALUE`.",
            code="E8210",
        )
    return runs, objective, [_constraint(bound, infos[bound.response], runs) for bound in plan.constraints]


def _wanted(plan: StudyPlan) -> list[str]:
    """Names of the responses that a suggestion is about."""
    return [*(name for name, _ in plan.objectives), *(bound.response for bound in plan.constraints)]


def _untold(state: StudyState) -> list[StudyRun]:
    """Runs that were made and lack a value that people measure."""
    wanted = _by_hand(state)
    return [
        run
        for run in fitting_runs(state)
        if run.state is RunState.DONE and any(run.value(name) is None for name in wanted)
    ]


def _by_hand(state: StudyState) -> list[str]:
    """Names of the responses that a suggestion is about and people measure."""
    manual = {one.name for one in state.folder.plan.responses if one.is_manual}
    return [name for name in dict.fromkeys(_wanted(state.folder.plan)) if name in manual]


def _disproving(state: StudyState) -> list[StudyRun]:
    """Confirmation runs that broke a constraint: they confirm nothing any more, and teach as others do."""
    broken = broken_limits(state)
    return [run for key, runs in confirmed_settings(state).items() if key in broken for run in runs]


def _objective(
    objectives: Sequence[tuple[str, float]], infos: Mapping[str, ResponseInfo], runs: Sequence[StudyRun]
) -> list[float]:
    """One cost a run: of a single objective its own scale, of several the weighted sum of standardised ones."""
    columns = [_costs(infos[name], [run.value(name) for run in runs]) for name, _ in objectives]
    if len(columns) == 1:
        return columns[0]
    whole = [0.0] * len(runs)
    for column, (_, weight) in zip(columns, objectives, strict=True):
        known = [value for value in column if math.isfinite(value)]
        mean = math.fsum(known) / max(1, len(known))
        sd = math.sqrt(math.fsum((value - mean) ** 2 for value in known) / max(1, len(known) - 1)) or 1.0
        whole = [total + weight * (value - mean) / sd for total, value in zip(whole, column, strict=True)]
    return whole


def _costs(info: ResponseInfo, values: Sequence[float | None]) -> list[float]:
    """What is wanted small of a response, NaN where there is no value: logarithms where all of them have one."""
    known = [value for value in values if value is not None]
    wants_target = info.better == "nominal" and info.target is not None
    is_log = info.is_log and not wants_target and bool(known) and min(known) > 0
    scaled = [value if value is None or not is_log else math.log(value) for value in values]
    return [math.nan if value is None else cost_of(info, value) for value in scaled]


def _constraint(
    bound: ConstraintInfo, info: ResponseInfo, runs: Sequence[StudyRun]
) -> tuple[list[float], float]:
    values = [run.value(bound.response) for run in runs]
    known = [value for value in values if value is not None]
    is_log = info.is_log and bound.limit > 0 and bool(known) and min(known) > 0

    def scaled(value: float) -> float:
        return bound.sign * (math.log(value) if is_log else value)

    return [math.nan if value is None else scaled(value) for value in values], scaled(bound.limit)


def _candidates(
    state: StudyState, runs: Sequence[StudyRun], objective: Sequence[float]
) -> list[dict[str, Value]]:
    """Settings that may be suggested, but for those whose confirmation has broken a constraint.

    A Sobol sequence over the factors; ends and middles of the factors, where the best often lies and no inner point
    reaches; the surroundings of the runs with the best objectives; and all that were run.
    """
    from edmctl.study.statistics.designs import sobol_points

    plan, file = state.folder.plan, state.folder.source.file
    steps = {factor.key: factor.step for factor in file.factors}
    ranges = [
        replace(factor, is_number=False) if factor.is_number and not factor.is_range else factor
        for factor in plan.factors
    ]

    def settings_at(row: Sequence[float]) -> dict[str, Value]:
        return {
            f.key: value_at(f, min(max(x, -1.0), 1.0), steps[f.key]) for f, x in zip(ranges, row, strict=True)
        }

    rows = sobol_points(len(ranges), CANDIDATES, file.design.seed).tolist()
    rows += _ends(ranges)
    around = sobol_points(len(ranges), AROUND, file.design.seed + 1).tolist()
    best = sorted(
        (n for n, value in enumerate(objective) if math.isfinite(value)), key=lambda n: objective[n]
    )
    centres = {settings_key(runs[n].planned.settings): runs[n].planned.settings for n in best[:BEST]}
    for centre in centres.values():
        here = [coded(f, centre[f.key]) if f.is_number else None for f in ranges]
        rows += [
            [x if at is None else at + NEAR * x for at, x in zip(here, row, strict=True)] for row in around
        ]
    made = [dict(run.planned.settings) for run in state.runs if run.planned.kind is not RunKind.CONFIRMATION]
    found = {settings_key(one): one for one in (*map(settings_at, rows), *made)}
    broken = broken_limits(state)
    left = [one for key, one in found.items() if key not in broken]
    if not left:
        raise nothing_left(state, "suggest")
    return left


def _ends(factors: Sequence[FactorInfo]) -> list[list[float]]:
    """Coded points at all ends and middles of the factors, or at the ends alone; none where those are too many."""
    for levels in ((-1.0, 0.0, 1.0), (-1.0, 1.0)):
        counts = [0 if factor.is_number else len(factor.values) for factor in factors]
        own = [[(2 * n + 1) / count - 1 for n in range(count)] or levels for count in counts]
        if math.prod(map(len, own)) <= CANDIDATES:
            return [list(row) for row in itertools.product(*own)]
    return []


def _is_allowed(state: StudyState, settings: Mapping[str, Value], surroundings: Surroundings) -> bool:
    try:
        check(request_of(state.folder.base, settings), surroundings)
    except ProfileError:
        return False
    return True
