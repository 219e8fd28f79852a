"""`edmctl jump-flush`: electrode jumps in free space, measured one by one."""

import sys
from typing import Annotated

import typer

from edmctl.cli.options import PROGRESS, JobOptions, RunOptions, command
from edmctl.cli.outcome import Outcome, stream_style
from edmctl.cli.running import perform_and_tell

MOST_JUMPS = 1000

CountOption = Annotated[
    int, typer.Option("--count", "-n", metavar="N", min=1, max=MOST_JUMPS, help="Jumps to make.")
]
HeightOption = Annotated[
    float | None, typer.Option("--height-um", metavar="UM", help="Overrides jump.height_um of the profile.")
]
SpeedOption = Annotated[
    float | None, typer.Option("--speed", metavar="UM_S", help="Overrides jump.speed_um_s of the profile.")
]
PeriodOption = Annotated[
    float | None, typer.Option("--period-s", metavar="S", help="Overrides jump.period_s of the profile.")
]


@command("jump-flush", PROGRESS)
def jump_flush(
    outcome: Outcome,
    job: JobOptions,
    run: RunOptions,
    count: CountOption = 10,
    height_um: HeightOption = None,
    speed: SpeedOption = None,
    period_s: PeriodOption = None,
) -> None:
    """Make electrode jumps; report their height and the way back.

    The tool jumps beside the work, as low as at the end of the profile's job, and without sparks. The sensor is
    sampled a thousand times a second, and tells how well and how soon the tool is back.
    """
    from edmctl.console.procedure_tables import render_jump_plan, render_jumps
    from edmctl.jobs.procedures import JUMPS_ALONE, Jumps, jumps_forecast, refuse_hurry

    changes = [
        f"jump.{key}={value!r}"
        for key, value in (("height_um", height_um), ("speed_um_s", speed), ("period_s", period_s))
        if value is not None
    ]
    plan = job.plan(outcome, (*changes, *JUMPS_ALONE))
    refuse_hurry(plan)
    if run.dry_run:
        forecast = jumps_forecast(plan, count)
        outcome.result = {"forecast": forecast}
        outcome.text = render_jump_plan(forecast, stream_style(sys.stdout))
    else:
        jumps = Jumps(plan, count)
        perform_and_tell(outcome, jumps, job, run, lambda style: render_jumps(jumps.measured, style))
