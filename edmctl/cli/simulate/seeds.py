"""`edmctl simulate`: the same job on many virtual machines; its subcommands simulate other things."""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from edmctl import failures
from edmctl.cli import completion
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
    with_options_of,
)
from edmctl.cli.outcome import Outcome, watching
from edmctl.cli.signals import begin_worker, shell
from edmctl.cli.simulate.actuator import actuator
from edmctl.cli.simulate.serve import serve
from edmctl.errors import Diagnostic
from edmctl.jobs.sweep import MOST_RUNS, seed_to_use
from edmctl.wording import plural

if TYPE_CHECKING:
    from edmctl.jobs.batch import CheckedCase, SeriesRows, Task
    from edmctl.results.simulation import Case as Summary
    from edmctl.results.simulation import SimulatedRun

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
    first_seed = series.first_seed
    cases = cases_of(series.request, series.sweeps, series.runs, shell())
    outcome.uses(profile=cases[0].plan.loaded.path, setup=cases[0].plan.setup.file)
    outcome.warn(dict.fromkeys(warning for case in cases for warning in case.plan.loaded.warnings))
    if series.sweeps and series.runs == 1:
        outcome.warn([_one_machine(first_seed)])
    tasks = tasks_of(cases, first_seed, series.runs, out)
    if resume is None:
        check_names(tasks)
    if dry_run:
        told = [(case.label, case.request.overrides, case.plan.forecast) for case in cases]
        outcome.result = {
            "cases": [dict(zip(("label", "overrides", "forecast"), one, strict=True)) for one in told]
        }
        forecasts = [(label, forecast) for label, _, forecast in told]
        outcome.show(lambda style: render_forecasts(forecasts, style))
        return
    outcome.seed = first_seed
    if out is None:
        _simulate(outcome, cases, tasks, None, table, figure)
        return
    with SeriesRows(out) as rows:
        if resume is None:
            rows.refuse_begun(out)
            rows.begin(series)
        _simulate(outcome, cases, tasks, rows, table, figure)


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
    _refuse_options_before(context)
    return 0


def _refuse_options_before(context: typer.Context) -> None:
    """Refuse options of a job before a subcommand, which would ignore them."""
    given = [
        parameter.opts[0]
        for parameter in context.command.params
        if (source := context.get_parameter_source(parameter.name or "")) and source.name == "COMMANDLINE"
    ]
    if given:
        context.fail(f"{given[0]} stands before {context.invoked_subcommand!r}; options go after it")


def _one_machine(seed: int) -> Diagnostic:
    return failures.sweep_on_one_machine(seed=seed)


def _simulate(
    outcome: Outcome,
    cases: list["CheckedCase"],
    tasks: list["Task"],
    rows: "SeriesRows | None",
    table: Path | None,
    figure: Path | None,
) -> None:
    """Run everything. A stopped series reports its finished runs and keeps them in its folder."""
    from edmctl.jobs.batch import command_of, perform_all
    from edmctl.jobs.parallel import Program

    runs, first_seed = len(tasks) // len(cases), tasks[0].seed
    seeds = f"seed {first_seed}" if runs == 1 else f"seeds {first_seed} to {first_seed + runs - 1}"
    values = f"{len(cases)} values with " if len(cases) > 1 else ""
    done: dict[int, SimulatedRun] = rows.finished(tasks) if rows is not None else {}
    left = [number for number in range(len(tasks)) if number not in done]

    def keep(position: int, run: "SimulatedRun") -> None:
        number = left[position]
        if rows is not None:
            rows.keep(tasks[number], run)
        done[number] = run

    try:
        with watching(outcome.output) as reporter:
            there = f"; {plural(len(done), 'run')} of them are there" if done else ""
            reporter.note(
                f"simulating {values}{plural(runs, 'run')}{' each' if values else ''}, {seeds}{there}"
            )
            perform_all([tasks[number] for number in left], Program(shell, begin_worker), reporter, keep)
    finally:
        _tell(outcome, cases, runs, done, tasks[0].out)
    _write(outcome, cases, runs, done, table, figure)
    failed = [(cases[number // runs], done[number]) for number in sorted(done) if not done[number].ok]
    if failed:
        case, first = failed[0]
        raise failures.simulated_runs_failed(
            failed_count=len(failed),
            runs=plural(len(done), "run"),
            seed=first.seed,
            error=first.error,
            request=command_of(case.request, first.seed),
        )


def _summaries(cases: list["CheckedCase"], runs: int, done: "dict[int, SimulatedRun]") -> "list[Summary]":
    from edmctl.jobs.batch import summarize

    finished = [
        (case, [done[number] for number in range(first, first + runs) if number in done])
        for case, first in zip(cases, range(0, runs * len(cases), runs), strict=True)
    ]
    return [summarize(case.label, case.request.overrides, found) for case, found in finished if found]


def _tell(
    outcome: Outcome, cases: list["CheckedCase"], runs: int, done: "dict[int, SimulatedRun]", out: Path | None
) -> None:
    from edmctl.cli.render.runs_tables import render_cases

    summaries = _summaries(cases, runs, done)
    outcome.result = {"runs": runs, "finished": len(done), "cases": summaries}
    if summaries:
        outcome.show(lambda style: render_cases(summaries, style))
    if len(done) < runs * len(cases):
        way_on = (
            f"Go on with `edmctl simulate --resume {shlex.quote(str(out))}`."
            if out is not None
            else "With --out DIR a series could go on."
        )
        outcome.show(f"{len(done)} of {plural(runs * len(cases), 'run')} finished. {way_on}")


def _write(
    outcome: Outcome,
    cases: list["CheckedCase"],
    runs: int,
    done: "dict[int, SimulatedRun]",
    table: Path | None,
    figure: Path | None,
) -> None:
    from edmctl.jobs import output_files

    summaries = _summaries(cases, runs, done)
    if table is not None:
        from edmctl.jobs.batch import csv_of

        output_files.write(table, csv_of(summaries))
        outcome.show(f"Table {table}")
    if figure is not None:
        from edmctl.report.figures.sweep import draw_cases
        from edmctl.report.style import house_style, rendered

        with house_style():
            output_files.write(figure, rendered(draw_cases(summaries), figure.suffix.lower()))
        outcome.show(f"Figure {figure}")
