"""Runs beyond the design: suggestions, confirmation runs, replicates, and the recommendation.

All of it follows from the study file and the rows: the same rows give the same suggestion, in any process.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

from edmctl import failures
from edmctl.dataclasses import replace
from edmctl.errors import PreconditionError, ProfileError
from edmctl.jobs.plan import check
from edmctl.jobs.surroundings import NONE, Surroundings
from edmctl.study.analysis import (
    LEAST_RUNS,
    analysis_of,
    broken_limits,
    confirmed_settings,
    cost_of,
    expected_at,
    fitting_runs,
    has_suggestions,
    is_one_machine,
    limits_of,
    ranked_by,
    values_of,
)
from edmctl.study.design import coded, settings_key, unit_points, value_at
from edmctl.study.folder import StudyState
from edmctl.study.planning import grid_of, request_of
from edmctl.study.results import (
    Confirmation,
    ConfirmedResponse,
    FactorInfo,
    Interval,
    PlannedRun,
    Recommendation,
    ResponseInfo,
    RunKind,
    RunState,
    StudyPlan,
    StudyRun,
    Value,
)
from edmctl.study.statistics.designs import sobol_points
from edmctl.wording import plural

if TYPE_CHECKING:
    from edmctl.study.statistics.surrogates import Surrogates

FRESH_SEEDS = 1_000_003
"""From the seeds of the design to those of confirmation runs: beyond any number of runs."""
CANDIDATES = 1024
AROUND, BEST, NEAR = 64, 4, 0.15
"""Candidates about each of the runs with the best objectives, within this share of half a factor's range."""
MOST_REFUSED = 200

Constraint = tuple[list[float], float]
"""Values of a constrained response and the limit that they shall not exceed."""


def confirmations_of(state: StudyState) -> list[Confirmation]:
    """Return the results of confirmation runs, by their settings and what was expected of them then.

    Limits are of all runs at the settings.
    """
    found = []
    for at_settings in confirmed_settings(state).values():
        limits = limits_of(state.plan, at_settings)
        groups: dict[str, list[StudyRun]] = {}
        for run in at_settings:
            groups.setdefault(repr(state.rows.expected.get(run.planned.number)), []).append(run)
        for runs in groups.values():
            expected = state.rows.expected.get(runs[0].planned.number, {})
            responses = tuple(
                ConfirmedResponse(info.name, *expected.get(info.name, (math.nan,) * 3), tuple(measured))
                for info in state.plan.responses
                if (measured := values_of(runs, info.name))
            )
            numbers = tuple(run.planned.number for run in runs)
            found.append(Confirmation(runs[0].planned.settings, numbers, responses, limits))
    return found


def confirmation_runs(state: StudyState, settings: Mapping[str, Value], runs: int) -> list[PlannedRun]:
    """Return new runs at settings, each on a machine of its own that the study has not used.

    Raises PreconditionError E8207 where a machine that lasts has no place for them.
    """
    refuse_without_room(state, runs)
    before = sum(run.planned.kind is RunKind.CONFIRMATION for run in state.runs)
    seed = state.folder.source.file.design.seed + FRESH_SEEDS + before
    return _added(state, RunKind.CONFIRMATION, [settings] * runs, seed)


def refuse_without_room(state: StudyState, count: int) -> None:
    """Raise PreconditionError E8207 where the grid of a machine has no place for more runs."""
    machine = state.folder.source.file.machine
    if machine is None or not state.rows.port:
        return
    taken = sum(map(len, state.rows.attempts.values()))
    planned = sum(run.state is RunState.OPEN for run in state.runs)
    free = len(grid_of(machine)) - taken - planned
    if free < count:
        raise failures.grid_too_small(places=plural(max(0, free), "place"), runs=plural(count, "more run"))


def suggested_runs(state: StudyState, settings: Sequence[Mapping[str, Value]]) -> list[PlannedRun]:
    """Return new runs, one at each of `settings`, on machines after the machines of the design."""
    return _added(state, RunKind.SUGGESTED, settings, _next_seed(state))


def _next_seed(state: StudyState) -> int:
    return 1 + max(run.planned.seed for run in state.runs if run.planned.kind is not RunKind.CONFIRMATION)


def extension_runs(state: StudyState) -> list[PlannedRun]:
    """Return the runs of one more replicate of the design, in blocks of their own.

    Each machine (seed), block and tool of the first replicate becomes a new one; design runs are shuffled in each
    block. Raises PreconditionError E8207 if the grid has no room.
    """
    plan, file = state.plan, state.folder.source.file
    first = [run for run in plan.runs if run.replicate == 1]
    refuse_without_room(state, len(first))
    replicate = max(plan.replicates, *(run.planned.replicate for run in state.runs)) + 1
    runs = _shuffled(first, [file.design.seed, replicate]) if file.design.order == "random" else first
    last = max(run.planned.number for run in state.runs)
    seeds = _renumbered((run.seed for run in first), _next_seed(state))
    blocks = _renumbered((run.block for run in first), max(run.planned.block for run in state.runs) + 1)
    tools = _renumbered((run.tool for run in first), max(run.tool for run in state.runs) + 1)
    are_tools_blocks = file.machine is not None and file.machine.holes_per_tool is not None
    found = []
    for number, run in enumerate(runs, last + 1):
        tool = tools[run.tool] if are_tools_blocks else run.tool
        block = tool if are_tools_blocks else blocks[run.block]
        seed = seeds[run.seed]
        found.append(replace(run, number=number, replicate=replicate, block=block, seed=seed, tool=tool))
    return found


def _shuffled(runs: Sequence[PlannedRun], seed: Sequence[int]) -> list[PlannedRun]:
    """Return runs with the settings of the design runs shuffled in each block; centre runs keep their places."""
    import numpy as np

    rng, found = np.random.default_rng(seed), list(runs)
    for block in dict.fromkeys(run.block for run in runs):
        places = [n for n, run in enumerate(runs) if run.block == block and run.kind is RunKind.DESIGN]
        for place, other in zip(places, rng.permutation(places).tolist(), strict=True):
            found[place] = replace(runs[place], settings=runs[other].settings, point=runs[other].point)
    return found


def _renumbered(numbers: Iterable[int], first: int) -> dict[int, int]:
    return {number: first + n for n, number in enumerate(dict.fromkeys(numbers))}


def _points(state: StudyState) -> dict[str, int]:
    """Return the number of each point by the key of its settings."""
    return {settings_key(run.planned.settings): run.planned.point for run in state.runs}


def _added(
    state: StudyState, kind: RunKind, settings: Sequence[Mapping[str, Value]], first_seed: int
) -> list[PlannedRun]:
    """Return runs numbered after those of the study: each a block of its own, or of the tool with holes left.

    Where centre runs open and close the holes of a tool, those of suggestions are among them.
    """
    machine = state.folder.source.file.machine
    holes = machine.holes_per_tool if machine is not None else None
    points = _points(state)
    last = max(run.planned.number for run in state.runs)
    block = max(run.planned.block for run in state.runs)
    tools = [run.tool for run in state.runs]
    found: list[PlannedRun] = []

    def add(kind: RunKind, settings: Mapping[str, Value]) -> None:
        point = points.setdefault(settings_key(settings), max(points.values()) + 1)
        tool = max(tools) + (holes is not None and tools.count(max(tools)) >= holes) if machine else 0
        tools.append(tool)
        n = len(found)
        found.append(
            PlannedRun(
                number=last + n + 1,
                kind=kind,
                point=point,
                replicate=1,
                block=tool if machine else block + n + 1,
                seed=first_seed + n,
                settings=dict(settings),
                tool=tool,
            )
        )

    has_centers = kind is RunKind.SUGGESTED and machine is not None and machine.center_runs
    center = next((run.planned.settings for run in state.runs if run.planned.kind is RunKind.CENTER), None)
    for one in settings:
        if has_centers and center is not None and holes is not None:
            if tools.count(max(tools)) == holes - 1:
                add(RunKind.CENTER, center)  # the last hole of this tool
            if tools.count(max(tools)) >= holes:
                add(RunKind.CENTER, center)  # the first one of the next
        add(kind, one)
    return found


def recommended(state: StudyState, surroundings: Surroundings = NONE) -> Recommendation:
    """Return the settings that are expected best and keep every constraint by its 95 % bound.

    Without suggestions it is one of the points that were run. Raises what `suggestions` raises, PreconditionError
    E8206 without runs, E8208 without a point to compare.
    """
    plan = state.plan
    if not has_suggestions(state):
        return _best_point(state)
    runs, settings, fitted = _fitted(state)
    while True:
        outlook = fitted.outlook(unit_points(plan.factors, settings))
        chosen = settings[outlook.nearest]
        if _is_allowed(state, chosen, surroundings) or len(settings) == 1:
            break
        settings = [one for one in settings if one is not chosen]
    designed = sum(plan.is_of_design(run.planned) for run in runs)
    basis = (
        f"Best expected {', '.join(name for name, _ in plan.objectives)} by Gaussian processes over {len(runs)} "
        f"runs ({designed} of the design, {len(runs) - designed} suggested or added).{_refuted_text(state)}"
    )
    expected = expected_at(state, (), chosen, runs)
    return _recommendation(state, chosen, expected, basis, is_feasible=outlook.best is not None)


def _best_point(state: StudyState) -> Recommendation:
    """Return the point whose objectives are best by the models, among those that were run and keep the constraints.

    With several objectives it is the one with the highest grey relational grade, which is a preference.
    """
    analysis, refuted, plan = analysis_of(state), broken_limits(state), state.plan
    names = [name for name, _ in plan.objectives] or ranked_by(plan)[:1]
    known = [one for one in analysis.choices if all(one.means.get(name) is not None for name in names)]
    if not known or not names:
        raise failures.no_point_with_values(names=", ".join(names))
    candidates = [one for one in known if settings_key(one.settings) not in refuted]
    if not candidates:
        raise _nothing_left(state, "recommend")
    limits = ", ".join(map(str, plan.constraints))
    feasible = [one for one in candidates if one.is_feasible]
    if not feasible:
        raise failures.no_point_known_to_keep(limits=limits)
    kept = f" and are known to keep {limits}" if limits else ""
    if len(names) > 1:
        best = max(feasible, key=lambda one: -math.inf if one.grey_grade is None else one.grey_grade)
        grade = "The point with the highest grey relational grade of those that were run"
        basis = f"{grade}{kept}: a preference by weights."
    else:
        info = plan.response(names[0])
        assert info is not None
        best = min(feasible, key=lambda one: cost_of(info, float(one.means[info.name] or 0.0)))
        basis = f"The point with the best mean of {info.name} among those that were run{kept}."
    expected = expected_at(state, analysis.responses, best.settings)
    basis += _refuted_text(state)
    if expected and is_one_machine(analysis.runs):
        basis += " The expected values are of the one machine of the study: others may differ by more."
    return _recommendation(state, best.settings, expected, basis, is_feasible=True)


def _refuted_text(state: StudyState) -> str:
    """Return the sentence, after others, of settings that are left out because confirmation has refuted them."""
    texts = ", ".join(dict.fromkeys(text for limits in broken_limits(state).values() for text in limits))
    return f" Settings whose confirmation did not keep {texts} are left out." if texts else ""


def _nothing_left(state: StudyState, purpose: str) -> PreconditionError:
    """Return the error of a study whose settings are all refuted."""
    remedy = "Plan a new study, with other levels or wider factors, or with another limit."
    if purpose == "recommend":
        remedy = f"`{state.folder.command('suggest')}` looks for settings that were not run. {remedy}"
    return failures.nothing_left_to_suggest(what=purpose, state=_refuted_text(state), remedy=remedy)


def _recommendation(
    state: StudyState,
    settings: Mapping[str, Value],
    expected: Mapping[str, Interval],
    basis: str,
    *,
    is_feasible: bool,
) -> Recommendation:
    if not expected:
        basis += " The runs do not show what to expect there."
    runs = fitting_runs(state)
    values = {name: values_of(runs, name) for name in expected}
    wide = [
        name
        for name, (_, low, high) in expected.items()
        if values[name] and high - low > max(values[name]) - min(values[name])
    ]
    if wide:
        basis += (
            f" The interval of {', '.join(wide)} is wider than all that was measured: replicates and more "
            "points would make it smaller."
        )
    means, lows, highs = ({name: interval[n] for name, interval in expected.items()} for n in range(3))
    limits = tuple(map(str, state.plan.constraints))
    return Recommendation(settings, means, lows, highs, is_feasible, basis, limits)


def next_batch(state: StudyState, surroundings: Surroundings = NONE) -> list[PlannedRun]:
    """Return the runs that come next in an optimisation; none when all of its runs are made.

    Raises PreconditionError E8216 where a suggested run waits for values measured by hand, and what `suggestions`
    raises.
    """
    optimize = state.folder.source.file.optimize
    if waiting := [run for run in _waiting(state) if run.planned.kind is RunKind.SUGGESTED]:
        number = waiting[0].planned.number
        names = [name for name in _by_hand(state) if waiting[0].value(name) is None]
        raise failures.suggested_run_not_measured(
            number=number,
            names=", ".join(names),
            command=state.folder.command("tell", str(number), f"{names[0]}=VALUE"),
            making_command=state.making_command("optimize"),
        )
    count = min(optimize.batch, optimize.runs - counted(state))
    return suggestions(state, count, surroundings) if count > 0 else []


def counted(state: StudyState) -> int:
    """Return how many runs count against the number in [optimize]: those of the design, and suggestions."""
    is_of_design = state.plan.is_of_design
    return sum(run.planned.kind is RunKind.SUGGESTED or is_of_design(run.planned) for run in state.runs)


def suggestions(state: StudyState, count: int, surroundings: Surroundings = NONE) -> list[PlannedRun]:
    """Return so many runs where objectives and constraints are expected to gain most, each checked as a job is.

    Each has a virtual machine of its own. Raises PreconditionError: E8209 there is nothing to optimise, E8210 too
    few runs have a response, E8211 the rules refuse whatever is suggested, E8217 confirmation has refuted all
    settings.
    """
    _, settings, fitted = _fitted(state)
    refuse_without_room(state, count)
    pending = [run for run in state.runs if run.state is RunState.OPEN] + _waiting(state)
    waiting = unit_points(state.plan.factors, [run.planned.settings for run in pending])
    for _ in range(MOST_REFUSED):
        numbers = fitted.suggest(unit_points(state.plan.factors, settings), count, waiting)
        chosen = [settings[number] for number in numbers]
        refused = [one for one in chosen if not _is_allowed(state, one, surroundings)]
        if not refused:
            return suggested_runs(state, chosen)
        settings = [one for one in settings if one not in refused]
        if not settings:
            break
    raise failures.suggestions_all_refused()


def _fitted(state: StudyState) -> tuple[list[StudyRun], list[dict[str, Value]], Surrogates]:
    """Return the runs that count, the candidates, and the processes fitted to the runs."""
    from edmctl.study.statistics.surrogates import Surrogates

    runs, objective, constraints = data_of(state)
    points = unit_points(state.plan.factors, [run.planned.settings for run in runs])
    fitted = Surrogates.fit(points, objective, constraints, [run.block for run in runs])
    return runs, _candidates(state, runs, objective), fitted


def data_of(state: StudyState) -> tuple[list[StudyRun], list[float], list[Constraint]]:
    """Return the runs that count, the objective to be minimised, and the constraints."""
    plan = state.plan
    if not plan.objectives:
        raise failures.study_without_objective()
    # Confirmation runs that broke a constraint confirm nothing any more, and count as others do.
    broken = broken_limits(state)
    disproving = [run for key, runs in confirmed_settings(state).items() if key in broken for run in runs]
    # A value that is still to be measured is unknown; only a run that failed shows where runs fail.
    runs = [
        run
        for run in (*fitting_runs(state), *disproving)
        if run.state is RunState.FAILED or all(run.value(name) is not None for name in _needed(plan))
    ]
    objective = _objective(plan, runs)
    known = sum(map(math.isfinite, objective))
    if known < LEAST_RUNS:
        remedy = f"Tell responses that are measured by hand: `{state.folder.command('tell')} RUN NAME=VALUE`."
        if any(run.state is RunState.OPEN for run in state.runs):
            remedy = f"Make the design's runs first: `{state.making_command('resume')}`."
        raise failures.too_few_runs_to_suggest(
            runs=plural(known, "run"), least_runs=LEAST_RUNS, remedy=remedy
        )
    constraints = []
    for bound in plan.constraints:
        info, values = plan.response(bound.response), [run.value(bound.response) for run in runs]
        is_log = info is not None and bound.limit > 0 and _is_log(info, values)
        limit = math.log(bound.limit) if is_log else bound.limit
        constraints.append(([bound.sign * value for value in _scaled(values, is_log)], bound.sign * limit))
    return runs, objective, constraints


def _needed(plan: StudyPlan) -> list[str]:
    return [*(name for name, _ in plan.objectives), *(bound.response for bound in plan.constraints)]


def _waiting(state: StudyState) -> list[StudyRun]:
    """Return the runs that were made and lack a value that is measured by hand."""
    return [
        run
        for run in fitting_runs(state)
        if run.state is RunState.DONE and any(run.value(name) is None for name in _by_hand(state))
    ]


def _by_hand(state: StudyState) -> list[str]:
    """Return the responses of objectives and constraints that are measured by hand."""
    manual = {one.name for one in state.plan.responses if one.is_manual}
    return [name for name in dict.fromkeys(_needed(state.plan)) if name in manual]


def _objective(plan: StudyPlan, runs: Sequence[StudyRun]) -> list[float]:
    """Return one cost a run, NaN if unknown: of several objectives the weighted sum of standardised ones."""
    import numpy as np

    columns = []
    for name, _ in plan.objectives:
        info, values = plan.response(name), [run.value(name) for run in runs]
        assert info is not None
        has_target = info.better == "nominal" and info.target is not None
        scaled = _scaled(values, not has_target and _is_log(info, values))
        columns.append([cost_of(info, value) for value in scaled])
    table = np.array(columns)
    if len(columns) > 1 and len(runs) > 1:
        spread = np.nanstd(table, axis=1, ddof=1, keepdims=True)
        table = (table - np.nanmean(table, axis=1, keepdims=True)) / np.where(spread > 0, spread, 1.0)
        table *= np.array([weight for _, weight in plan.objectives])[:, None]
    return [float(value) for value in table.sum(axis=0)]


def _is_log(info: ResponseInfo, values: Sequence[float | None]) -> bool:
    """Return whether a response is modelled as its logarithm, and all of its values have one."""
    known = [value for value in values if value is not None]
    return info.is_log and bool(known) and min(known) > 0


def _scaled(values: Sequence[float | None], is_log: bool) -> list[float]:
    return [math.nan if value is None else math.log(value) if is_log else value for value in values]


def _candidates(
    state: StudyState, runs: Sequence[StudyRun], objective: Sequence[float]
) -> list[dict[str, Value]]:
    """Return settings that may be suggested, but for those whose confirmation has broken a constraint.

    A Sobol sequence over the factors; ends and middles of the factors, where the best often is and no inner point
    reaches; the surroundings of the runs with the best objectives; and all that were run.
    """
    source = state.folder.source
    # Levels are categories here: nothing between them may be suggested.
    factors = [replace(of, is_number=of.is_number and of.is_range) for of in state.plan.factors]
    seed = source.file.design.seed
    rows = sobol_points(len(factors), CANDIDATES, seed).tolist() + _ends(factors)
    around = sobol_points(len(factors), AROUND, seed + 1).tolist()
    known = [n for n, value in enumerate(objective) if math.isfinite(value)]
    best = [runs[n].planned.settings for n in sorted(known, key=lambda n: objective[n])[:BEST]]
    for center in {settings_key(one): one for one in best}.values():
        at = [coded(of, center[of.key]) if of.is_number else None for of in factors]
        rows += [
            [x if c is None else min(max(c + NEAR * x, -1.0), 1.0) for c, x in zip(at, row, strict=True)]
            for row in around
        ]
    settings = [
        {of.key: value_at(of, x, source.steps[of.key]) for of, x in zip(factors, row, strict=True)}
        for row in rows
    ]
    settings += [
        dict(run.planned.settings) for run in state.runs if run.planned.kind is not RunKind.CONFIRMATION
    ]
    broken = broken_limits(state)
    found = {key: one for one in settings if (key := settings_key(one)) not in broken}
    if not found:
        raise _nothing_left(state, "suggest")
    return list(found.values())


def _ends(factors: Sequence[FactorInfo]) -> list[list[float]]:
    """Return coded points at all ends and middles of the factors, or at the ends alone; none if too many."""
    for levels in ([-1.0, 0.0, 1.0], [-1.0, 1.0]):
        values = []
        for factor in factors:
            count = len(factor.values)
            categories = [(2 * n + 1) / count - 1 for n in range(count)]
            values.append(levels if factor.is_number else categories)
        if math.prod(map(len, values)) <= CANDIDATES:
            return [list(row) for row in itertools.product(*values)]
    return []


def _is_allowed(state: StudyState, settings: Mapping[str, Value], surroundings: Surroundings) -> bool:
    try:
        check(request_of(state.folder.base, settings), surroundings)
    except ProfileError:
        return False
    return True
