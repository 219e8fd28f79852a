"""`edmctl machine`, the main job, and its single procedures: approach, jump-flush, measure-wear, measure-drift."""

from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from edmctl import failures
from edmctl.cli import completion
from edmctl.cli.options import PROGRESS, JobOptions, NewToolOption, RunOptions, command, option, options_given
from edmctl.cli.outcome import Outcome, note, watching
from edmctl.cli.render.procedure_tables import (
    render_drift,
    render_jumps,
    render_procedure_plan,
    render_reference,
    render_surface,
    render_wear,
)
from edmctl.cli.render.progress import Reporter
from edmctl.cli.render.result_table import render_job
from edmctl.cli.render.terminal import Style
from edmctl.cli.signals import ignore_signals, shell
from edmctl.jobs.sweep import seed_to_use, simulated_by
from edmctl.wording import coordinates

if TYPE_CHECKING:
    from edmctl.jobs.job import Report
    from edmctl.jobs.measure_wear import ReferenceTouch, WearMeasurement
    from edmctl.jobs.plan import Plan
    from edmctl.jobs.procedures import Procedure, ProcedureReport
    from edmctl.jobs.run_header import RunName
    from edmctl.jobs.tool import ToolIdentity

_R = TypeVar("_R", bound="Report | ProcedureReport")
_P = TypeVar("_P", bound="Procedure")
_T = TypeVar("_T")

ResumeOption = Annotated[
    str | None,
    option(
        "--resume RUN",
        "Continue an interrupted run: its file, or its id in --out.",
        autocompletion=completion.unfinished,
    ),
]
HomedOption = Annotated[
    bool,
    option(
        "--homed", "With --resume: confirm that the stages are where the restarted controller counts them."
    ),
]
RestartHoleOption = Annotated[
    bool,
    option(
        "--restart-hole",
        "With --resume: make the hole that was left from the start, where its face is untouched.",
    ),
]
ContactOption = Annotated[
    bool, option("--contact", "Touch the surface, without sparks, instead of finding the gap.")
]
PlaceOption = Annotated[
    str | None,
    option("--site X,Y", "Stage coordinates in µm. Default: where `machine` would put its first hole."),
]
MOST_JUMPS = 1000
CountOption = Annotated[int, option("--count -n N", "Jumps to make.", min=1, max=MOST_JUMPS)]
HeightOption = Annotated[float | None, option("--height-um UM", "Overrides jump.height_um of the profile.")]
SpeedOption = Annotated[float | None, option("--speed UM_S", "Overrides jump.speed_um_s of the profile.")]
PeriodOption = Annotated[float | None, option("--period-s S", "Overrides jump.period_s of the profile.")]
ReferenceOption = Annotated[
    bool, option("--reference", "Touch the pad and keep it as Z1: do this before a job.")
]
SiteOption = Annotated[
    str | None, option("--site NAME|X,Y", "The hole to touch. Default: the last one that the tool made.")
]
DurationOption = Annotated[
    float | None, option("--duration S", "Time of touches and hold. Default: drift.duration_s.", min=0.0)
]
OutputOption = Annotated[
    Path | None, option("--output FILE", "Where to save it. Default: as the machine's own.")
]
_IN_THE_JOURNAL = [
    "profile",
    "overrides",
    "setup",
    "seed",
    "controller",
    "calibration",
    "allow_model",
    "new_tool",
]


@command("machine", PROGRESS)
def machine(
    outcome: Outcome,
    context: typer.Context,
    job: JobOptions,
    run: RunOptions,
    new_tool: NewToolOption = False,
    resume: ResumeOption = None,
    homed: HomedOption = False,
    restart_hole: RestartHoleOption = False,
) -> None:
    """Machine the holes or the channel of a profile to their target depth or feed.

    Depth and tool wear are measured by touching the reference pad before, the bottom, and the pad after. --resume
    continues an interrupted job: pad and bottom are touched again, and the job is refused if they are not as they
    were.
    """
    from edmctl.jobs.resume import checked, find_run, name_of_resumed
    from edmctl.jobs.run_header import name_run
    from edmctl.jobs.runs.opening import recovered_before

    if resume is not None:
        _refuse_other_options(context)
        resumption = find_run(resume, run.out, homed=homed, restart_hole=restart_hole)
        plan = checked(resumption, job.port, job.wait, shell())
        if not run.dry_run:
            outcome.warn(recovered_before(resumption))
        name = name_of_resumed(resumption, run.run_id, datetime.now(UTC))
        outcome.simulated = plan.simulated
        outcome.uses(profile=plan.loaded.path, setup=plan.setup.file)
        outcome.warn(plan.loaded.warnings)
    elif homed or restart_hole:
        lone = "--homed" if homed else "--restart-hole"
        raise failures.option_without_resume(lone=lone)
    else:
        plan = job.plan(outcome, new_tool=new_tool)
        name = name_run(run.out, run.run_id, plan.loaded, datetime.now(UTC))
    if run.dry_run:
        _forecast(outcome, plan, name)
        return
    from edmctl.jobs.job import carry_out  # numpy and h5py

    _run(
        outcome,
        plan,
        job.seed,
        lambda seed, reporter: carry_out(plan, seed, reporter, name, outcome.warn),
        lambda done, style: render_job(done.job, done.truths, style, done.channel_truth),
    )


def _refuse_other_options(context: typer.Context) -> None:
    """Raise UsageError E2050 for options that the journal contains. Environment variables do not count."""
    given = options_given(context)
    named = [given[name] for name in _IN_THE_JOURNAL if name in given]
    if named:
        raise failures.resume_with_other_options(named=", ".join(named))


def _forecast(outcome: Outcome, plan: "Plan", name: "RunName") -> None:
    """Show the forecast, for a resumed job of what remains. Raises what ledger and bench would refuse."""
    from edmctl.cli.render.profile_tables import render_forecast
    from edmctl.jobs.prepared_job import forewarned

    result: dict[str, object] = {}
    if plan.resumed is not None:
        outcome.show(plan.resumed.message())
        result["resumed"] = plan.resumed.as_mapping()
    elif (identity := _identity_before(outcome, plan)) is not None:
        outcome.warn(forewarned(plan, name.path.parent, identity))
    forecast = plan.forecast_remaining()
    outcome.result = {**result, "forecast": forecast}
    if forecast is not None:
        outcome.show(lambda style: render_forecast(plan.loaded.profile.meta.name, forecast, style))


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
    from edmctl.jobs.prepared_job import place_of
    from edmctl.jobs.procedures import Approach

    plan = job.plan(outcome)
    procedure = Approach(plan, place_of(site), contact=contact)
    if run.dry_run:
        forecast = procedure.forecast(_identity_before(outcome, plan), run.out)
        where = coordinates(float(forecast["x_um"]), float(forecast["y_um"]))
        _show_plan(outcome, f"{forecast['kind']} at {where}", forecast)
    else:
        _perform(outcome, procedure, job, run, lambda done, style: render_surface(_made(done.found), style))


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

    jump = {"height_um": height_um, "speed_um_s": speed, "period_s": period_s}
    changes = [f"jump.{key}={value!r}" for key, value in jump.items() if value is not None]
    jumps = Jumps(job.plan(outcome, (*changes, *JUMPS_ALONE)), count)
    if run.dry_run:
        _show_plan(outcome, "jump-flush", jumps.forecast())
    else:
        _perform(outcome, jumps, job, run, lambda done, style: render_jumps(_made(done.series), style))


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
    from edmctl.jobs.measure_wear import ReferenceTouch, WearMeasurement
    from edmctl.jobs.plan import TOUCHES_LIKE
    from edmctl.record.ledger import Ledger

    plan = job.plan(outcome, like=TOUCHES_LIKE, new_tool=new_tool)
    wear = ReferenceTouch(plan) if reference else WearMeasurement(plan, site)
    if not run.dry_run:
        _perform(outcome, wear, job, run, _wear_table)
        return
    if (identity := _identity_before(outcome, plan)) is not None:
        wear.plan = wear.look(plan, identity, Ledger.open(run.out), outcome.warn)
    _show_plan(outcome, "measure-wear", wear.forecast())


def _wear_table(done: "ReferenceTouch | WearMeasurement", style: Style) -> str:
    from edmctl.jobs.measure_wear import ReferenceTouch

    label = done.account.label
    if isinstance(done, ReferenceTouch):
        touched = _made(done.touched)
        reading, model_um = touched.reading, touched.model_um
        return render_reference(label, reading.mean_um, reading.sd_um, reading.touches, model_um, style)
    name = done.bottom.name if done.bottom else label
    return render_wear(name, _made(done.found), done.account.worn_um, done.total_um, done.truth, style)


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
    from edmctl.jobs.plan import TOUCHES_LIKE
    from edmctl.jobs.procedures import DriftMeasurement

    drift = DriftMeasurement(job.plan(outcome, like=TOUCHES_LIKE), duration, output)
    if run.dry_run:
        _show_plan(outcome, "measure-drift", drift.forecast())
    else:

        def table(done: DriftMeasurement, style: Style) -> str:
            path, replaced = str(done.path), done.replaced
            return render_drift(_made(done.found), done.truth, path, done.use, replaced=replaced, style=style)

        _perform(outcome, drift, job, run, table)


def _made(result: _T | None) -> _T:
    """Return what a procedure has found: it is only shown where there is something."""
    assert result is not None
    return result


def _show_plan(outcome: Outcome, title: str, forecast: Mapping[str, object]) -> None:
    outcome.result = {"forecast": forecast}
    outcome.show(lambda style: render_procedure_plan(title, forecast, style))


def _perform(
    outcome: Outcome, procedure: _P, job: JobOptions, run: RunOptions, render: Callable[[_P, Style], str]
) -> None:
    """Do a procedure by itself, and set its result. Raises the error that ended it."""
    from edmctl.jobs.procedures import name_of, perform

    name = name_of(procedure.plan, procedure.name, run.out, run.run_id)
    _run(
        outcome,
        procedure.plan,
        job.seed,
        lambda seed, reporter: perform(procedure, name, seed, reporter, outcome.warn),
        lambda _, style: render(procedure, style),
    )


def _run(
    outcome: Outcome,
    plan: "Plan",
    asked_seed: int | None,
    run: Callable[[int, Reporter], _R],
    render: Callable[[_R, Style], str],
) -> None:
    """Run on the machine of `plan`, and set the result; `render` makes its table. Raises the error that ended it."""
    from edmctl.jobs.connect import seed_warning

    outcome.warn(seed_warning(plan.where, asked_seed))
    seed = seed_to_use(asked_seed)
    outcome.seed = plan.where.seed_of(seed)
    with watching(outcome.output) as reporter:
        report = run(seed, reporter)
        outcome.simulated = report.simulated
        ignore_signals()
        outcome.run_file = report.run_file
        if report.error and report.run_file:
            reporter.note(f"what was recorded until then is in {report.run_file}")
    outcome.result = report.as_mapping()
    if report.reached:
        outcome.show(lambda style: closing_text(render(report, style), style, report, outcome.seed))
    report.raise_for_error()


def closing_text(table: str, style: Style, report: "Report | ProcedureReport", seed: int | None) -> str:
    """Return the table at the end of a run, and what it was made with."""
    lines = []
    if report.model:
        lines.append(f"Actuator model: {report.model.text}.")
        if report.model.alone:
            lines.append("No sensor is fitted: every touch was read by that model.")
    made_by = simulated_by(seed) if report.simulated else ""
    lines.append(f"{made_by}Run file {report.run_file}")
    return "\n".join([table, *lines])


def _identity_before(outcome: Outcome, plan: "Plan") -> "ToolIdentity | None":
    """Return machine and tool as far as they are known without connecting; report if they are not.

    A fresh virtual machine has no history.
    """
    from edmctl.jobs.tool import tool_identity_in_file

    if not plan.where.lasting:
        return None
    identity = tool_identity_in_file(plan.where)
    if identity is None:
        note(
            outcome.output,
            "job ledger, bench and the machine's own setup were not looked at: the serial number of "
            f"{plan.where.selector} is known only once it is connected",
        )
    return identity
