"""`edmctl simulate`: the same job on many virtual machines; its subcommands simulate other things."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from edmctl.cli import completion
from edmctl.cli.options import (
    PROGRESS,
    AllowModelOption,
    CalibrationOption,
    DryRunOption,
    ProfileOption,
    SeedOption,
    SetOption,
    SetupOption,
    command,
    with_options_of,
)
from edmctl.cli.outcome import Outcome, stream_style, watching
from edmctl.cli.signals import begin_worker, shell
from edmctl.cli.simulate.actuator import actuator
from edmctl.cli.simulate.serve import serve
from edmctl.errors import Diagnostic, ObjectiveNotReached
from edmctl.jobs.sweep import MOST_RUNS, seed_to_use
from edmctl.wording import plural

if TYPE_CHECKING:
    from edmctl.jobs.batch import Case, Task
    from edmctl.results.simulation import SimulatedRun

app = typer.Typer(rich_markup_mode=None, add_completion=False, subcommand_metavar="[COMMAND ...]")
app.command("actuator")(actuator)
app.command("serve")(serve)

RunsOption = Annotated[
    int,
    typer.Option(
        "--runs", "-n", metavar="N", min=1, max=MOST_RUNS, help="Number of runs, with seeds one apart."
    ),
]
SweepOption = Annotated[
    list[str] | None,
    typer.Option(
        "--sweep",
        metavar="KEY=START:STOP:COUNT",
        help="Make all runs for each of these values. Repeatable: for all combinations.",
        autocompletion=completion.swept,
    ),
]
OutOption = Annotated[
    Path | None, typer.Option("--out", metavar="DIR", help="Write a run file of each run. Default: none.")
]


@command("simulate", PROGRESS)
def simulate(
    outcome: Outcome,
    profile: ProfileOption = None,
    overrides: SetOption = None,
    setup: SetupOption = None,
    runs: RunsOption = 10,
    sweep: SweepOption = None,
    seed: SeedOption = None,
    calibration: CalibrationOption = None,
    allow_model: AllowModelOption = False,
    out: OutOption = None,
    dry_run: DryRunOption = False,
) -> None:
    """Run a job on many virtual machines.

    Reports how depth, wear, time and the errors of measuring spread over the seeds. `simulate actuator` drives
    the actuator of one machine alone.
    """
    from edmctl.console.profile_tables import render_forecasts
    from edmctl.jobs.batch import cases_of, check_names, tasks_of
    from edmctl.jobs.plan import SIMULATOR, JobRequest

    request = JobRequest(profile, tuple(overrides or ()), setup, SIMULATOR, calibration, allow_model)
    outcome.simulated = True
    first_seed = seed_to_use(seed, runs)
    cases = cases_of(request, sweep or [], runs, shell())
    outcome.warn(dict.fromkeys(warning for case in cases for warning in case.plan.loaded.warnings))
    if sweep and runs == 1:
        outcome.warn([_one_machine(first_seed)])
    tasks = tasks_of(cases, first_seed, runs, out)
    check_names(tasks)
    if dry_run:
        told = [(case.label, case.request.overrides, case.plan.forecast) for case in cases]
        outcome.result = {
            "cases": [dict(zip(("label", "overrides", "forecast"), one, strict=True)) for one in told]
        }
        forecasts = [(label, forecast) for label, _, forecast in told]
        outcome.text = render_forecasts(forecasts, stream_style(sys.stdout))
        return
    outcome.seed = first_seed
    _simulate(outcome, cases, tasks)


@app.callback(invoke_without_command=True)
@with_options_of(simulate)
def simulate_or_subcommand(context: typer.Context, **given: Any) -> int:
    """Run a job on many virtual machines, or what a subcommand says."""
    if context.invoked_subcommand is None:
        return simulate(**given)
    _refuse_options_before(context)
    return 0


def _refuse_options_before(context: typer.Context) -> None:
    """The options of a job say nothing to a subcommand; left there they would be lost without a word."""
    given = [
        parameter.opts[0]
        for parameter in context.command.params
        if (source := context.get_parameter_source(parameter.name or "")) and source.name == "COMMANDLINE"
    ]
    if given:
        context.fail(f"{given[0]} stands before {context.invoked_subcommand!r}; options go after it")


def _one_machine(seed: int) -> Diagnostic:
    return Diagnostic(
        "W2003",
        f"Every value of the sweep runs on the one machine of seed {seed}: its sensor errs alike in all.",
        "What the runs have in common does not show as a difference; --runs 4 or more shows how machines differ.",
        is_warning=True,
    )


def _simulate(outcome: Outcome, cases: list["Case"], tasks: list["Task"]) -> None:
    """Run everything; what is finished when the series is stopped is told all the same."""
    from edmctl.jobs.batch import Program, command_of, perform_all

    runs, first_seed = len(tasks) // len(cases), tasks[0].seed
    seeds = f"seed {first_seed}" if runs == 1 else f"seeds {first_seed} to {first_seed + runs - 1}"
    values = f"{len(cases)} values with " if len(cases) > 1 else ""
    done: dict[int, SimulatedRun] = {}
    try:
        with watching(outcome.output) as reporter:
            reporter.note(f"simulating {values}{plural(runs, 'run')}{' each' if values else ''}, {seeds}")
            done.update(perform_all(tasks, Program(shell, begin_worker), reporter))
    finally:
        _tell(outcome, cases, runs, done)
    failed = [(cases[number // runs], done[number]) for number in sorted(done) if not done[number].ok]
    if failed:
        case, first = failed[0]
        raise ObjectiveNotReached(
            f"{len(failed)} of {plural(len(done), 'run')} failed; the first, with seed {first.seed}: {first.error}",
            hint=f"Repeat it with `{command_of(case.request, first.seed)}`.",
            code="E7900",
        )


def _tell(outcome: Outcome, cases: list["Case"], runs: int, done: "dict[int, SimulatedRun]") -> None:
    from edmctl.console.runs_tables import render_cases
    from edmctl.jobs.statistics import summarize

    finished = [
        (case, [done[number] for number in range(first, first + runs) if number in done])
        for case, first in zip(cases, range(0, runs * len(cases), runs), strict=True)
    ]
    summaries = [summarize(case.label, case.request.overrides, found) for case, found in finished if found]
    outcome.result = {"runs": runs, "finished": len(done), "cases": summaries}
    if summaries:
        outcome.text = render_cases(summaries, stream_style(sys.stdout))
    if len(done) < runs * len(cases):
        outcome.text += f"\n{len(done)} of {plural(runs * len(cases), 'run')} finished."
        outcome.text = outcome.text.lstrip()
