"""Commands that do one procedure: `edmctl approach`, `edmctl jump-flush` and `edmctl measure-wear`.

An approach finds the spark gap, or the surface; electrode jumps are made in free space and measured one by one; a
measurement of wear tells what a tool has lost since its reference, and how deep its last hole is.
"""

import sys
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

import typer

from edmctl.cli.options import PROGRESS, JobOptions, NewToolOption, RunOptions, command
from edmctl.cli.outcome import Outcome, stream_style
from edmctl.cli.running import identity_before, perform_and_tell
from edmctl.errors import UsageError

if TYPE_CHECKING:
    from edmctl.console.style import Style
    from edmctl.jobs.measure_wear import WearRun

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
    the job ledger beside the run files. Without a profile the tool last in use is meant.
    """
    from edmctl.console.procedure_tables import render_wear_plan
    from edmctl.jobs.measure_wear import TOUCHES_LIKE, WearRun, wear_forecast
    from edmctl.record.ledger import Logbook

    if new_tool and not reference:
        raise UsageError(
            "--new-tool goes with --reference: a tool that was changed has lost nothing yet.",
            hint="Say `edmctl measure-wear --reference --new-tool`.",
            code="E2062",
        )
    plan = job.plan(outcome, like=TOUCHES_LIKE, new_tool=new_tool)
    plan = replace(plan, names_tool=job.profile is not None)
    wear = WearRun(plan, site, is_reference=reference)
    if not run.dry_run:
        perform_and_tell(outcome, wear, job, run, lambda style: _wear_rendered(wear, style))
        return
    if (identity := identity_before(outcome, plan)) is not None:
        wear.look(identity, Logbook.open(run.out), outcome.warn)
    forecast = wear_forecast(plan, reference=reference)
    outcome.result = {"forecast": forecast}
    outcome.text = render_wear_plan(**forecast, style=stream_style(sys.stdout))


def _wear_rendered(run: "WearRun", style: "Style") -> str:
    from edmctl.console.procedure_tables import render_reference, render_wear

    label = run.account.label
    if run.touched is not None:
        reading, model_um = run.touched.reading, run.touched.model_um
        return render_reference(label, reading.mean_um, reading.sd_um, reading.touches, model_um, style)
    assert run.found is not None
    name = run.bottom.name if run.bottom else label
    return render_wear(name, run.found, run.account.worn_um, run.total_um, run.truth, style)
