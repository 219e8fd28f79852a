"""`edmctl machine`: the main job."""

from datetime import UTC, datetime
from typing import TYPE_CHECKING, Annotated

import typer

from edmctl import failures
from edmctl.cli import completion
from edmctl.cli.options import PROGRESS, JobOptions, NewToolOption, RunOptions, command
from edmctl.cli.outcome import Outcome
from edmctl.cli.render.result_table import render_job
from edmctl.cli.running import identity_before, run_and_tell
from edmctl.cli.signals import shell

if TYPE_CHECKING:
    from edmctl.jobs.plan import Plan
    from edmctl.jobs.run_header import RunName

ResumeOption = Annotated[
    str | None,
    typer.Option(
        "--resume",
        metavar="RUN",
        help="Continue an interrupted run: its file, or its id in --out.",
        autocompletion=completion.unfinished,
    ),
]
HomedOption = Annotated[
    bool,
    typer.Option(
        "--homed",
        help="With --resume: confirm that the stages are where the restarted controller counts them.",
    ),
]
RestartHoleOption = Annotated[
    bool,
    typer.Option(
        "--restart-hole",
        help="With --resume: make the hole that was left from the start, where its face is untouched.",
    ),
]

_KEPT_ALREADY = {
    "profile": "--profile",
    "overrides": "--set",
    "setup": "--setup",
    "seed": "--seed",
    "controller": "--controller",
    "calibration": "--calibration",
    "allow_model": "--allow-model",
    "new_tool": "--new-tool",
}


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
    else:
        _run(outcome, plan, name, job.seed)


def _forecast(outcome: Outcome, plan: "Plan", name: "RunName") -> None:
    """Show the forecast, for a resumed job of what remains. Raises what ledger and bench would refuse."""
    from edmctl.cli.render.profile_tables import render_forecast
    from edmctl.jobs.ledger.prepared_job import forewarned

    result: dict[str, object] = {}
    if plan.resumed is not None:
        resumed = plan.resumed
        outcome.show(resumed.message())
        result["resumed"] = resumed.as_mapping()
    elif (identity := identity_before(outcome, plan)) is not None:
        outcome.warn(forewarned(plan, name, identity))
    forecast = plan.forecast_left()
    outcome.result = {**result, "forecast": forecast}
    if forecast is not None:
        title = plan.loaded.profile.meta.name
        outcome.show(lambda style: render_forecast(title, forecast, style))


def _run(outcome: Outcome, plan: "Plan", name: "RunName", seed: int | None) -> None:
    from edmctl.jobs.job import carry_out

    run_and_tell(
        outcome,
        plan,
        seed,
        lambda used_seed, reporter: carry_out(plan, used_seed, reporter, name, outcome.warn),
        lambda done, style: render_job(done.job, done.truths, style, done.channel_truth),
    )


def _refuse_other_options(context: typer.Context) -> None:
    """Raise UsageError E2050 for options that the journal contains. Environment variables do not count."""
    named = [
        option
        for name, option in _KEPT_ALREADY.items()
        if getattr(context.get_parameter_source(name), "name", "") == "COMMANDLINE"
    ]
    if named:
        raise failures.resume_with_other_options(named=", ".join(named))
