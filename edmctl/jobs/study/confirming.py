"""Runs beyond the design: what is recommended, what to run next, and what confirmation came to.

Nothing is remembered but the rows: a suggestion follows from the study and the rows before it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from edmctl.errors import PreconditionError
from edmctl.jobs.study.analysis import analysis_of, cost_of, ranked_by
from edmctl.jobs.study.expectations import expected_at
from edmctl.results.study import (
    Confirmation,
    ConfirmedResponse,
    PlannedRun,
    Recommendation,
    RunKind,
    RunState,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from edmctl.doe.response_analysis import ResponseAnalysis
    from edmctl.jobs.study.folder import StudyState
    from edmctl.results.study import Choice, StudyPlan, StudyRun, Value

FRESH_SEEDS = 1_000_003
"""Machines of confirmation runs are so far from those of the design that no study's seeds come near."""


def confirmations_of(state: StudyState, analyses: Sequence[ResponseAnalysis]) -> list[Confirmation]:
    """Return what the confirmation runs that are done came to, by their settings."""
    by_settings: dict[str, list[StudyRun]] = {}
    for run in state.runs:
        if run.planned.kind is RunKind.CONFIRMATION and run.state is RunState.DONE:
            by_settings.setdefault(repr(sorted(run.planned.settings.items())), []).append(run)
    found = []
    for members in by_settings.values():
        expected = expected_at(state, analyses, members[0].planned.settings)
        responses = []
        for name in (one.name for one in state.folder.plan.responses):
            value, low, high = expected.get(name, (math.nan, math.nan, math.nan))
            measured = [v for run in members if (v := run.value(name)) is not None]
            if measured:
                responses.append(ConfirmedResponse(name, value, low, high, tuple(measured)))
        numbers = tuple(run.planned.number for run in members)
        limits = []
        for bound in state.folder.plan.constraints:
            known = [v for run in members if (v := run.value(bound.response)) is not None]
            if known:
                mean = math.fsum(known) / len(known)
                limits.append((str(bound), mean, bound.sign * (mean - bound.limit) <= 0))
        found.append(Confirmation(members[0].planned.settings, numbers, tuple(responses), tuple(limits)))
    return found


def confirmation_runs(state: StudyState, settings: Mapping[str, Value], runs: int) -> list[PlannedRun]:
    """Return new runs at settings, each on a machine of its own that the study has not seen."""
    first = max(run.planned.number for run in state.runs) + 1
    made = sum(run.planned.kind is RunKind.CONFIRMATION for run in state.runs)
    seed = state.folder.source.file.design.seed + FRESH_SEEDS + made
    return [
        _added(state, first + n, RunKind.CONFIRMATION, settings, seed + n, block=_next_block(state) + n)
        for n in range(runs)
    ]


def _next_block(state: StudyState) -> int:
    return max(run.planned.block for run in state.runs) + 1


def _added(
    state: StudyState, number: int, kind: RunKind, settings: Mapping[str, Value], seed: int, block: int
) -> PlannedRun:
    known = {repr(sorted(run.planned.settings.items())): run.planned.point for run in state.runs}
    new = max(run.planned.point for run in state.runs) + 1
    point = known.get(repr(sorted(settings.items())), new)
    machine = state.folder.source.file.machine
    tool = 0
    if machine is not None:
        made = [run.row.tool if run.row is not None else run.planned.tool for run in state.runs]
        tool = max(made)
        if machine.holes_per_tool is not None and made.count(tool) >= machine.holes_per_tool:
            tool += 1
        block = tool
    return PlannedRun(number, kind, point, 1, block, seed, dict(settings), tool)


def added_run(
    state: StudyState, number: int, settings: Mapping[str, Value], seed: int, block: int
) -> PlannedRun:
    """Return a run that was suggested."""
    return _added(state, number, RunKind.SUGGESTED, settings, seed, block)


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
    PreconditionError E8206 without runs, E8208 where no response can be judged.
    """
    analysis = analysis_of(state)
    plan = state.folder.plan
    names = [name for name, _ in plan.objectives] or ranked_by(plan)[:1]
    candidates = [one for one in analysis.choices if all(one.means.get(name) is not None for name in names)]
    if not candidates or not names:
        raise PreconditionError(
            f"No point has a value of {', '.join(names)}.",
            hint="Tell manual responses with `edmctl study tell`, or make the runs.",
            code="E8208",
        )
    feasible = [one for one in candidates if one.is_feasible]
    ranked = feasible or candidates
    if not feasible:
        best = min(candidates, key=lambda one: violation(plan, one))
        basis = "No point that was run is known to keep every constraint; this one comes nearest."
    elif len(names) == 1:
        info = next(one for one in plan.responses if one.name == names[0])
        best = min(ranked, key=lambda one: cost_of(info, float(one.means[names[0]] or 0.0)))
        basis = f"The point with the best mean of {names[0]} among those that were run."
    else:
        best = max(ranked, key=lambda one: one.grey_grade if one.grey_grade is not None else -math.inf)
        basis = "The point with the highest grey relational grade of those that were run: a preference by weights."
    if (
        len({run.planned.seed for run in analysis.runs}) == 1
        and len({run.planned.tool for run in analysis.runs}) == 1
    ):
        basis += " What is expected is of runs on the one machine of the study: others may differ by more."
    expected = expected_at(state, analysis.responses, best.settings)
    return Recommendation(
        settings=best.settings,
        expected={name: value for name, (value, _, _) in expected.items()},
        low={name: low for name, (_, low, _) in expected.items()},
        high={name: high for name, (_, _, high) in expected.items()},
        is_feasible=best.is_feasible,
        basis=basis,
        constraints=tuple(map(str, plan.constraints)),
    )
