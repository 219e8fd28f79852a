"""Runs beyond the design: what is recommended, what to run next, and what confirmation came to.

Nothing is remembered but the rows: a suggestion follows from the study and the rows before it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from edmctl.errors import PreconditionError, UsageError
from edmctl.jobs.plan import check
from edmctl.jobs.surroundings import NONE, Surroundings
from edmctl.study.analysis import (
    analysis_of,
    broken_limits,
    confirmed_settings,
    cost_of,
    is_one_machine,
    limits_of,
    ranked_by,
)
from edmctl.study.expectations import expected_at, tells_little
from edmctl.study.factors import settings_key
from edmctl.study.places_and_tools import grid_of
from edmctl.study.planning import request_of
from edmctl.study.results import (
    Choice,
    Confirmation,
    ConfirmedResponse,
    FactorInfo,
    PlannedRun,
    Recommendation,
    RunKind,
    RunState,
    StudyPlan,
    Value,
)
from edmctl.wording import plural

if TYPE_CHECKING:
    from numpy.random import Generator

    from edmctl.study.folder import StudyState

MOST_NAMED = 5
FRESH_SEEDS = 1_000_003
"""Machines of confirmation runs are so far from those of the design that no study's seeds come near."""


def confirmations_of(state: StudyState) -> list[Confirmation]:
    """Return what the confirmation runs that are done came to, by their settings and what was expected of them then.

    Limits are of all runs at the settings.
    """
    found = []
    for there in confirmed_settings(state).values():
        settings, limits = there[0].planned.settings, limits_of(state.folder.plan, there)
        kept = [state.rows.expected.get(run.planned.number) for run in there]
        for expected in [one for n, one in enumerate(kept) if one not in kept[:n]]:
            members = [run for run, own in zip(there, kept, strict=True) if own == expected]
            numbers = tuple(run.planned.number for run in members)
            of_then = expected or {}
            responses = []
            for name in (one.name for one in state.folder.plan.responses):
                measured = tuple(value for run in members if (value := run.value(name)) is not None)
                if measured:
                    interval = of_then.get(name, (math.nan, math.nan, math.nan))
                    responses.append(ConfirmedResponse(name, *interval, measured))
            found.append(Confirmation(settings, numbers, tuple(responses), limits))
    return found


def confirmation_runs(state: StudyState, settings: Mapping[str, Value], runs: int) -> list[PlannedRun]:
    """Return new runs at settings, each on a machine of its own that the study has not seen.

    Raises PreconditionError E8207 where a machine that lasts has no place for them.
    """
    refuse_without_room(state, runs)
    made = sum(run.planned.kind is RunKind.CONFIRMATION for run in state.runs)
    seed = state.folder.source.file.design.seed + FRESH_SEEDS + made
    return _added(state, RunKind.CONFIRMATION, [settings] * runs, seed)


def refuse_without_room(state: StudyState, count: int) -> None:
    """Raise PreconditionError E8207 where so many more runs have no place on the grid of a machine."""
    machine = state.folder.source.file.machine
    if machine is None or not state.rows.port:
        return
    taken = sum(map(len, state.rows.attempts.values()))
    left = sum(run.state is RunState.OPEN for run in state.runs)
    free = len(grid_of(machine)) - taken - left
    if free < count:
        raise PreconditionError(
            f"The study's grid has {plural(max(0, free), 'place')} left beside those of the runs to make, and "
            f"{plural(count, 'more run')} need one each.",
            hint="Add fewer runs; a study on new work is another one, in another folder.",
            code="E8207",
        )


def suggested_runs(state: StudyState, settings: Sequence[Mapping[str, Value]]) -> list[PlannedRun]:
    """Return new runs, one at each of `settings`, on machines that come after those of the design."""
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
    import numpy as np

    plan, file = state.folder.plan, state.folder.source.file
    first = [run for run in plan.runs if run.replicate == 1]
    refuse_without_room(state, len(first))
    replicate = max(plan.replicates, *(run.planned.replicate for run in state.runs)) + 1
    runs = (
        _shuffled(first, np.random.default_rng([file.design.seed, replicate]))
        if file.design.order == "random"
        else first
    )
    points = {settings_key(run.planned.settings): run.planned.point for run in state.runs}
    last = max(run.planned.number for run in state.runs)
    seeds = _renumbered((run.seed for run in first), _next_seed(state))
    blocks = _renumbered((run.block for run in first), max(run.planned.block for run in state.runs) + 1)
    tools = _renumbered((run.tool for run in first), max(run.tool for run in state.runs) + 1)
    are_blocks = file.machine is not None and file.machine.holes_per_tool is not None
    design = [run for run in first if run.kind is RunKind.DESIGN]
    found = []
    for number, run in enumerate(runs, last + 1):
        settings, point = run.settings, run.point
        if is_folded and run.kind is RunKind.DESIGN:
            settings = {one.key: _other_level(one, settings[one.key], design) for one in plan.factors}
            check(request_of(state.folder.base, settings), surroundings)
            point = points.setdefault(settings_key(settings), max(points.values()) + 1)
        tool = tools[run.tool] if are_blocks else run.tool
        block = tool if are_blocks else blocks[run.block]
        found.append(PlannedRun(number, run.kind, point, replicate, block, seeds[run.seed], settings, tool))
    return found


def _shuffled(runs: Sequence[PlannedRun], rng: Generator) -> list[PlannedRun]:
    """Return runs with the settings of the design runs shuffled in each block; centre runs keep their places."""
    found = list(runs)
    for block in dict.fromkeys(run.block for run in runs):
        places = [n for n, run in enumerate(runs) if run.block == block and run.kind is RunKind.DESIGN]
        for place, other in zip(places, rng.permutation(places).tolist(), strict=True):
            found[place] = replace(runs[place], settings=runs[other].settings, point=runs[other].point)
    return found


def _renumbered(numbers: Iterable[int], first: int) -> dict[int, int]:
    return {number: first + n for n, number in enumerate(dict.fromkeys(numbers))}


def _other_level(factor: FactorInfo, value: Value, design: Iterable[PlannedRun]) -> Value:
    levels = {run.settings[factor.key] for run in design}
    if len(levels) != 2:
        raise UsageError(
            f"A fold-over exchanges two levels of every factor; the design has {len(levels)} of {factor.name}.",
            hint="Add a replicate instead: leave out --fold-over.",
            code="E2114",
        )
    return next(level for level in levels if level != value)


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
    has_centers = (
        kind is RunKind.SUGGESTED and holes is not None and machine is not None and machine.center_runs
    )
    for one in settings:
        if has_centers and center is not None and holes is not None:
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
        worst = max(worst, bound.sign * (value - bound.limit) / (abs(bound.limit) or 1.0))
    return worst


def best_of_points(state: StudyState) -> Recommendation:
    """Return the point whose objectives are best by the models, among those that were run and keep the constraints.

    With several objectives it is the one with the highest grey relational grade, which is a preference. Raises
    PreconditionError E8206 without runs, E8208 where no response can be judged, E8217 where confirmation has refuted
    all of them.
    """
    analysis, refuted = analysis_of(state), broken_limits(state)
    plan = state.folder.plan
    names = [name for name, _ in plan.objectives] or ranked_by(plan)[:1]
    candidates = [one for one in analysis.choices if all(one.means.get(name) is not None for name in names)]
    if not candidates or not names:
        raise PreconditionError(
            f"No point has a value of {', '.join(names)}.",
            hint="Tell manual responses with `edmctl study tell`, or make the runs.",
            code="E8208",
        )
    candidates = [one for one in candidates if settings_key(one.settings) not in refuted]
    if not candidates:
        raise nothing_left(state, "recommend")
    feasible = [one for one in candidates if one.is_feasible]
    ranked = feasible or candidates
    if not feasible:
        best = min(candidates, key=lambda one: violation(plan, one))
        if not math.isfinite(violation(plan, best)):
            raise PreconditionError(
                f"No point is known to keep {', '.join(map(str, plan.constraints))}, or by how much it does not.",
                hint="Tell manual responses with `edmctl study tell`, or make the runs.",
                code="E8208",
            )
        basis = "No point that was run is known to keep every constraint; this one comes nearest."
    elif len(names) == 1:
        info = next(one for one in plan.responses if one.name == names[0])

        def cost(one: Choice) -> float:
            return cost_of(info, float(one.means[names[0]] or 0.0))

        best = min(ranked, key=cost)
        basis = f"The point with the best mean of {names[0]} among those that were run{_known_to_keep(plan)}."
        better = [one for one in candidates if cost(one) < cost(best) and _may_keep(plan, one)]
        if better:
            points = ", ".join(str(one.point) for one in sorted(better, key=cost)[:MOST_NAMED])
            basis += f" Points with a better mean that keep it by their mean alone: {points}. Add runs there."
    else:
        best = max(ranked, key=lambda one: one.grey_grade if one.grey_grade is not None else -math.inf)
        basis = (
            f"The point with the highest grey relational grade of those that were run{_known_to_keep(plan)}: a "
            "preference by weights."
        )
    basis += refuted_words(state)
    expected = expected_at(state, analysis.responses, best.settings)
    if expected and is_one_machine(analysis.runs):
        basis += " What is expected is of runs on the one machine of the study: others may differ by more."
    return recommendation(state, best.settings, expected, basis, is_feasible=best.is_feasible)


def _may_keep(plan: StudyPlan, choice: Choice) -> bool:
    """Whether no mean of a point breaks a constraint; a response without a mean breaks none."""
    means = ((bound, choice.means.get(bound.response)) for bound in plan.constraints)
    return all(mean is None or bound.sign * (mean - bound.limit) <= 0.0 for bound, mean in means)


def _known_to_keep(plan: StudyPlan) -> str:
    texts = ", ".join(map(str, plan.constraints))
    return f" and are known to keep {texts}" if texts else ""


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
    return PreconditionError(f"Nothing is left to {what}.{refuted_words(state)}", hint=hint, code="E8217")


def recommendation(
    state: StudyState,
    settings: Mapping[str, Value],
    expected: Mapping[str, tuple[float, float, float]],
    basis: str,
    *,
    is_feasible: bool,
) -> Recommendation:
    """Return settings that are recommended with what `expected_at` says of them."""
    if not expected:
        basis += " The runs do not tell what is to be expected there."
    if wide := tells_little(state, expected):
        basis += (
            f" The interval of {', '.join(wide)} is wider than all that was measured: the runs tell little of what "
            "a new one will do; replicates and more points would."
        )
    return Recommendation(
        settings=settings,
        expected={name: value for name, (value, _, _) in expected.items()},
        low={name: low for name, (_, low, _) in expected.items()},
        high={name: high for name, (_, _, high) in expected.items()},
        is_feasible=is_feasible,
        basis=basis,
        constraints=tuple(map(str, state.folder.plan.constraints)),
    )
