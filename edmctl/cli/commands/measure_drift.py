"""`edmctl measure-drift`: what rests at 0 V and touches of the pad tell of drift, for the jobs to come."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from edmctl.cli.options import PROGRESS, JobOptions, RunOptions, command
from edmctl.cli.outcome import Outcome, stream_style
from edmctl.cli.running import perform_and_tell

if TYPE_CHECKING:
    from edmctl.console.style import Style
    from edmctl.jobs.measure_drift import DriftRun

DurationOption = Annotated[
    float | None,
    typer.Option(
        "--duration", metavar="S", min=0.0, help="Time of touches and hold. Default: drift.duration_s."
    ),
]
OutputOption = Annotated[
    Path | None,
    typer.Option("--output", metavar="FILE", help="Where to save it. Default: as the machine's own."),
]


@command("measure-drift", PROGRESS)
def measure_drift(
    outcome: Outcome,
    job: JobOptions,
    run: RunOptions,
    duration: DurationOption = None,
    output: OutputOption = None,
) -> None:
    """Find out what of a drift at rest touches of the pad see.

    The pad is touched and the tool rests in turn for a quarter of an hour, without sparks, with a hold at depth
    beside the work: creep after it moves rests and no touches. Later jobs on the machine correct their wear by the
    drift of their rests. Without a profile it measures with the tool last in use, by the
    recipe of its last run.
    """
    from edmctl.console.procedure_tables import render_drift_plan
    from edmctl.jobs.measure_drift import DriftRun, drift_forecast
    from edmctl.jobs.measure_wear import TOUCHES_LIKE

    plan = job.plan(outcome, like=TOUCHES_LIKE)
    plan = replace(plan, names_tool=job.profile is not None)
    if run.dry_run:
        forecast = drift_forecast(plan, duration)
        outcome.result = {"forecast": forecast}
        outcome.text = render_drift_plan(**forecast, style=stream_style(sys.stdout))
        return
    drift = DriftRun(plan, duration, output)
    perform_and_tell(outcome, drift, job, run, lambda style: _rendered(drift, style))


def _rendered(run: "DriftRun", style: "Style") -> str:
    from edmctl.console.procedure_tables import render_drift

    assert run.found is not None
    return render_drift(run.found, run.truth, str(run.path), run.use, replaced=run.replaced, style=style)
