"""Runs beyond the design: suggestions, confirmation runs, replicates, and what is recommended.

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
    wide_intervals,
)
from edmctl.study.design import coded, settings_key, unit_points, value_at
from edmctl.study.folder import StudyState
from edmctl.study.planning import grid_of, request_of
from edmctl.study.results import (
    Choice,
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

MOST_NAMED = 5
FRESH_SEEDS = 1_000_003
"""From the seeds of the design to those of confirmation runs: beyond any number of runs."""
CANDIDATES = 1024
AROUND, BEST, NEAR = 64, 4, 0.15
"""Candidates about each of the runs with the best objectives, within this share of half a factor's range."""
MOST_REFUSED = 200


def confirmations_of(state: StudyState) -> list[Confirmation]:
    """Return the results of confirmation runs, by their settings and what was expected of them then.

    Limits are of all runs at the settings.
    """
    found = []
    for there in confirmed_settings(state).values():
        limits = limits_of(state.plan, there)
        groups: list[tuple[Mapping[str, Interval], list[StudyRun]]] = []
        for run in there:
            expected = state.rows.expected.get(run.planned.number, {})
            members = next((runs for other, runs in groups if other == expected), None)
            if members is None:
                groups.append((expected, members := []))
            members.append(run)
        for expected, members in groups:
            responses = [
                ConfirmedResponse(one.name, *expected.get(one.name, (math.nan,) * 3), tuple(measured))
                for one in state.plan.responses
                if (measured := values_of(members, one.name))
            ]
            numbers = tuple(run.planned.number for run in members)
            found.append(Confirmation(there[0].planned.settings, numbers, tuple(responses), limits))
    return found


def confirmation_runs(state: StudyState, settings: Mapping[str, Value], runs: int) -> list[PlannedRun]:
    """Return new runs at settings, each on a machine of its own that the study has not used.

    Raises PreconditionError E8207 where a machine that lasts has no place for them.
    """
    refuse_without_room(state, runs)
    made = sum(run.planned.kind is RunKind.CONFIRMATION for run in state.runs)
    seed = state.folder.source.file.design.seed + FRESH_SEEDS + made
    return _added(state, RunKind.CONFIRMATION, [settings] * runs, seed)


def refuse_without_room(state: StudyState, count: int) -> None:
    """Raise PreconditionError E8207 where the grid of a machine has no place for more runs."""
    machine = state.folder.source.file.machine
    if machine is None or not state.rows.port:
        return
    taken = sum(map(len, state.rows.attempts.values()))
    left = sum(run.state is RunState.OPEN for run in state.runs)
    free = len(grid_of(machine)) - taken - left
    if free < count:
        raise failures.grid_too_small(places=plural(max(0, free), "place"), runs=plural(count, "more run"))


def suggested_runs(state: StudyState, settings: Sequence[Mapping[str, Value]]) -> list[PlannedRun]:
    """Return new runs, one at each of `settings`, on machines after the machines of the design."""
    return _added(state, RunKind.SUGGESTED, settings, _next_seed(state))


def _next_seed(state: StudyState) -> int:
    return 1 + max(run.planned.seed for run in state.runs if run.planned.kind is not RunKind.CONFIRMATION)


def extension_runs(
    state: StudyState, surroundings: Surroundings = NONE, *, is_folded: bool = False
) -> list[PlannedRun]:
    """Return the runs of one more replicate of the design, or of its fold-over, in blocks of their own.

    Each machine (seed), block and tool of the first replicate becomes a new one; design runs are shuffled in each
    block. A fold-over takes the other of the two levels of every factor. Raises UsageError E2114 if the design does
    not have two levels of a factor, ProfileError if the rules refuse a recipe, PreconditionError E8207 if the grid
    has no room.
    """
    plan, file = state.plan, state.folder.source.file
    first = [run for run in plan.runs if run.replicate == 1]
    refuse_without_room(state, len(first))
    replicate = max(plan.replicates, *(run.planned.replicate for run in state.runs)) + 1
    runs = _shuffled(first, [file.design.seed, replicate]) if file.design.order == "random" else first
    points = {settings_key(run.planned.settings): run.planned.point for run in state.runs}
    last = max(run.planned.number for run in state.runs)
    seeds = _renumbered((run.seed for run in first), _next_seed(state))
    blocks = _renumbered((run.block for run in first), max(run.planned.block for run in state.runs) + 1)
    tools = _renumbered((run.tool for run in first), max(run.tool for run in state.runs) + 1)
    are_blocks = file.machine is not None and file.machine.holes_per_tool is not None
    levels = {
        one.key: {run.settings[one.key] for run in first if run.kind is RunKind.DESIGN}
        for one in plan.factors
    }
    found = []
    for number, run in enumerate(runs, last + 1):
        settings, point = run.settings, run.point
        if is_folded and run.kind is RunKind.DESIGN:
            settings = {one.key: _other_level(one, run, levels[one.key]) for one in plan.factors}
            check(request_of(state.folder.base, settings), surroundings)
            point = points.setdefault(settings_key(settings), max(points.values()) + 1)
        tool = tools[run.tool] if are_blocks else run.tool
        block = tool if are_blocks else blocks[run.block]
        found.append(PlannedRun(number, run.kind, point, replicate, block, seeds[run.seed], settings, tool))
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


def _other_level(factor: FactorInfo, run: PlannedRun, levels: set[Value]) -> Value:
    if len(levels) != 2:
        raise failures.fold_over_needs_two_levels(levels_count=len(levels), factor=factor.name)
    return next(level for level in levels if level != run.settings[factor.key])


def opening_run(state: StudyState, tool: int) -> PlannedRun:
    """Return a new centre run that a tool begins with."""
    center = next(run.planned for run in state.runs if run.planned.kind is RunKind.CENTER)
    (run,) = _added(state, RunKind.CENTER, [center.settings], center.seed)
    return replace(run, block=tool, tool=tool)


def _added(
    state: StudyState, kind: RunKind, settings: Sequence[Mapping[str, Value]], first_seed: int
) -> list[PlannedRun]:
    """Number runs on from those that are there: each a block of its own, or of the tool with holes left.

    Where centre runs open and close the holes of a tool, those of suggestions are among them.
    """
    machine = state.folder.source.file.machine
    holes = machine.holes_per_tool if machine is not None else None
    points = {settings_key(run.planned.settings): run.planned.point for run in state.runs}
    last = max(run.planned.number for run in state.runs)
    block = max(run.planned.block for run in state.runs)
    tools = [run.tool for run in state.runs]
    found: list[PlannedRun] = []

    def add(kind: RunKind, one: Mapping[str, Value]) -> None:
        point = points.setdefault(settings_key(one), max(points.values()) + 1)
        tool = max(tools) + (holes is not None and tools.count(max(tools)) >= holes) if machine else 0
        tools.append(tool)
        own, seed = tool if machine else block + len(found) + 1, first_seed + len(found)
        found.append(PlannedRun(last + len(found) + 1, kind, point, 1, own, seed, dict(one), tool))

    center = next((run.planned.settings for run in state.runs if run.planned.kind is RunKind.CENTER), None)
    if kind is not RunKind.SUGGESTED or machine is None or not machine.center_runs:
        center = None
    for one in settings:
        if center is not None and holes is not None:
            if tools.count(max(tools)) == holes - 1:
                add(RunKind.CENTER, center)  # the last hole of this tool
            if tools.count(max(tools)) >= holes:
                add(RunKind.CENTER, center)  # the first one of the next
        add(kind, one)
    return found


def violation(plan: StudyPlan, choice: Choice) -> float:
    """Return by how much a point misses its worst constraint, as a share of the limit; by means without bounds."""
    worst = 0.0
    for bound in plan.constraints:
        value = choice.upper.get(str(bound))
        if value is None:
            value = choice.means.get(bound.response)
        if value is None:
            return math.inf
        worst = max(worst, bound.excess(value) / (abs(bound.limit) or 1.0))
    return worst


def best_of_points(state: StudyState) -> Recommendation:
    """Return the point whose objectives are best by the models, among those that were run and keep the constraints.

    With several objectives it is the one with the highest grey relational grade, which is a preference. Raises
    PreconditionError E8206 without runs, E8208 where no response can be judged, E8217 where confirmation has refuted
    all of them.
    """
    analysis, refuted, plan = analysis_of(state), broken_limits(state), state.plan
    names = [name for name, _ in plan.objectives] or ranked_by(plan)[:1]
    candidates = [one for one in analysis.choices if all(one.means.get(name) is not None for name in names)]
    if not candidates or not names:
        raise failures.no_point_with_values(names=", ".join(names))
    candidates = [one for one in candidates if settings_key(one.settings) not in refuted]
    if not candidates:
        raise nothing_left(state, "recommend")
    best, basis = _best_of(plan, candidates, names)
    expected = expected_at(state, analysis.responses, best.settings)
    basis += refuted_words(state)
    if expected and is_one_machine(analysis.runs):
        basis += " What is expected is of runs on the one machine of the study: others may differ by more."
    return recommendation(state, best.settings, expected, basis, is_feasible=best.is_feasible)


def _best_of(plan: StudyPlan, candidates: Sequence[Choice], names: Sequence[str]) -> tuple[Choice, str]:
    """Return the best of some points by responses, and why it is that."""
    feasible = [one for one in candidates if one.is_feasible]
    limits = ", ".join(map(str, plan.constraints))
    if not feasible:
        best = min(candidates, key=lambda one: violation(plan, one))
        if not math.isfinite(violation(plan, best)):
            raise failures.no_point_known_to_keep(limits=limits)
        return best, "No point that was run is known to keep every constraint; this one comes nearest."
    kept = f" and are known to keep {limits}" if limits else ""
    if len(names) > 1:
        best = max(feasible, key=lambda one: one.grey_grade if one.grey_grade is not None else -math.inf)
        grade = "The point with the highest grey relational grade of those that were run"
        return best, f"{grade}{kept}: a preference by weights."
    info = plan.response(names[0])
    assert info is not None

    def cost(one: Choice) -> float:
        return cost_of(info, float(one.means[names[0]] or 0.0))

    best = min(feasible, key=cost)
    basis = f"The point with the best mean of {names[0]} among those that were run{kept}."
    better = [one for one in candidates if cost(one) < cost(best) and _may_keep(plan, one)]
    if better:
        points = ", ".join(str(one.point) for one in sorted(better, key=cost)[:MOST_NAMED])
        basis += f" Points with a better mean that keep it by their mean alone: {points}. Add runs there."
    return best, basis


def _may_keep(plan: StudyPlan, choice: Choice) -> bool:
    """Whether no mean of a point breaks a constraint; a response without a mean breaks none."""
    means = ((bound, choice.means.get(bound.response)) for bound in plan.constraints)
    return all(mean is None or bound.excess(mean) <= 0.0 for bound, mean in means)


def refuted_words(state: StudyState) -> str:
    """Return the sentence, after others, of settings that are left out because confirmation has refuted them."""
    texts = ", ".join(dict.fromkeys(text for limits in broken_limits(state).values() for text in limits))
    return f" Settings whose confirmation did not keep {texts} are left out." if texts else ""


def nothing_left(state: StudyState, what: str) -> PreconditionError:
    """Return the error of a study whose settings are all refuted: none is left to recommend, or to suggest."""
    hint = "Ask a new study, with other levels or wider factors, or with another limit."
    if what == "recommend":
        hint = (
            f"`{state.folder.command('suggest')}` looks for settings that were not run; without any, "
            f"{hint[0].lower()}{hint[1:]}"
        )
    return failures.nothing_left_to_suggest(what=what, state=refuted_words(state), remedy=hint)


def recommendation(
    state: StudyState,
    settings: Mapping[str, Value],
    expected: Mapping[str, Interval],
    basis: str,
    *,
    is_feasible: bool,
) -> Recommendation:
    """Return settings that are recommended with what `expected_at` says of them."""
    if not expected:
        basis += " The runs do not tell what is to be expected there."
    if wide := wide_intervals(state, expected):
        basis += (
            f" The interval of {', '.join(wide)} is wider than all that was measured: the runs tell little of what "
            "a new one will do; replicates and more points would."
        )
    values, lows, highs = ({name: one[n] for name, one in expected.items()} for n in range(3))
    limits = tuple(map(str, state.plan.constraints))
    return Recommendation(settings, values, lows, highs, is_feasible, basis, limits)


def next_batch(state: StudyState, surroundings: Surroundings = NONE) -> list[PlannedRun]:
    """Return the runs that come next in an optimisation; none when all of its runs are made.

    Raises PreconditionError E8216 where a suggested run waits for values that people measure, and what
    `suggestions` raises.
    """
    optimize = state.folder.source.file.optimize
    if waiting := [run for run in _untold(state) if run.planned.kind is RunKind.SUGGESTED]:
        number = waiting[0].planned.number
        names = [name for name in _by_hand(state) if waiting[0].value(name) is None]
        raise failures.suggested_run_not_measured(
            number=number,
            names=", ".join(names),
            command=state.folder.command("tell", str(number), f"{names[0]}=VALUE"),
            making_command=state.making_command("optimize"),
        )
    left = min(optimize.batch, optimize.runs - counted(state))
    return suggestions(state, left, surroundings) if left > 0 else []


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
    plan = state.plan
    runs, objective, constraints = _data(state)
    settings = _candidates(state, runs, objective)
    pending = [run for run in state.runs if run.state is RunState.OPEN] + _untold(state)
    refuse_without_room(state, count)
    budget = max(state.folder.source.file.optimize.runs, len(runs) + count)
    waiting = unit_points(plan.factors, [run.planned.settings for run in pending])
    fitted = _fitted(plan, runs, objective, constraints)
    for _ in range(MOST_REFUSED):
        found = fitted.suggest(unit_points(plan.factors, settings), count, waiting, budget)
        chosen = [settings[candidate] for candidate, _ in found]
        refused = [one for one in chosen if not _is_allowed(state, one, surroundings)]
        if not refused:
            return suggested_runs(state, chosen)
        settings = [one for one in settings if one not in refused]
        if not settings:
            break
    raise failures.suggestions_all_refused()


def recommended(state: StudyState, surroundings: Surroundings = NONE) -> Recommendation:
    """Return the settings that are expected best and keep every constraint by its 95 % bound.

    Without suggestions it is one of the points that were run. Raises what `suggestions` and `best_of_points` raise.
    """
    if not has_suggestions(state):
        return best_of_points(state)
    plan = state.plan
    runs, objective, constraints = _data(state)
    settings = _candidates(state, runs, objective)
    fitted = _fitted(plan, runs, objective, constraints)
    while True:
        outlook = fitted.outlook(unit_points(plan.factors, settings))
        chosen = settings[outlook.nearest]
        if _is_allowed(state, chosen, surroundings) or len(settings) == 1:
            break
        settings = [one for one in settings if one is not chosen]
    names = ", ".join(name for name, _ in plan.objectives)
    designed = sum(plan.is_of_design(run.planned) for run in runs)
    basis = (
        f"Best expected {names} by Gaussian processes over {len(runs)} runs ({designed} of the design, "
        f"{len(runs) - designed} suggested or added).{refuted_words(state)}"
    )
    expected = expected_at(state, (), chosen, runs)
    return recommendation(state, chosen, expected, basis, is_feasible=outlook.best is not None)


def _fitted(
    plan: StudyPlan,
    runs: Sequence[StudyRun],
    objective: Sequence[float],
    constraints: Sequence[tuple[list[float], float]],
) -> Surrogates:
    from edmctl.study.statistics.surrogates import Surrogates

    points = unit_points(plan.factors, [run.planned.settings for run in runs])
    return Surrogates.fit(points, objective, constraints, [run.block for run in runs])


def _data(state: StudyState) -> tuple[list[StudyRun], list[float], list[tuple[list[float], float]]]:
    """The runs, the objective to be minimised, and each constraint's values with the limit they shall not exceed."""
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
        if run.state is RunState.FAILED or all(run.value(name) is not None for name in _wanted(plan))
    ]
    objective = _objective(plan, runs)
    known = sum(math.isfinite(value) for value in objective)
    if known < LEAST_RUNS:
        raise failures.too_few_runs_to_suggest(
            runs=plural(known, "run"),
            least_runs=LEAST_RUNS,
            remedy=f"Make the design's runs first: `{state.making_command('resume')}`."
            if any(run.state is RunState.OPEN for run in state.runs)
            else f"Tell responses that are measured by hand: `{state.folder.command('tell')} RUN NAME=VALUE`.",
        )
    constraints = []
    for bound in plan.constraints:
        values = [run.value(bound.response) for run in runs]
        is_log = bound.limit > 0 and _is_log(plan.response(bound.response), values)
        scaled = [math.nan if value is None else bound.sign * _scaled(value, is_log) for value in values]
        constraints.append((scaled, bound.sign * _scaled(bound.limit, is_log)))
    return runs, objective, constraints


def _wanted(plan: StudyPlan) -> list[str]:
    return [*(name for name, _ in plan.objectives), *(bound.response for bound in plan.constraints)]


def _untold(state: StudyState) -> list[StudyRun]:
    """Runs that were made and lack a value that people measure."""
    return [
        run
        for run in fitting_runs(state)
        if run.state is RunState.DONE and any(run.value(name) is None for name in _by_hand(state))
    ]


def _by_hand(state: StudyState) -> list[str]:
    """Names of the responses that a suggestion is about and people measure."""
    manual = {one.name for one in state.plan.responses if one.is_manual}
    return [name for name in dict.fromkeys(_wanted(state.plan)) if name in manual]


def _objective(plan: StudyPlan, runs: Sequence[StudyRun]) -> list[float]:
    """One cost a run, NaN where it is unknown: of several objectives the weighted sum of standardised ones."""
    columns = []
    for name, _ in plan.objectives:
        info, values = plan.response(name), [run.value(name) for run in runs]
        assert info is not None
        has_target = info.better == "nominal" and info.target is not None
        is_log = not has_target and _is_log(info, values)
        columns.append([math.nan if v is None else cost_of(info, _scaled(v, is_log)) for v in values])
    if len(columns) == 1:
        return columns[0]
    whole = [0.0] * len(runs)
    for column, (_, weight) in zip(columns, plan.objectives, strict=True):
        known = [value for value in column if math.isfinite(value)]
        mean = math.fsum(known) / max(1, len(known))
        sd = math.sqrt(math.fsum((value - mean) ** 2 for value in known) / max(1, len(known) - 1)) or 1.0
        whole = [total + weight * (value - mean) / sd for total, value in zip(whole, column, strict=True)]
    return whole


def _is_log(info: ResponseInfo | None, values: Sequence[float | None]) -> bool:
    """Whether a response is modelled as its logarithm, and all of its values have one."""
    known = [value for value in values if value is not None]
    return info is not None and info.is_log and bool(known) and min(known) > 0


def _scaled(value: float, is_log: bool) -> float:
    return math.log(value) if is_log else value


def _candidates(
    state: StudyState, runs: Sequence[StudyRun], objective: Sequence[float]
) -> list[dict[str, Value]]:
    """Settings that may be suggested, but for those whose confirmation has broken a constraint.

    A Sobol sequence over the factors; ends and middles of the factors, where the best often is and no inner point
    reaches; the surroundings of the runs with the best objectives; and all that were run.
    """
    source, plan = state.folder.source, state.plan
    seed, steps = source.file.design.seed, source.steps
    ranges = [
        replace(factor, is_number=False) if factor.is_number and not factor.is_range else factor
        for factor in plan.factors
    ]
    rows = sobol_points(len(ranges), CANDIDATES, seed).tolist() + _ends(ranges)
    around = sobol_points(len(ranges), AROUND, seed + 1).tolist()
    known = [n for n, value in enumerate(objective) if math.isfinite(value)]
    best = [runs[n].planned.settings for n in sorted(known, key=lambda n: objective[n])[:BEST]]
    for centre in {settings_key(one): one for one in best}.values():
        here = [coded(f, centre[f.key]) if f.is_number else None for f in ranges]
        rows += [
            [x if at is None else at + NEAR * x for at, x in zip(here, row, strict=True)] for row in around
        ]
    found: dict[str, dict[str, Value]] = {}
    for row in rows:
        places = zip(ranges, row, strict=True)
        one = {f.key: value_at(f, min(max(x, -1.0), 1.0), steps[f.key]) for f, x in places}
        found[settings_key(one)] = one
    for run in state.runs:
        if run.planned.kind is not RunKind.CONFIRMATION:
            found[settings_key(run.planned.settings)] = dict(run.planned.settings)
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
