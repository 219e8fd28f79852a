"""`edmctl study`: designed experiments."""

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from edmctl import failures
from edmctl.cli import completion
from edmctl.cli.options import (
    NOTES,
    PROGRESS,
    NewToolOption,
    PortOption,
    WaitOption,
    argument,
    command,
    command_group,
    option,
)
from edmctl.cli.outcome import Outcome, stdout_sink, stream_style, tell, watching
from edmctl.cli.render.terminal import USUAL_COLUMNS, render_columns, wrapped
from edmctl.cli.signals import ignore_signals, shell
from edmctl.dataclasses import asdict, dataclass, replace
from edmctl.profile.folders import find_profile, find_study, shipped_studies
from edmctl.study.results import Judgement, PlannedRun, RunKind, RunState, StudyRun
from edmctl.wording import duration, plural, settings_words, shortened

if TYPE_CHECKING:
    from edmctl.cli.render.progress import Reporter
    from edmctl.jobs.plan import MachineAddress, Plan
    from edmctl.study.folder import StudyFolder, StudyState
    from edmctl.study.study_file import StudySource

app = command_group(
    "Plan, run and analyse designed experiments.\n\n"
    "A study file names factors, a design and responses. A folder contains the plan and a row of each run."
)


def _run_number(text: str) -> int:
    if not (text.isascii() and text.isdigit() and int(text) > 0):
        raise typer.BadParameter(f"{text!r} is no number of a run, such as 3")
    return int(text)


StudyArgument: TypeAlias = Annotated[
    str,
    argument(
        "FILE", "A study file (TOML), or the name of a shipped study.", autocompletion=completion.studies
    ),
]
FolderArgument: TypeAlias = Annotated[
    Path, argument("DIR", "The folder of a study, as `edmctl study run` made it.")
]
RunNumberArgument: TypeAlias = Annotated[int, argument("RUN", "Number of a run.", parser=_run_number)]
WorkersOption: TypeAlias = Annotated[
    int | None,
    option("--workers N", "Parallel processes. Default: as many as processors.", min=1, max=1024),
]
DaskOption: TypeAlias = Annotated[
    str | None, option("--dask ADDRESS", "Make the runs on the dask cluster of this scheduler.")
]
HomedOption: TypeAlias = Annotated[
    bool, option("--homed", "Confirm that the stages are where the restarted controller counts them.")
]
YesOption: TypeAlias = Annotated[bool, option("--yes", "Approve every run that the study wants approved.")]
StudyOutOption = Annotated[Path, option("--out DIR", "New folder of the study.")]
CountOption = Annotated[int, option("--count -n N", "How many suggestions.", min=1, max=64)]
AddOption = Annotated[bool, option("--add", "Add them to the study's runs, to be made by `resume`.")]
ConfirmRunsOption = Annotated[int, option("--runs -n N", "How many confirmation runs.", min=1, max=1000)]
PageOption = Annotated[
    Path | None, option("--out -o PAGE", "HTML page with all tables and figures. Default: none.")
]
TableOption = Annotated[Path | None, option("--out -o TABLE.csv", "CSV file. Default: stdout.")]
OverwriteOption = Annotated[bool, option("--overwrite", "Replace files of the same name.")]
ValuesArgument = Annotated[
    list[str], argument("NAME=VALUE...", "Manual responses of the run, e.g. ra_um=0.31.")
]
TableArgument = Annotated[Path, argument("TABLE.csv", "A column run, and one for each manual response.")]
JudgementArgument = Annotated[Judgement, argument("accept|reject|repeat", "Which it is.")]
ReasonArgument = Annotated[str, argument("REASON", "Kept with the run.")]


@dataclass(frozen=True, slots=True)
class Making:
    """How runs are made: on the machine at `port`, or on virtual ones by parallel workers or a cluster."""

    workers: WorkersOption = None
    dask: DaskOption = None
    port: PortOption = None
    wait: WaitOption = 0.0
    new_tool: NewToolOption = False
    homed: HomedOption = False
    yes: YesOption = False

    def machine(self, setup: Path | None, *, has_machine: bool) -> "MachineAddress":
        """Return the machine of the options; a fresh virtual one without a port.

        Raises UsageError E2103, E2108 for options that exclude each other, before anything is made.
        """
        from edmctl.jobs.plan import where_is
        from edmctl.profile.setup import load_setup

        machine = where_is(self.port, load_setup(setup), self.wait)
        if machine.lasting:
            if self.workers is not None or self.dask is not None:
                raise failures.workers_on_one_machine()
            if not has_machine:
                raise failures.study_without_machine()
        elif self.new_tool or self.homed:
            raise failures.machine_options_without_machine()
        if self.dask is not None and self.workers is not None:
            raise failures.workers_with_dask()
        return machine


@app.command("list")
@command("study list")
def list_studies(outcome: Outcome) -> None:
    """List the shipped studies."""
    from edmctl.study.study_file import read_study

    studies = []
    for name, path in shipped_studies().items():
        file = read_study(path).file
        texts = {"name": file.study.name, "description": file.study.description}
        studies.append({"study": name, **texts, "design": file.design.kind})
    outcome.result = {"studies": studies}
    rows = [[one["study"], one["design"], one["description"] or one["name"]] for one in studies]
    outcome.show(lambda style: render_columns(["study", "design", "question"], rows, style, "<"))


def study_source(outcome: Outcome, file: str) -> "StudySource":
    """Read a study file, and report which one and which profile it uses. Raises UsageError E2001, E2100."""
    from edmctl.study.planning import base_request
    from edmctl.study.study_file import read_study

    source = read_study(find_study(file))
    profile = base_request(source).profile
    assert profile is not None
    outcome.uses(study=source.path, profile=find_profile(profile))
    return source


def opened(folder: Path) -> "StudyFolder":
    """Open a study's folder. Raises UsageError E2101, PreconditionError E8202."""
    from edmctl.study.folder import open_folder  # loads numpy

    return open_folder(folder)


@app.command("plan")
@command("study plan", NOTES)
def plan(outcome: Outcome, file: StudyArgument) -> None:
    """Check a study and show its runs, their costs, and the effects that they can show.

    Every run is checked as a job is; nothing moves and nothing is written.
    """
    from edmctl.study.planning import plan_study
    from edmctl.study.table import render_plan

    planned = plan_study(study_source(outcome, file), shell())
    outcome.warn(planned.warnings)
    outcome.result = asdict(planned.plan)
    outcome.show(lambda style: render_plan(planned.plan, style))
    outcome.text = f"\nRun it: `edmctl study run {shlex.quote(file)} --out DIR`"


@app.command("run")
@command("study run", PROGRESS)
def run(outcome: Outcome, file: StudyArgument, making: Making, out: StudyOutOption) -> None:
    """Plan a study into a new folder, and make its runs.

    Each run has a virtual machine of its own, and runs are made in parallel. On a persistent machine (--port) they
    are made one after the other, each at the next free place.
    """
    from edmctl.study.folder import create_folder
    from edmctl.study.planning import base_request, plan_study

    source = study_source(outcome, file)
    making.machine(base_request(source).setup, has_machine=source.file.machine is not None)
    with watching(outcome.output) as reporter:
        planned = plan_study(source, shell())
        reporter.note(f"planned {plural(len(planned.plan.runs), 'run')} of {planned.plan.name}")
    outcome.warn(planned.warnings)
    _make(outcome, create_folder(out, planned), making)


@app.command("resume")
@command("study resume", PROGRESS)
def resume(outcome: Outcome, folder: FolderArgument, making: Making) -> None:
    """Continue a study: make its open runs, resume a hole that was interrupted."""
    from edmctl.study.folder import version_warning

    study = opened(folder)
    outcome.warn(version_warning(study))
    _make(outcome, study, making)


def _make(
    outcome: Outcome,
    study: "StudyFolder",
    making: Making,
    command: str = "resume",
    *,
    accept_failed: bool = False,
) -> None:
    """Make the open runs, and report the progress of the study.

    command : the one that continues it later

    Raises ObjectiveNotReached E7910 if a run failed, but not with `accept_failed`.
    """
    from edmctl.study.on_machine import MachineRuns, run_on_machine, without_port
    from edmctl.study.table import counts_of, in_words, what_next

    machine = _machine(study, making, command)
    try:
        with watching(outcome.output) as reporter:
            if machine.lasting:
                options = MachineRuns(
                    port=machine.selector,
                    surroundings=shell(),
                    approve=lambda run, plan: making.yes or _is_approved(run, plan),
                    warn=outcome.warn,
                    wait_s=making.wait,
                    new_tool=making.new_tool,
                    homed=making.homed,
                    command=command,
                )
                run_on_machine(study, options, reporter)
            else:
                outcome.simulated = True
                outcome.warn(without_port(study))
                _make_virtual(study, making, reporter)
    finally:
        state = study.read()
        outcome.result = {
            "folder": str(study.path),
            "study": study.plan.name,
            "runs": len(state.runs),
            "counts": counts_of(state.runs),
        }
        columns = stream_style(sys.stdout).columns or USUAL_COLUMNS
        texts = [f"{study.plan.name}: {in_words(state.runs)}.", *what_next(state, command)]
        outcome.text = "\n".join(line for text in texts for line in wrapped(text, columns, "  "))
    if not accept_failed:
        _raise_failed(study)


def _machine(study: "StudyFolder", making: Making, command: str) -> "MachineAddress":
    """Return where runs are made. Raises UsageError if the study is made elsewhere."""
    from edmctl.study.running import refuse_mixture

    machine = making.machine(study.base.setup, has_machine=study.source.file.machine is not None)
    refuse_mixture(study.read(), machine, command)
    return machine


def _make_virtual(study: "StudyFolder", making: Making, reporter: "Reporter") -> None:
    from edmctl.jobs.parallel import Program, cores, dask_pool, process_pool
    from edmctl.study.running import run_virtual

    if making.dask is not None:
        with dask_pool(making.dask) as pool:
            run_virtual(study, reporter, None, pool)
        return
    program = Program(shell, ignore_signals)
    workers = cores() if making.workers is None else making.workers
    run_virtual(study, reporter, program, process_pool(workers, program) if workers > 1 else None)


def _is_approved(run: StudyRun, plan: "Plan") -> bool:
    """Ask at a terminal; without one the run is not approved."""
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        return False
    settings = shortened(settings_words(run.planned.settings))
    time = duration(plan.forecast.time_s)
    sys.stderr.write(f"run {run.planned.number} ({run.planned.kind}): {settings}; takes {time}\n")
    sys.stderr.write("Make it? [y/N] ")
    sys.stderr.flush()
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def _raise_failed(study: "StudyFolder", kind: RunKind | None = None) -> None:
    failed = [
        run.row
        for run in study.read().runs
        if run.state is RunState.FAILED and run.row is not None and kind in (None, run.planned.kind)
    ]
    if failed:
        runs, judge = plural(len(failed), "run"), study.command("judge")
        raise failures.study_runs_failed(
            runs=runs, number=failed[0].number, error=failed[0].error, command=judge
        )


@app.command("status")
@command("study status")
def status(outcome: Outcome, folder: FolderArgument) -> None:
    """Show every run of a study with its responses, and what the study waits for."""
    from edmctl.study.folder import version_warning
    from edmctl.study.table import counts_of, missing_manual, render_status, table_of

    study = opened(folder)
    outcome.warn(version_warning(study))
    state = study.read()
    outcome.result = {
        "study": study.plan.name,
        "runs": len(state.runs),
        "counts": counts_of(state.runs),
        "missing": [{"run": number, "responses": list(names)} for number, names in missing_manual(state)],
        "torn_lines": state.rows.torn,
        "table": table_of(state),
    }
    outcome.show(lambda style: render_status(state, style))


@app.command("tell")
@command("study tell")
def tell_values(
    outcome: Outcome, folder: FolderArgument, run: RunNumberArgument, values: ValuesArgument
) -> None:
    """Report responses that were measured by hand, such as a roughness from a profilometer.

    A later value replaces an earlier one, and `NAME=none` withdraws it; all of them stay in the rows.
    """
    from edmctl.study.table import made_run, reported_values

    study = opened(folder)
    state = study.read()
    target, reported = made_run(state, run), reported_values(state, values)
    with study.writer() as writer:
        writer.told(target, reported)
    outcome.result = {"run": run, "told": reported}
    texts = (f"{name} {'is withdrawn' if v is None else f'= {v:g}'}" for name, v in reported.items())
    outcome.text = f"Run {run}: {', '.join(texts)}"


@app.command("import")
@command("study import")
def import_table(outcome: Outcome, folder: FolderArgument, table: TableArgument) -> None:
    """Report the manual responses of many runs by a CSV table: all of it or, if a line is wrong, nothing.

    Empty cells are skipped, and `none` withdraws a reported value.
    """
    from edmctl.study.table import reported_table

    study = opened(folder)
    state = study.read()
    reported = reported_table(state, table)
    with study.writer() as writer:
        for number, values in reported.items():
            writer.told(state.run(number), values)
    outcome.result = {"runs": len(reported), "told": {str(number): one for number, one in reported.items()}}
    outcome.text = f"Reported responses of {plural(len(reported), 'run')}."
    if withdrawn := [str(number) for number, values in reported.items() if None in values.values()]:
        outcome.text += f" Withdrawn: of {plural(len(withdrawn), 'run')}, {', '.join(withdrawn)}."


@app.command("judge")
@command("study judge")
def judge(
    outcome: Outcome,
    folder: FolderArgument,
    run: RunNumberArgument,
    judgement: JudgementArgument,
    reason: ReasonArgument,
) -> None:
    """Judge a run: accept one that failed, reject one that shall not count, or have it repeated.

    Nothing is deleted: the row stays, with the judgement and its reason.
    """
    from edmctl.study.on_machine import is_begun, next_order
    from edmctl.study.running import lost_row

    study = opened(folder)
    if not reason.strip():
        raise failures.judgement_without_reason()
    target = study.read().run(run)
    if target.row is None and judgement is Judgement.REPEAT and is_begun(study, target):
        with study.claimed(), study.writer() as writer:  # no other command is making it
            # The hole stays where it is, and the next attempt takes another place.
            lost = lost_row(target.planned, target.attempts + 1, f"E1300: abandoned: {reason}", 130)
            writer.run(replace(lost, order=next_order(study.read())))
        target = study.read().run(run)
    if target.row is None and judgement is not Judgement.REJECT:
        raise failures.judged_run_not_made(run=run, study=study.read().making_command())
    with study.writer() as writer:
        writer.judged(target, judgement, reason)
    outcome.result = {"run": run, "attempt": target.attempts, "judgement": str(judgement), "reason": reason}
    state = study.read()
    again = "as another hole at the next free place" if state.rows.port else "with the same result"
    effect = {
        Judgement.ACCEPT: "its responses count",
        Judgement.REJECT: "it does not count; the row stays",
        Judgement.REPEAT: f"`{state.making_command()}` makes it again, {again}",
    }
    outcome.text = f"Run {run}: {judgement} ({reason}); {effect[judgement]}."


@app.command("report")
@command("study report")
def report(
    outcome: Outcome, folder: FolderArgument, out: PageOption = None, overwrite: OverwriteOption = False
) -> None:
    """Show which factors matter, by analysis of variance, models and the Pareto front; --out writes a page."""
    from edmctl.jobs import output_files
    from edmctl.study.report import mapping_of, render_report, render_study_page, report_of

    found = report_of(opened(folder).read(), shell())
    outcome.result = mapping_of(found)
    outcome.show(lambda style: render_report(found, style))
    if out is not None:
        content = render_study_page(found, source=str(folder)).encode()
        output_files.make_folder(out.parent)
        hint = "Choose another name, or replace it with --overwrite."
        output_files.write(out, content, hint, overwrite=overwrite)
        outcome.text = f"\nPage {out}"


@app.command("suggest")
@command("study suggest", PROGRESS)
def suggest(outcome: Outcome, folder: FolderArgument, count: CountOption = 1, add: AddOption = False) -> None:
    """Suggest the runs that the models expect most of; --add puts them into the study."""
    from edmctl.study.suggestions import suggestions

    study = opened(folder)
    state = study.read()
    if add:
        suggested = study.add(lambda state: suggestions(state, count, shell()))
    else:  # writes nothing, not even a lock
        suggested = suggestions(state, count, shell())
    outcome.result = {"suggestions": suggested, "added": add}
    after = f"Make them: `{study.read().making_command()}`." if add else "Nothing was added; --add does."
    outcome.text = "\n".join([*(_suggestion(run, state) for run in suggested), after])


@app.command("extend")
@command("study extend")
def extend(outcome: Outcome, folder: FolderArgument) -> None:
    """Add one more replicate of the design, in a block of its own; `resume` makes the runs."""
    from edmctl.study.suggestions import extension_runs

    study = opened(folder)
    added = study.add(extension_runs)
    outcome.result = {"added": added}
    runs, make = plural(len(added), "run"), study.read().making_command()
    outcome.text = f"Added {runs}: a replicate of the design. Make them: `{make}`."


def _suggestion(run: PlannedRun, state: "StudyState", which: str = "") -> str:
    """Return a suggestion in one line; it names a tool's centre run, and a point that was run before."""
    if run.kind is not RunKind.SUGGESTED:
        which += f", a {run.kind} run"
    elif run.point in {one.planned.point for one in state.runs}:
        which += f", repeats point {run.point}"
    return f"run {run.number}{which}: {settings_words(run.settings)}"


@app.command("optimize")
@command("study optimize", PROGRESS)
def optimize(outcome: Outcome, folder: FolderArgument, making: Making) -> None:
    """Make runs where the models expect most, one after the other, up to the number in [optimize]; recommend one.

    The design comes first. Every suggestion is checked as a job is, and on a persistent machine approved.
    """
    from edmctl.study.analysis import has_suggestions
    from edmctl.study.report import render_recommendation
    from edmctl.study.suggestions import counted, next_batch, recommended

    study = opened(folder)
    total = study.source.file.optimize.runs
    while True:
        rows = len(study.read().rows.attempts)
        _make(outcome, study, making, "optimize", accept_failed=True)  # a failed run shows where runs fail
        if len(study.read().rows.attempts) > rows:  # the new tool is in use now
            making = replace(making, new_tool=False, homed=False)
        state = study.read()
        number = counted(state)
        if not (batch := study.add(lambda state: next_batch(state, shell()))):
            break
        for run in batch:
            is_counted = run.kind is RunKind.SUGGESTED
            number += is_counted
            tell(outcome.output, _suggestion(run, state, f", {number} of {total}" if is_counted else ""))
    best = recommended(study.read(), shell())
    assert isinstance(outcome.result, dict)
    outcome.result["recommendation"] = best
    outcome.text += f"\n\n{render_recommendation(study.plan, best, stream_style(sys.stdout))}\n"
    if not has_suggestions(study.read()):
        outcome.text += f"No run was suggested: the design has all of the {total} runs of [optimize].\n"
    command = study.read().making_command("confirm")
    outcome.text += f"Confirm it with runs that no model has seen: `{command}`."
    _raise_failed(study)


@app.command("confirm")
@command("study confirm", PROGRESS)
def confirm(outcome: Outcome, folder: FolderArgument, making: Making, runs: ConfirmRunsOption = 3) -> None:
    """Run the recommended settings anew, on machines no model has seen, and check the expectation."""
    from edmctl.study.report import render_confirmation, render_recommendation
    from edmctl.study.suggestions import confirmation_runs, confirmations_of, recommended

    study, style = opened(folder), stream_style(sys.stdout)
    _machine(study, making, "confirm")
    recommendation = ""
    with study.claimed("suggestions"), study.writer() as writer:
        state = study.read()
        confirming = [
            run.planned
            for run in state.runs
            if run.planned.kind is RunKind.CONFIRMATION and run.state is RunState.OPEN
        ]
        if confirming:
            tell(outcome.output, f"making the {plural(len(confirming), 'open confirmation run')}")
        else:
            best = recommended(state, shell())
            recommendation = f"{render_recommendation(study.plan, best, style)}\n\n"
            confirming = confirmation_runs(state, best.settings, runs)
            writer.planned(confirming, best.intervals)
    _make(outcome, study, making, "confirm", accept_failed=True)  # other runs that failed do not matter here
    confirmations = confirmations_of(study.read())
    assert isinstance(outcome.result, dict)
    outcome.result["confirmations"] = confirmations
    shown = (render_confirmation(study.plan, one, style) for one in confirmations)
    outcome.text = recommendation + "\n\n".join([outcome.text, *shown])
    numbers = {run.number for run in confirming}
    limits = [limit for one in confirmations if numbers.intersection(one.runs) for limit in one.limits]
    if broken := dict.fromkeys(str(limit.constraint) for limit in limits if not limit.is_kept):
        raise failures.recommendation_breaks_limits(
            broken=", ".join(broken), command=study.command("suggest", "--add")
        )
    _raise_failed(study, RunKind.CONFIRMATION)


@app.command("export")
@command("study export")
def export(
    outcome: Outcome, folder: FolderArgument, out: TableOption = None, overwrite: OverwriteOption = False
) -> None:
    """Write the table of runs as CSV: a column a factor key and response."""
    from edmctl.csv_text import table_text
    from edmctl.jobs import output_files
    from edmctl.jobs.runs.outputs import REPLACE_TABLE_HINT
    from edmctl.study.table import table_of

    state = opened(folder).read()
    content = table_text(table_of(state)).encode()
    if out is None:
        if outcome.output.json:
            raise failures.stdout_taken_by_json()
        with stdout_sink() as sink:
            sink.write(content)
        return
    if out.suffix.lower() != ".csv":
        raise failures.study_table_not_csv(out=out.name)
    output_files.write(out, content, REPLACE_TABLE_HINT, overwrite=overwrite)
    outcome.result = {"file": str(out), "rows": len(state.runs), "bytes": len(content)}
    outcome.text = f"{out}: {plural(len(state.runs), 'row')}"
