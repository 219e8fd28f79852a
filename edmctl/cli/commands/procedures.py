"""`edmctl approach`, `jump-flush`, `measure-wear` and `measure-drift`: single procedures of the main job."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from edmctl.cli.options import PROGRESS, JobOptions, NewToolOption, RunOptions, command
from edmctl.cli.outcome import Outcome
from edmctl.cli.render.style import Style
from edmctl.cli.running import identity_before, perform_and_tell
from edmctl.wording import coordinates

if TYPE_CHECKING:
    from edmctl.jobs.measure_wear import ReferenceTouch, WearMeasurement
    from edmctl.jobs.procedures import Approach, DriftMeasurement, Jumps

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


def _show_plan(outcome: Outcome, title: str, forecast: Mapping[str, object]) -> None:
    from edmctl.cli.render.procedure_tables import render_procedure_plan

    outcome.result = {"forecast": forecast}
    outcome.show(lambda style: render_procedure_plan(title, forecast, style))


@command("approach", PROGRESS)
def approach(
    outcome: Outcome,
    job: JobOptions,
    run: RunOptions,
    contact: ContactOption = False,
    site: PlaceOption = None,
) -> None:
    """Feed the tool to the spark gap, report its position, retract.

    The feed is the profile's approach speed. With --contact the tool touches the surface without sparks instead.
    """
    from edmctl.jobs.ledger.prepared_job import place_of
    from edmctl.jobs.procedures import Approach

    plan = job.plan(outcome)
    procedure = Approach(plan, place_of(site), contact=contact)
    if run.dry_run:
        forecast = procedure.forecast(identity_before(outcome, plan), run.out)
        where = coordinates(float(forecast["x_um"]), float(forecast["y_um"]))
        _show_plan(outcome, f"{forecast['kind']} at {where}", forecast)
    else:
        perform_and_tell(outcome, procedure, job, run, _surface_table)


def _surface_table(done: "Approach", style: Style) -> str:
    from edmctl.cli.render.procedure_tables import render_surface

    assert done.found is not None
    return render_surface(done.found, style)


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
    """Make electrode jumps; report height, residual error and settling time.

    The tool jumps beside the workpiece, as deep as at the end of the profile's job, without sparks. The sensor is
    sampled at 1 kHz.
    """
    from edmctl.jobs.procedures import JUMPS_ALONE, Jumps

    changes = [
        f"jump.{key}={value!r}"
        for key, value in (("height_um", height_um), ("speed_um_s", speed), ("period_s", period_s))
        if value is not None
    ]
    jumps = Jumps(job.plan(outcome, (*changes, *JUMPS_ALONE)), count)
    if run.dry_run:
        _show_plan(outcome, "jump-flush", jumps.forecast())
    else:
        perform_and_tell(outcome, jumps, job, run, _jumps_table)


def _jumps_table(done: "Jumps", style: Style) -> str:
    from edmctl.cli.render.procedure_tables import render_jumps

    assert done.series is not None
    return render_jumps(done.series, style)


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
    """Measure tool wear, depth and feed by touching pad, hole and pad.

    Wear is measured relative to the tool's reference touch: that of its first job, or of --reference. The job
    ledger beside the run files contains it. Without a profile, the tool last in use is measured with the settings of
    the run that made the hole.
    """
    from edmctl.jobs.measure_wear import TOUCHES_LIKE, ReferenceTouch, WearMeasurement
    from edmctl.record.ledger import Ledger

    plan = job.plan(outcome, like=TOUCHES_LIKE, new_tool=new_tool)
    wear = ReferenceTouch(plan) if reference else WearMeasurement(plan, site)
    if not run.dry_run:
        perform_and_tell(outcome, wear, job, run, _wear_table)
        return
    if (identity := identity_before(outcome, plan)) is not None:
        wear.plan = wear.look(plan, identity, Ledger.open(run.out), outcome.warn)
    _show_plan(outcome, "measure-wear", wear.forecast())


def _wear_table(done: "ReferenceTouch | WearMeasurement", style: Style) -> str:
    from edmctl.cli.render.procedure_tables import render_reference, render_wear
    from edmctl.jobs.measure_wear import ReferenceTouch

    label = done.account.label
    if isinstance(done, ReferenceTouch):
        assert done.touched is not None
        reading, model_um = done.touched.reading, done.touched.model_um
        return render_reference(label, reading.mean_um, reading.sd_um, reading.touches, model_um, style)
    assert done.found is not None
    name = done.bottom.name if done.bottom else label
    return render_wear(name, done.found, done.account.worn_um, done.total_um, done.truth, style)


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
    """Measure sensor drift so that later jobs can correct wear.

    For a quarter of an hour touches of the reference pad alternate with holds at 0 V, without sparks. A hold at
    depth beside the workpiece separates creep from drift. Without a profile, the tool last in use is taken, with the
    settings of its last run.
    """
    from edmctl.jobs.measure_wear import TOUCHES_LIKE
    from edmctl.jobs.procedures import DriftMeasurement

    drift = DriftMeasurement(job.plan(outcome, like=TOUCHES_LIKE), duration, output)
    if run.dry_run:
        _show_plan(outcome, "measure-drift", drift.forecast())
    else:
        perform_and_tell(outcome, drift, job, run, _drift_table)


def _drift_table(done: "DriftMeasurement", style: Style) -> str:
    from edmctl.cli.render.procedure_tables import render_drift

    assert done.found is not None
    path, replaced = str(done.path), done.replaced
    return render_drift(done.found, done.truth, path, done.use, replaced=replaced, style=style)
