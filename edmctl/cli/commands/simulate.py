"""`edmctl simulate`: the same job on many virtual machines; its subcommands simulate other things."""

import shlex
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
    options_given,
    with_options_of,
)
from edmctl.cli.outcome import Outcome, watching
from edmctl.cli.signals import ignore_signals, shell
from edmctl.errors import Diagnostic
from edmctl.jobs.sweep import MOST_RUNS, seed_to_use
from edmctl.wording import plural

if TYPE_CHECKING:
    from edmctl.jobs.batch import CheckedCase, Series, SeriesRows, Task
    from edmctl.results.job import Case, SimulatedRun

app = typer.Typer(rich_markup_mode=None, add_completion=False, subcommand_metavar="[COMMAND ...]")
app.command("actuator")(actuator)
app.command("serve")(serve)

USUAL_RUNS = 10
RunsOption = Annotated[
    int | None,
    typer.Option(
        "--runs",
        "-n",
        metavar="N",
        min=1,
        max=MOST_RUNS,
        help=f"Number of runs, with seeds one apart. Default: {USUAL_RUNS}.",
    ),
]
SweepOption = Annotated[
    list[str] | None,
    typer.Option(
        "--sweep",
        metavar="KEY=START:STOP:COUNT",
        help="Make all runs for each of these values, or of a list, KEY=A,B,C. Repeatable: for all combinations.",
        autocompletion=completion.swept,
    ),
]
OutOption = Annotated[
    Path | None,
    typer.Option(
        "--out", metavar="DIR", help="Write a run file of each run, and rows to go on from. Default: none."
    ),
]
ResumeOption = Annotated[
    Path | None,
    typer.Option(
        "--resume", metavar="DIR", help="Go on with the series in this folder, as it was asked for."
    ),
]
TableOption = Annotated[
    Path | None, typer.Option("--table", metavar="FILE.csv", help="Write one row a case into a new file.")
]
FigureOption = Annotated[
    Path | None,
    typer.Option("--figure", metavar="FILE", help="Draw the cases into a new file: .png, .svg or .pdf."),
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
    resume: ResumeOption = None,
    table: TableOption = None,
    figure: FigureOption = None,
    dry_run: DryRunOption = False,
) -> None:
    """Run a job on many virtual machines.

    Reports the spread of depth, wear, time and measurement errors over the seeds. --resume continues an interrupted
    series that has a folder (--out). `simulate actuator` drives only the actuator of one machine.
    """
    from edmctl.cli.render.profile_tables import render_forecasts
    from edmctl.jobs.batch import Series, SeriesRows, cases_of, check_names, tasks_of
    from edmctl.jobs.plan import SIMULATOR, JobRequest

    outcome.simulated = True
    _check_files(table, figure)
    if resume is not None:
        asked = (profile, overrides, setup, runs, sweep, seed, controller, calibration, out)
        if any(value is not None for value in asked) or allow_model or dry_run:
            raise failures.resume_series_with_options()
        with SeriesRows(resume) as rows:
            series = rows.series(resume)
        out = resume
    else:
        changes = (*(overrides or ()), *controlled_by(controller))
        request = JobRequest(profile, changes, setup, SIMULATOR, calibration, allow_model)
        many = USUAL_RUNS if runs is None else runs
        series = Series(request, tuple(sweep or ()), many, seed_to_use(seed, many))
    cases = cases_of(series.request, series.sweeps, series.runs, shell())
    outcome.uses(profile=cases[0].plan.loaded.path, setup=cases[0].plan.setup.file)
    outcome.warn(dict.fromkeys(warning for case in cases for warning in case.plan.loaded.warnings))
    if series.sweeps and series.runs == 1:
        outcome.warn([_one_machine(series.first_seed)])
    tasks = tasks_of(cases, series.first_seed, series.runs, out)
    if resume is None:
        check_names(tasks)
    if dry_run:
        told = [(case.label, case.request.overrides, case.plan.forecast) for case in cases]
        outcome.result = {
            "cases": [dict(zip(("label", "overrides", "forecast"), one, strict=True)) for one in told]
        }
        outcome.show(lambda style: render_forecasts([(name, forecast) for name, _, forecast in told], style))
        return
    outcome.seed = series.first_seed
    batch = _Batch(outcome, series, cases, tasks)
    if out is None:
        batch.run(None)
    else:
        with SeriesRows(out) as rows:
            if resume is None:
                rows.refuse_begun(out)
                rows.begin(series)
            batch.run(rows)
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


def _one_machine(seed: int) -> Diagnostic:
    return failures.sweep_on_one_machine(seed=seed)


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
    """All runs of a series, and those that are done by the number of their task."""

    def __init__(
        self, outcome: Outcome, series: "Series", cases: "list[CheckedCase]", tasks: "list[Task]"
    ) -> None:
        self._outcome = outcome
        self._runs, self._first_seed = series.runs, series.first_seed
        self._cases = cases
        self._tasks = tasks
        self._done: dict[int, SimulatedRun] = {}

    def run(self, rows: "SeriesRows | None") -> None:
        """Run everything. A stopped series reports its finished runs and keeps them in its folder."""
        from edmctl.core.library import library
        from edmctl.jobs.batch import perform_all
        from edmctl.jobs.parallel import Program

        library()  # without a compiler there is nothing to report
        if rows is not None:
            self._done = rows.finished(self._tasks)
        left = [number for number in range(len(self._tasks)) if number not in self._done]

        def keep(position: int, run: "SimulatedRun") -> None:
            number = left[position]
            if rows is not None:
                rows.keep(self._tasks[number], run)
            self._done[number] = run

        try:
            with watching(self._outcome.output) as reporter:
                reporter.note(self._in_words())
                perform_all(
                    [self._tasks[number] for number in left], Program(shell, ignore_signals), reporter, keep
                )
        finally:
            self._report()

    def _in_words(self) -> str:
        seeds = f"seed {self._first_seed}"
        if self._runs > 1:
            seeds = f"seeds {self._first_seed} to {self._first_seed + self._runs - 1}"
        runs = plural(self._runs, "run")
        if len(self._cases) > 1:
            runs = f"{len(self._cases)} values with {runs} each"
        there = f"; {plural(len(self._done), 'run')} of them are there" if self._done else ""
        return f"simulating {runs}, {seeds}{there}"

    def _summaries(self) -> "list[Case]":
        from edmctl.jobs.batch import summarize

        found = []
        for first, case in zip(range(0, len(self._tasks), self._runs), self._cases, strict=True):
            finished = [
                self._done[number] for number in range(first, first + self._runs) if number in self._done
            ]
            if finished:
                found.append(summarize(case.label, case.request.overrides, finished))
        return found

    def _report(self) -> None:
        from edmctl.cli.render.runs_tables import render_cases

        summaries, out = self._summaries(), self._tasks[0].out
        self._outcome.result = {"runs": self._runs, "finished": len(self._done), "cases": summaries}
        if summaries:
            self._outcome.show(lambda style: render_cases(summaries, style))
        if len(self._done) < len(self._tasks):
            way_on = "With --out DIR a series could go on."
            if out is not None:
                way_on = f"Go on with `edmctl simulate --resume {shlex.quote(str(out))}`."
            self._outcome.show(f"{len(self._done)} of {plural(len(self._tasks), 'run')} finished. {way_on}")

    def write(self, table: Path | None, figure: Path | None) -> None:
        """Write the files, and raise ObjectiveNotReached for runs that failed."""
        from edmctl.jobs import output_files
        from edmctl.jobs.batch import command_of, csv_of

        if table is not None:
            output_files.write(table, csv_of(self._summaries()))
            self._outcome.show(f"Table {table}")
        if figure is not None:
            from edmctl.report.figures.runs import draw_cases
            from edmctl.report.style import house_style, rendered

            with house_style():
                drawn = rendered(draw_cases(self._summaries()), figure.suffix.lower())
            output_files.write(figure, drawn)
            self._outcome.show(f"Figure {figure}")
        done = self._done
        bad = [number for number in sorted(done) if not done[number].ok]
        if bad:
            case, first = self._cases[bad[0] // self._runs], done[bad[0]]
            raise failures.simulated_runs_failed(
                failed_count=len(bad),
                runs=plural(len(done), "run"),
                seed=first.seed,
                error=first.error,
                request=command_of(case.request, first.seed),
            )
