"""`edmctl measure-wear`: what a tool has lost since its reference, and how deep its last hole is."""

import sys
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

import typer

from edmctl.cli.options import PROGRESS, JobOptions, NewToolOption, RunOptions, command
from edmctl.cli.outcome import Outcome, stream_style
from edmctl.cli.running import identity_before, perform_and_tell

if TYPE_CHECKING:
    from edmctl.console.style import Style
    from edmctl.jobs.measure_wear import WearRun

ReferenceOption = Annotated[
    bool, typer.Option("--reference", help="Touch the pad and keep it as Z1: do this before a job.")
]
SiteOption = Annotated[
    str | None,
    typer.Option(
        "--site", metavar="NAME|X,Y", help="The hole to touch. Default: the last one that the tool made."
    ),
]


@command("measure-wear", PROGRESS)
def measure_wear(
    outcome: Outcome,
    job: JobOptions,
    run: RunOptions,
    reference: ReferenceOption = False,
    new_tool: NewToolOption = False,
    site: SiteOption = None,
) -> None:
    """Touch pad, hole and pad again: tool wear, depth and feed.

    They count from the reference, the first touch of a tool: that of its first job, or of --reference. It is kept in
    the job ledger beside the run files. Without a profile it measures the tool last in use, by the recipe of the
    run that made the hole.
    """
    from edmctl.console.procedure_tables import render_wear_plan
    from edmctl.jobs.measure_wear import TOUCHES_LIKE, WearRun, wear_forecast
    from edmctl.record.ledger import Ledger

    plan = job.plan(outcome, like=TOUCHES_LIKE, new_tool=new_tool)
    plan = replace(plan, names_tool=job.profile is not None)
    wear = WearRun(plan, site, is_reference=reference)
    if not run.dry_run:
        perform_and_tell(outcome, wear, job, run, lambda style: _rendered(wear, style))
        return
    if (identity := identity_before(outcome, plan)) is not None:
        wear.look(identity, Ledger.open(run.out), outcome.warn)
    forecast = wear_forecast(wear.plan, reference=reference)
    outcome.result = {"forecast": forecast}
    outcome.text = render_wear_plan(**forecast, style=stream_style(sys.stdout))


def _rendered(run: "WearRun", style: "Style") -> str:
    from edmctl.console.procedure_tables import render_reference, render_wear

    label = run.account.label
    if run.touched is not None:
        reading, model_um = run.touched.reading, run.touched.model_um
        return render_reference(label, reading.mean_um, reading.sd_um, reading.touches, model_um, style)
    assert run.found is not None
    name = run.bottom.name if run.bottom else label
    return render_wear(name, run.found, run.account.worn_um, run.total_um, run.truth, style)
