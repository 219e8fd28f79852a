"""`edmctl machine`: the main job."""

import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from edmctl.cli.bench import seed_warning
from edmctl.cli.options import (
    AllowModelOption,
    CalibrationOption,
    DebugOption,
    DryRunOption,
    EventsOption,
    JsonOption,
    PortOption,
    ProfileOption,
    QuietOption,
    RunIdOption,
    SeedOption,
    SetOption,
    SetupOption,
    WaitOption,
)
from edmctl.cli.outcome import Outcome, Output, run_command, stream_style, watching
from edmctl.cli.runfile import RunName, name_run
from edmctl.cli.seeds import seed_to_use, simulated_by
from edmctl.cli.signals import ignore_signals

if TYPE_CHECKING:
    from edmctl.cli.job import Plan, Report
    from edmctl.console.style import Style

OutOption = Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder of the run file.")]


def machine(
    profile: ProfileOption = None,
    overrides: SetOption = None,
    setup: SetupOption = None,
    port: PortOption = None,
    wait: WaitOption = 0.0,
    seed: SeedOption = None,
    calibration: CalibrationOption = None,
    allow_model: AllowModelOption = False,
    out: OutOption = Path("runs"),
    run_id: RunIdOption = None,
    dry_run: DryRunOption = False,
    as_json: JsonOption = False,
    events: EventsOption = False,
    quiet: QuietOption = False,
    debug: DebugOption = False,
) -> int:
    """Machine a hole to its target depth or feed.

    Depth and tool wear are measured by touching the surface before, the bottom, and the surface after.
    """
    output = Output("machine", as_json, events, quiet, debug)

    def body(outcome: Outcome) -> None:
        from edmctl.cli.job import Order, check

        plan = check(Order(profile, tuple(overrides or ()), setup, port, calibration, allow_model, wait))
        outcome.simulated = plan.simulated
        outcome.warn([*plan.loaded.warnings, *seed_warning(plan.where, seed)])
        name = name_run(out, run_id, plan.loaded, datetime.now(UTC))
        used_seed = seed_to_use(seed)
        if dry_run:
            _forecast(outcome, plan)
        else:
            _run(outcome, plan, name, used_seed)

    return run_command(output, body)


def _forecast(outcome: Outcome, plan: "Plan") -> None:
    from edmctl.console.forecast_table import render_forecast

    outcome.result = {"forecast": plan.forecast}
    outcome.text = render_forecast(plan.loaded.profile.meta.name, plan.forecast, stream_style(sys.stdout))


def _run(outcome: Outcome, plan: "Plan", name: RunName, seed: int) -> None:
    from edmctl.cli.job import carry_out

    outcome.seed = seed if plan.where.in_process else None
    with watching(outcome.output) as reporter:
        report = carry_out(plan, seed, reporter, name, outcome.warn)
        outcome.simulated = report.simulated
        ignore_signals()
        outcome.run_file = report.run_file
        if report.error and outcome.run_file:
            reporter.note(f"what was recorded until then is in {outcome.run_file}")
    outcome.result = report.as_mapping()
    if report.job.sites:
        outcome.text = closing_text(report, outcome.seed, stream_style(sys.stdout))
    if report.error:
        raise report.error


def closing_text(report: "Report", seed: int | None, style: "Style") -> str:
    """Return the table at the end of a job, and what it was made with."""
    from edmctl.console.result_table import render_job

    lines = [render_job(report.job, report.truths, style)]
    if report.model:
        lines.append(f"Actuator model: {report.model.text}.")
        if report.model.alone:
            lines.append("No sensor is fitted: what stands under 'measured' is estimated by that model.")
    made_by = simulated_by(seed) if report.simulated else ""
    return "\n".join([*lines, f"{made_by}Run file {report.run_file}"])
