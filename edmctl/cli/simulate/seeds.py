"""`edmctl simulate`: the same job on many virtual machines; its subcommands simulate other things."""

import dataclasses
import shlex
import sys
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
    ProfileOption,
    QuietOption,
    SeedOption,
    SetOption,
    SetupOption,
)
from edmctl.cli.outcome import Outcome, Output, run_command, stream_style, watching
from edmctl.cli.shell import shell
from edmctl.cli.simulate.actuator import actuator
from edmctl.cli.simulate.serve import serve
from edmctl.errors import Diagnostic, ObjectiveNotReached, UsageError
from edmctl.jobs.plan import SIMULATOR
from edmctl.jobs.run_header import plain_name
from edmctl.jobs.simulate.seeds import seed_to_use
from edmctl.wording import plural

if TYPE_CHECKING:
    from edmctl.cli.simulate.batch import Task
    from edmctl.jobs.plan import JobRequest, Plan
    from edmctl.results.simulation import SimulatedRun

MOST_RUNS = 100_000

app = typer.Typer(rich_markup_mode=None, add_completion=False, subcommand_metavar="[COMMAND ...]")
app.command("actuator")(actuator)
app.command("serve")(serve)

RunsOption = Annotated[
    int,
    typer.Option("--runs", "-n", metavar="N", min=1, max=MOST_RUNS, help="Runs, with seeds one apart."),
]
SweepOption = Annotated[
    list[str] | None,
    typer.Option(
        "--sweep",
        metavar="KEY=START:STOP:COUNT",
        help="All runs for each of these values.",
        autocompletion=completion.swept,
    ),
]
OutOption = Annotated[
    Path | None, typer.Option("--out", metavar="DIR", help="Write a run file of each run; none without.")
]


@dataclasses.dataclass(frozen=True, slots=True)
class _Case:
    """One set of values that was asked for, checked."""

    label: str
    request: "JobRequest"
    plan: "Plan"


@dataclasses.dataclass(frozen=True, slots=True)
class _Batch:
    """All runs: `runs` of each case, with the same seeds."""

    cases: list[_Case]
    seed: int
    runs: int
    out: Path | None

    def tasks(self) -> list["Task"]:
        """Return one task per run, case after case."""
        from edmctl.cli.simulate.batch import Task

        return [
            Task(case.request, seed, self.out, f"{plain_name(case.label)}-seed{seed}")
            for case in self.cases
            for seed in range(self.seed, self.seed + self.runs)
        ]

    def __str__(self) -> str:
        seeds = f"seed {self.seed}" if self.runs == 1 else f"seeds {self.seed} to {self.seed + self.runs - 1}"
        values = f"{len(self.cases)} values with " if len(self.cases) > 1 else ""
        return f"{values}{plural(self.runs, 'run')}{' each' if values else ''}, {seeds}"


@app.callback(invoke_without_command=True)
def simulate(
    context: typer.Context,
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
    as_json: JsonOption = False,
    events: EventsOption = False,
    quiet: QuietOption = False,
    debug: DebugOption = False,
) -> int:
    """Run a job on many virtual machines.

    Reports how depth, wear, time and the errors of measuring spread over the seeds. `simulate actuator` drives
    the actuator of one machine alone.
    """
    if context.invoked_subcommand is not None:
        _refuse_options_before(context)
        return 0

    def body(outcome: Outcome) -> None:
        from edmctl.cli.simulate.batch import check_names
        from edmctl.jobs.plan import JobRequest

        request = JobRequest(profile, tuple(overrides or ()), setup, SIMULATOR, calibration, allow_model)
        outcome.simulated = True
        first_seed = seed_to_use(seed, runs)
        cases = _checked(outcome, _requests(request, sweep or [], runs))
        batch = _Batch(cases, first_seed, runs, out)
        if sweep and runs == 1:
            outcome.warn([_one_machine(first_seed)])
        if out:
            check_names(batch.tasks())
        if dry_run:
            _forecast(outcome, cases)
            return
        outcome.seed = first_seed
        _simulate(outcome, batch)

    return run_command(Output("simulate", as_json, events, quiet, debug), body)


def _refuse_options_before(context: typer.Context) -> None:
    """The options of a job say nothing to a subcommand; left there they would be lost without a word."""
    given = [
        parameter.opts[0]
        for parameter in context.command.params
        if (source := context.get_parameter_source(parameter.name or "")) and source.name == "COMMANDLINE"
    ]
    if given:
        context.fail(f"{given[0]} stands before {context.invoked_subcommand!r}; options go after it")


def _requests(request: "JobRequest", sweeps: list[str], runs: int) -> list["JobRequest"]:
    from edmctl.jobs.simulate.sweep import parse_sweep

    if not sweeps:
        return [request]
    if len(sweeps) > 1:
        raise UsageError(
            f"--sweep goes over one key at a time, and {len(sweeps)} are given.",
            hint="Say one of them with --sweep and each value of the other with --set, in a command of its own.",
            code="E2003",
        )
    steps = parse_sweep(sweeps[0]).overrides()
    if len(steps) * runs > MOST_RUNS:
        raise UsageError(
            f"{len(steps)} values with {plural(runs, 'run')} each are {len(steps) * runs} runs; "
            f"at most {MOST_RUNS} go at a time.",
            hint=f"Take --runs {MOST_RUNS // len(steps)} or fewer, or fewer values.",
            code="E2003",
        )
    return [dataclasses.replace(request, overrides=(*request.overrides, step)) for step in steps]


def _checked(outcome: Outcome, requests: list["JobRequest"]) -> list["_Case"]:
    """Check every request before anything runs; raises ProfileError, UsageError, LinkLost."""
    from edmctl.jobs.checking import check

    plans = [check(request, shell()) for request in requests]
    outcome.warn(dict.fromkeys(warning for plan in plans for warning in plan.loaded.warnings))
    labels = [
        _label(plan.loaded.path.stem, request, len(requests))
        for request, plan in zip(requests, plans, strict=True)
    ]
    return [_Case(*parts) for parts in zip(labels, requests, plans, strict=True)]


def _one_machine(seed: int) -> Diagnostic:
    return Diagnostic(
        "W2003",
        f"Every value of the sweep runs on the one machine of seed {seed}: its sensor errs alike in all.",
        "What the runs have in common does not show as a difference; --runs 4 or more shows how machines differ.",
        is_warning=True,
    )


def _forecast(outcome: Outcome, cases: list["_Case"]) -> None:
    from edmctl.console.profile_tables import render_forecasts

    outcome.result = {
        "cases": [
            {"label": case.label, "overrides": case.request.overrides, "forecast": case.plan.forecast}
            for case in cases
        ]
    }
    style = stream_style(sys.stdout)
    outcome.text = render_forecasts([(case.label, case.plan.forecast) for case in cases], style)


def _simulate(outcome: Outcome, batch: "_Batch") -> None:
    from edmctl.cli.simulate.batch import perform_all
    from edmctl.console.statistics_table import render_cases
    from edmctl.jobs.simulate.statistics import summarize

    with watching(outcome.output) as reporter:
        reporter.note(f"simulating {batch}")
        done = perform_all(batch.tasks(), reporter)
    cases = [
        summarize(case.label, case.request.overrides, done[index * batch.runs : (index + 1) * batch.runs])
        for index, case in enumerate(batch.cases)
    ]
    outcome.result = {"runs": batch.runs, "cases": cases}
    outcome.text = render_cases(cases, stream_style(sys.stdout))
    _refuse_failures(done, batch)


def _single(request: "JobRequest", seed: int) -> str:
    """The command of one run alone."""
    words = ["edmctl", "machine", "--seed", str(seed)]
    for option, value in (
        ("--profile", request.profile),
        ("--setup", request.setup),
        ("--calibration", request.calibration),
        *(("--set", override) for override in request.overrides),
    ):
        words += [option, str(value)] if value is not None else []
    return shlex.join([*words, *(["--allow-model"] if request.allow_model else [])])


def _label(stem: str, request: "JobRequest", requests: int) -> str:
    """The profile's name, or in a sweep the value that this case has."""
    return stem if requests == 1 else request.overrides[-1]


def _refuse_failures(runs: list["SimulatedRun"], batch: "_Batch") -> None:
    failed = [(batch.cases[number // batch.runs], run) for number, run in enumerate(runs) if not run.ok]
    if failed:
        case, first = failed[0]
        raise ObjectiveNotReached(
            f"{len(failed)} of {plural(len(runs), 'run')} failed; the first, with seed {first.seed}: {first.error}",
            hint=f"Repeat it with `{_single(case.request, first.seed)}`.",
            code="E7900",
        )
