"""`edmctl machine`: the main job."""

import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from edmctl.cli import completion
from edmctl.cli.options import (
    AllowModelOption,
    CalibrationOption,
    DebugOption,
    DryRunOption,
    EventsOption,
    JsonOption,
    NewToolOption,
    OutOption,
    PortOption,
    ProfileOption,
    QuietOption,
    RunIdOption,
    SeedOption,
    SetOption,
    SetupOption,
    WaitOption,
)
from edmctl.cli.outcome import Outcome, Output, note, run_command, stream_style, watching
from edmctl.cli.run.recover import recovered_before
from edmctl.cli.shell import shell
from edmctl.cli.signals import ignore_signals
from edmctl.errors import UsageError
from edmctl.jobs.connect import seed_warning
from edmctl.jobs.resume.selection import checked, find_run, name_of_resumed
from edmctl.jobs.run_header import RunName, name_run
from edmctl.jobs.simulate.seeds import seed_to_use, simulated_by

if TYPE_CHECKING:
    from edmctl.console.style import Style
    from edmctl.jobs.job import Report
    from edmctl.jobs.plan import Plan

ResumeOption = Annotated[
    str | None,
    typer.Option(
        "--resume",
        metavar="RUN",
        help="Go on with a run that was interrupted: its file, or its id in --out.",
        autocompletion=completion.unfinished,
    ),
]
HomedOption = Annotated[
    bool,
    typer.Option(
        "--homed", help="With --resume: the stages were homed since the controller was switched on."
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
    "calibration": "--calibration",
    "allow_model": "--allow-model",
    "new_tool": "--new-tool",
}


def machine(
    context: typer.Context,
    profile: ProfileOption = None,
    overrides: SetOption = None,
    setup: SetupOption = None,
    port: PortOption = None,
    wait: WaitOption = 0.0,
    seed: SeedOption = None,
    calibration: CalibrationOption = None,
    allow_model: AllowModelOption = False,
    new_tool: NewToolOption = False,
    resume: ResumeOption = None,
    homed: HomedOption = False,
    restart_hole: RestartHoleOption = False,
    out: OutOption = Path("runs"),
    run_id: RunIdOption = None,
    dry_run: DryRunOption = False,
    as_json: JsonOption = False,
    events: EventsOption = False,
    quiet: QuietOption = False,
    debug: DebugOption = False,
) -> int:
    """Machine a hole to its target depth or feed.

    Depth and tool wear are measured by touching the surface before, the bottom, and the surface after. A job
    that was interrupted goes on with --resume: pad and bottom are touched again, so nothing is taken on trust, and
    nothing is machined where they are not as they were left.
    """
    output = Output("machine", as_json, events, quiet, debug)

    def body(outcome: Outcome) -> None:
        from edmctl.jobs.checking import check
        from edmctl.jobs.plan import JobRequest

        if resume is not None:
            _refuse_other_options(context)
            resumption = find_run(resume, out, homed=homed, restart_hole=restart_hole)
            plan = checked(resumption, port, wait, shell())
            if not dry_run:
                outcome.warn(recovered_before(resumption))
            name = name_of_resumed(resumption, run_id, datetime.now(UTC))
        elif homed or restart_hole:
            lone = "--homed" if homed else "--restart-hole"
            raise UsageError(f"{lone} goes with --resume only.", hint="Leave it out.", code="E2050")
        else:
            plan = check(
                JobRequest(
                    profile, tuple(overrides or ()), setup, port, calibration, allow_model, wait, new_tool
                ),
                shell(),
            )
            name = name_run(out, run_id, plan.loaded, datetime.now(UTC))
        outcome.simulated = plan.simulated
        outcome.warn([*plan.loaded.warnings, *seed_warning(plan.where, seed)])
        used_seed = seed_to_use(seed)
        if not dry_run:
            _run(outcome, plan, name, used_seed)
        elif plan.resumed is not None:
            outcome.result, outcome.text = {"resumed": plan.resumed.as_mapping()}, plan.resumed.told()
        else:
            _forewarn(outcome, plan, name)
            _forecast(outcome, plan)

    return run_command(output, body)


def _forewarn(outcome: Outcome, plan: "Plan", name: RunName) -> None:
    """Say what ledger and bench make of the job. Raises what would refuse it."""
    from edmctl.jobs.job_preparation import forewarned
    from edmctl.jobs.ledger.tool_identity import not_seen, tool_identity_in_file

    if not plan.where.lasting:
        return
    identity = tool_identity_in_file(plan.where)
    if identity is None:
        note(outcome.output, not_seen(plan.where))
    else:
        outcome.warn(forewarned(plan, name, identity))


def _forecast(outcome: Outcome, plan: "Plan") -> None:
    from edmctl.console.profile_tables import render_forecast

    outcome.result = {"forecast": plan.forecast}
    outcome.text = render_forecast(plan.loaded.profile.meta.name, plan.forecast, stream_style(sys.stdout))


def _run(outcome: Outcome, plan: "Plan", name: RunName, seed: int) -> None:
    from edmctl.jobs.job import carry_out

    outcome.seed = plan.where.seed_of(seed)
    with watching(outcome.output) as reporter:
        report = carry_out(plan, seed, reporter, name, outcome.warn)
        outcome.simulated = report.simulated
        ignore_signals()
        outcome.run_file = report.run_file
        if report.error and outcome.run_file:
            reporter.note(f"what was recorded until then is in {outcome.run_file}")
    outcome.result = report.as_mapping()
    if report.job.sites or report.job.channel:
        outcome.text = closing_text(report, outcome.seed, stream_style(sys.stdout))
    if report.error:
        raise report.error


def closing_text(report: "Report", seed: int | None, style: "Style") -> str:
    """Return the table at the end of a job, and what it was made with."""
    from edmctl.console.result_table import render_job

    lines = [render_job(report.job, report.truths, style, report.channel_truth)]
    if report.model:
        lines.append(f"Actuator model: {report.model.text}.")
        if report.model.alone:
            lines.append("No sensor is fitted: every touch was read by that model.")
    made_by = simulated_by(seed) if report.simulated else ""
    return "\n".join([*lines, f"{made_by}Run file {report.run_file}"])


def _refuse_other_options(context: typer.Context) -> None:
    """Raise UsageError E2050 for options that the journal has already. What the environment says does not count."""
    named = [
        option
        for name, option in _KEPT_ALREADY.items()
        if getattr(context.get_parameter_source(name), "name", "") == "COMMANDLINE"
    ]
    if named:
        raise UsageError(
            f"--resume goes on with the job as it was; {', '.join(named)} would change it.",
            hint="Leave that out. --port, --wait, --out, --run-id, --homed and --restart-hole go with --resume.",
            code="E2050",
        )
