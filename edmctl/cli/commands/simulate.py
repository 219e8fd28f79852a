"""`edmctl simulate`: the same job on many virtual machines; its subcommands simulate other things."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from edmctl import failures
from edmctl.cli import completion
from edmctl.cli.commands.calibrate import actuator
from edmctl.cli.commands.serve import serve
from edmctl.cli.options import (
    PROGRESS,
    AllowModelOption,
    CalibrationOption,
    ControllerOption,
    DryRunOption,
    ProfileOption,
    SeedOption,
    SetOption,
    SetupOption,
    command,
    controlled_by,
    option,
    options_given,
    with_options_of,
)
from edmctl.cli.outcome import Outcome, watching
from edmctl.cli.signals import ignore_signals, shell
from edmctl.jobs.sweep import MOST_RUNS, seed_to_use
from edmctl.wording import plural

if TYPE_CHECKING:
    from edmctl.jobs.batch import Task
    from edmctl.jobs.plan import Plan
    from edmctl.results.job import Case, SimulatedRun

app = typer.Typer(rich_markup_mode=None, add_completion=False, subcommand_metavar="[COMMAND ...]")
app.command("actuator")(actuator)
app.command("serve")(serve)

USUAL_RUNS = 10
RunsOption = Annotated[
    int | None,
    option(
        "--runs -n N", f"Number of runs, with seeds one apart. Default: {USUAL_RUNS}.", min=1, max=MOST_RUNS
    ),
]
SweepOption = Annotated[
    list[str] | None,
    option(
        "--sweep KEY=START:STOP:COUNT",
        "Make all runs for each of these values, or of a list, KEY=A,B,C. Repeatable: for all combinations.",
        autocompletion=completion.swept,
    ),
]
OutOption = Annotated[Path | None, option("--out DIR", "Write a run file of each run. Default: none.")]
TableOption = Annotated[Path | None, option("--table FILE.csv", "Write one row a case into a new file.")]
FigureOption = Annotated[
    Path | None, option("--figure FILE", "Draw the cases into a new file: .png, .svg or .pdf.")
]


@command("simulate", PROGRESS)
def simulate(
    outcome: Outcome,
    profile: ProfileOption = None,
    overrides: SetOption = None,
    setup: SetupOption = None,
    runs: RunsOption = None,
    sweep: SweepOption = None,
    seed: SeedOption = None,
    controller: ControllerOption = None,
    calibration: CalibrationOption = None,
    allow_model: AllowModelOption = False,
    out: OutOption = None,
    table: TableOption = None,
    figure: FigureOption = None,
    dry_run: DryRunOption = False,
) -> None:
    """Run a job on many virtual machines.

    Reports the spread of depth, wear, time and measurement errors over the seeds. `simulate actuator` drives only
    the actuator of one machine.
    """
    from edmctl.cli.render.profile_tables import render_forecasts
    from edmctl.jobs.batch import cases_of, check_names, tasks_of
    from edmctl.jobs.plan import SIMULATOR, JobRequest

    outcome.simulated = True
    _check_files(table, figure)
    changes = (*(overrides or ()), *controlled_by(controller))
    request = JobRequest(profile, changes, setup, SIMULATOR, calibration, allow_model)
    many = USUAL_RUNS if runs is None else runs
    first_seed = seed_to_use(seed, many)
    cases = cases_of(request, sweep or [], many, shell())
    outcome.uses(profile=cases[0][1].loaded.path, setup=cases[0][1].setup.file)
    outcome.warn(dict.fromkeys(warning for _, plan in cases for warning in plan.loaded.warnings))
    if sweep and many == 1:
        outcome.warn([failures.sweep_on_one_machine(seed=first_seed)])
    tasks = tasks_of(cases, range(first_seed, first_seed + many), out)
    check_names(tasks)
    if dry_run:
        outcome.result = {
            "cases": [
                {"label": label, "overrides": plan.request.overrides, "forecast": plan.forecast}
                for label, plan in cases
            ]
        }
        outcome.show(lambda style: render_forecasts([(label, plan.forecast) for label, plan in cases], style))
        return
    outcome.seed = first_seed
    batch = _Batch(outcome, cases, tasks)
    batch.run()
    batch.write(table, figure)


def _check_files(table: Path | None, figure: Path | None) -> None:
    """Refuse output files that cannot be written, before hours of runs."""
    from edmctl.jobs.output_files import check_free

    if table is not None:
        if table.suffix.lower() != ".csv":
            raise failures.series_table_not_csv(table=table)
        check_free(table)
    if figure is not None:
        from edmctl.report.kinds import check_figure

        check_figure(figure.name)
        check_free(figure)


@app.callback(invoke_without_command=True)
@with_options_of(simulate)
def simulate_or_subcommand(context: typer.Context, **given: Any) -> int:
    """Run a job on many virtual machines, or what a subcommand says."""
    if context.invoked_subcommand is None:
        return simulate(**given)
    # Options of a job before a subcommand would be ignored.
    if ignored := list(options_given(context).values()):
        context.fail(f"{ignored[0]} stands before {context.invoked_subcommand!r}; options go after it")
    return 0


class _Batch:
    """All runs of a series, and the finished ones by the number of their task."""

    def __init__(self, outcome: Outcome, cases: "list[tuple[str, Plan]]", tasks: "list[Task]") -> None:
        self._outcome, self._cases, self._tasks = outcome, cases, tasks
        self._runs = len(tasks) // len(cases)
        self._done: dict[int, SimulatedRun] = {}

    def run(self) -> None:
        """Run everything. A stopped series reports its finished runs."""
        from edmctl.core.library import library
        from edmctl.jobs.batch import perform_all
        from edmctl.jobs.parallel import Program

        library()  # without a compiler there is nothing to report
        first, last = self._tasks[0].seed, self._tasks[-1].seed
        seeds = f"seed {first}" if first == last else f"seeds {first} to {last}"
        runs = plural(self._runs, "run")
        if len(self._cases) > 1:
            runs = f"{len(self._cases)} values with {runs} each"
        try:
            with watching(self._outcome.output) as reporter:
                reporter.note(f"simulating {runs}, {seeds}")
                perform_all(self._tasks, Program(shell, ignore_signals), reporter, self._done.__setitem__)
        finally:
            self._report()

    def _summaries(self) -> "list[Case]":
        from edmctl.jobs.batch import summarize

        summaries = []
        for number, (label, plan) in enumerate(self._cases):
            first = number * self._runs
            finished = [self._done[task] for task in range(first, first + self._runs) if task in self._done]
            if finished:
                summaries.append(summarize(label, plan.request.overrides, finished))
        return summaries

    def _report(self) -> None:
        from edmctl.cli.render.runs_tables import render_cases

        summaries = self._summaries()
        self._outcome.result = {"runs": self._runs, "finished": len(self._done), "cases": summaries}
        if summaries:
            self._outcome.show(lambda style: render_cases(summaries, style))
        if len(self._done) < len(self._tasks):
            self._outcome.show(f"{len(self._done)} of {plural(len(self._tasks), 'run')} finished.")

    def write(self, table: Path | None, figure: Path | None) -> None:
        """Write the files, and raise ObjectiveNotReached for runs that failed."""
        from edmctl.jobs import output_files
        from edmctl.jobs.batch import command_of, csv_of

        if table is not None:
            output_files.write(table, csv_of(self._summaries()))
            self._outcome.show(f"Table {table}")
        if figure is not None:
            from edmctl.report.figures.comparisons import draw_cases
            from edmctl.report.panels import house_style, rendered

            with house_style():
                drawn = rendered(draw_cases(self._summaries()), figure.suffix.lower())
            output_files.write(figure, drawn)
            self._outcome.show(f"Figure {figure}")
        failed = [number for number, run in sorted(self._done.items()) if not run.ok]
        if failed:
            (_, plan), first = self._cases[failed[0] // self._runs], self._done[failed[0]]
            raise failures.simulated_runs_failed(
                failed_count=len(failed),
                runs=plural(len(self._done), "run"),
                seed=first.seed,
                error=first.error,
                request=command_of(plan.request, first.seed),
            )
