"""`edmctl approach`: find the spark gap, or the surface."""

import sys
from typing import Annotated

import typer

from edmctl.cli.options import PROGRESS, JobOptions, RunOptions, command
from edmctl.cli.outcome import Outcome, stream_style
from edmctl.cli.running import identity_before, perform_and_tell

ContactOption = Annotated[
    bool, typer.Option("--contact", help="Touch the surface, without sparks, instead of finding the gap.")
]
PlaceOption = Annotated[
    str | None,
    typer.Option(
        "--site",
        metavar="X,Y",
        help="Stage coordinates in µm. Default: where `machine` would put its first hole.",
    ),
]


@command("approach", PROGRESS)
def approach(
    outcome: Outcome,
    job: JobOptions,
    run: RunOptions,
    contact: ContactOption = False,
    site: PlaceOption = None,
) -> None:
    """Feed the tool to the spark gap, say where it is, retract.

    The feed is the profile's approach speed. With --contact the tool touches the surface by continuity instead.
    """
    from edmctl.console.procedure_tables import render_approach_plan, render_surface
    from edmctl.jobs.ledger.places_taken import place_of
    from edmctl.jobs.procedures import Approach, approach_forecast

    plan, place = job.plan(outcome), place_of(site)
    if run.dry_run:
        forecast = approach_forecast(plan, identity_before(outcome, plan), place, run.out, contact=contact)
        outcome.result = {"forecast": forecast}
        outcome.text = render_approach_plan(forecast, stream_style(sys.stdout))
    else:
        found = Approach(plan, place, contact=contact)
        perform_and_tell(outcome, found, job, run, lambda style: render_surface(found.surface, style))
