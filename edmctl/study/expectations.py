"""What is expected of a run at given settings, by the models of the analysis or by Gaussian processes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from edmctl.quantity import half_width
from edmctl.study.design import AS_LEVELS
from edmctl.study.factors import settings_key, settings_matrix, unit_points
from edmctl.study.responses import range_of
from edmctl.study.results import RunKind, RunState, StudyPlan, StudyRun, Value

if TYPE_CHECKING:
    from edmctl.study.folder import StudyState
    from edmctl.study.statistics.gaussian_process import GaussianProcess
    from edmctl.study.statistics.response_analysis import ResponseAnalysis, ResponseModel
    from edmctl.study.study_file import Response

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


def expected_at(
    state: StudyState,
    analyses: Sequence[ResponseAnalysis],
    settings: Mapping[str, Value],
    runs: Sequence[StudyRun] | None = None,
) -> dict[str, tuple[float, float, float]]:
    """Return, by response, what is expected of a run and the bounds of its 95 % interval; none without a model.

    After suggestions, which crowd where it is good, Gaussian processes tell; else the runs that were made at these
    settings, or the models of the analysis. What cannot be is cut off: a share below zero, or what a manual response
    cannot be told. `runs` are those that processes learn from; without, all that count.
    """
    if has_suggestions(state):
        found = _by_processes(state, settings, fitting_runs(state) if runs is None else runs)
    else:
        done = [run for run in fitting_runs(state) if run.state is RunState.DONE]
        found = {
            one.name: expected for one in analyses if (expected := _by_analysis(state, one, done, settings))
        }
    asked = {one.name: one for one in state.folder.source.file.responses}
    return {name: _possible(asked[name], values) for name, values in found.items()}


def _by_analysis(
    state: StudyState,
    analysis: ResponseAnalysis,
    runs: Sequence[StudyRun],
    settings: Mapping[str, Value],
) -> tuple[float, float, float] | None:
    """What runs at these settings say, where they were repeated; else the model, if it knows their levels."""
    key, points = settings_key(settings), len({run.planned.point for run in runs})
    own = [
        analysis.without_block(value, run.block)
        for run in runs
        if settings_key(run.planned.settings) == key and (value := run.value(analysis.name)) is not None
    ]
    return analysis.at_point(own, points) or (
        predicted(state.folder.plan, analysis.model, settings) if analysis.model is not None else None
    )


def _possible(response: Response, values: tuple[float, float, float]) -> tuple[float, float, float]:
    least, most = range_of(response.name)
    least = least if response.low is None else response.low
    most = most if response.high is None else response.high
    value, low, high = (min(max(one, least), most) for one in values)
    return value, low, high


def tells_little(state: StudyState, expected: Mapping[str, tuple[float, float, float]]) -> list[str]:
    """Return the responses whose interval is wider than all that was measured of them."""
    found = []
    for name, (_, low, high) in expected.items():
        values = [value for run in fitting_runs(state) if (value := run.value(name)) is not None]
        if values and high - low > max(values) - min(values):
            found.append(name)
    return found


def predicted(
    plan: StudyPlan, model: ResponseModel, settings: Mapping[str, Value]
) -> tuple[float, float, float] | None:
    """Return what a model of the analysis expects of a run at settings, and the bounds of its 95 % interval.

    None where the model has seen no run at one of the levels.
    """
    matrix = settings_matrix(plan.factors, [settings], as_levels=plan.model in AS_LEVELS)
    if any(name not in model.names[factor] for factor, of in matrix.categories.items() for name in of):
        return None
    value, low, high = (float(one[0]) for one in model.predict(matrix))
    return value, low, high


def _by_processes(
    state: StudyState, settings: Mapping[str, Value], runs: Sequence[StudyRun]
) -> dict[str, tuple[float, float, float]]:
    """Return, by response, what a Gaussian process expects of a run on a new machine, and the 95 % interval."""
    from edmctl.study.statistics.gaussian_process import fit_process

    plan = state.folder.plan
    at = unit_points(plan.factors, [settings])
    found = {}
    for response in plan.responses:
        having = [run for run in runs if run.value(response.name) is not None]
        values = [float(run.value(response.name) or 0.0) for run in having]
        if len(having) < LEAST_RUNS:
            continue
        is_log = response.is_log and min(values) > 0
        process = fit_process(
            unit_points(plan.factors, [run.planned.settings for run in having]),
            [math.log(value) for value in values] if is_log else values,
            blocks=[run.block for run in having],
        )
        found[response.name] = _interval(process, at, is_log=is_log)
    return found


def _interval(
    process: GaussianProcess, at: Sequence[Sequence[float]], *, is_log: bool
) -> tuple[float, float, float]:
    mean, sd = (float(one[0]) for one in process.predict(at))
    half = half_width(math.sqrt(sd**2 + process.noise_sd**2 + process.block_sd**2))
    bounds = (mean, mean - half, mean + half)
    return tuple(math.exp(one) for one in bounds) if is_log else bounds  # type: ignore[return-value]
