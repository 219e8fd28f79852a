"""`edmctl study run`, `resume`, `suggest`, `extend`, `optimize` and `confirm`: all that makes runs."""

import sys
import time
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from edmctl import failures
from edmctl.cli import completion
from edmctl.cli.options import (
    PROGRESS,
    ControllerOption,
    NewToolOption,
    PortOption,
    WaitOption,
    command,
    controlled_by,
)
from edmctl.cli.outcome import Outcome, stream_style, tell, watching
from edmctl.cli.render.progress import Reporter
from edmctl.cli.render.terminal import USUAL_COLUMNS, wrapped
from edmctl.cli.signals import ignore_signals, shell
from edmctl.dataclasses import dataclass, replace
from edmctl.profile.folders import find_profile, find_study
from edmctl.study.results import PlannedRun, RunKind, RunState, StudyRun
from edmctl.wording import duration, plural, settings_words, shortened

if TYPE_CHECKING:
    from edmctl.jobs.plan import MachineAddress, Plan
    from edmctl.study.folder import StudyFolder, StudyState
    from edmctl.study.study_file import StudySource

StudyArgument: TypeAlias = Annotated[
    str,
    typer.Argument(
        metavar="FILE",
        help="A study file (TOML), or the name of a shipped study.",
        autocompletion=completion.studies,
    ),
]
FolderArgument: TypeAlias = Annotated[
    Path, typer.Argument(metavar="DIR", help="The folder of a study, as `edmctl study run` made it.")
]


def _run_number(text: str) -> int:
    if not (text.isascii() and text.isdigit() and int(text) > 0):
        raise typer.BadParameter(f"{text!r} is no number of a run, such as 3")
    return int(text)


RunNumberArgument: TypeAlias = Annotated[
    int, typer.Argument(metavar="RUN", help="Number of a run.", parser=_run_number)
]
WorkersOption: TypeAlias = Annotated[
    int | None,
    typer.Option(
        "--workers",
        metavar="N",
        min=1,
        max=1024,
        help="Processes side by side. Default: as many as processors.",
    ),
]
DaskOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--dask", metavar="ADDRESS", help="Make the runs on a dask cluster whose scheduler is there."
    ),
]
HomedOption: TypeAlias = Annotated[
    bool,
    typer.Option("--homed", help="Confirm that the stages are where the restarted controller counts them."),
]
YesOption: TypeAlias = Annotated[
    bool, typer.Option("--yes", help="Approve every run that the study wants approved.")
]


@dataclass(frozen=True, slots=True)
class Making:
    """How runs are made: on the machine at `where`, or on virtual ones by so many workers or a cluster."""

    workers: WorkersOption = None
    dask: DaskOption = None
    port: PortOption = None
    wait: WaitOption = 0.0
    new_tool: NewToolOption = False
    homed: HomedOption = False
    yes: YesOption = False

    def refuse(self, setup: Path | None, *, has_machine: bool) -> None:
        """Refuse options that do not go together, before anything is made. Raises UsageError E2103, E2108."""
        if self.where(setup).lasting:
            if self.workers is not None or self.dask is not None:
                raise failures.workers_on_one_machine()
            if not has_machine:
                raise failures.study_without_machine()
        elif self.new_tool or self.homed:
            raise failures.machine_options_without_machine()
        if self.dask is not None and self.workers is not None:
            raise failures.workers_with_dask()

    def where(self, setup: Path | None) -> "MachineAddress":
        """Return the machine that is named; a fresh virtual one where none is."""
        from edmctl.jobs.plan import where_is
        from edmctl.profile.setup import load_setup

        return where_is(self.port, load_setup(setup), self.wait)


CHECKS_EVERY_S = 2.0
"""Interval of the notes on a long plan."""


def checks_told(note: "Callable[[str], None]") -> "Callable[[int, int], None]":
    """Return an observer of a plan that says now and then how many settings are checked."""
    due_s = time.monotonic() + CHECKS_EVERY_S

    def observe(done: int, total: int) -> None:
        nonlocal due_s
        if time.monotonic() >= due_s and done < total:
            due_s = time.monotonic() + CHECKS_EVERY_S
            note(f"checked {done} of {total} settings")

    return observe


def study_source(outcome: "Outcome", file: str) -> "StudySource":
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


OutOption = Annotated[Path, typer.Option("--out", metavar="DIR", help="New folder of the study.")]
CountOption = Annotated[
    int, typer.Option("--count", "-n", metavar="N", min=1, max=64, help="How many suggestions.")
]
AddOption = Annotated[
    bool, typer.Option("--add", help="Add them to the study's runs, to be made by `resume`.")
]
FoldOverOption = Annotated[
    bool,
    typer.Option("--fold-over", help="Exchange the two levels of every factor; else a replicate is added."),
]
ConfirmRunsOption = Annotated[
    int, typer.Option("--runs", "-n", metavar="N", min=1, max=1000, help="How many confirmation runs.")
]


@command("study run", PROGRESS)
def run(
    outcome: Outcome,
    file: StudyArgument,
    making: Making,
    out: OutOption,
    controller: ControllerOption = None,
) -> None:
    """Plan a study into a new folder, and make its runs.

    On virtual machines every run has one of its own, and they are made side by side. On a machine that lasts
    (--port) they are made one after the other, each at the next free place.
    """
    from edmctl.study.folder import create_folder
    from edmctl.study.planning import base_request, plan_study

    source = study_source(outcome, file)
    making.refuse(base_request(source).setup, has_machine=source.file.machine is not None)
    with watching(outcome.output) as reporter:
        changes = controlled_by(controller)
        planned = plan_study(source, shell(), checks_told(reporter.note), changes)
        reporter.note(f"planned {plural(len(planned.plan.runs), 'run')} of {planned.plan.name}")
    outcome.warn(planned.warnings)
    study = create_folder(out, planned)
    _make(outcome, study, making)


@command("study resume", PROGRESS)
def resume(outcome: Outcome, folder: FolderArgument, making: Making) -> None:
    """Go on with a study: make the runs that are left, resume a hole that was interrupted."""
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
    to_the_end: bool = False,
) -> None:
    """Make what is left, on one machine that lasts or on virtual ones, and tell how far the study is.

    command : the one that goes on where this one stops

    Raises ObjectiveNotReached E7910 where a run failed, but not `to_the_end`.
    """
    from edmctl.study.on_machine import without_port

    where = _where(study, making, command)
    try:
        with watching(outcome.output) as reporter:
            if where.lasting:
                _on_machine(outcome, study, where.selector, making, reporter, command)
            else:
                outcome.simulated = True
                outcome.warn(without_port(study))
                _virtual(study, making, reporter)
    finally:
        _tell(outcome, study, command)
    if not to_the_end:
        _raise_failed(study)


def _where(study: "StudyFolder", making: Making, command: str) -> "MachineAddress":
    """Return where runs are made. Raises UsageError where that is not where the study is made."""
    from edmctl.study.running import refuse_mixture

    setup = study.base.setup
    making.refuse(setup, has_machine=study.source.file.machine is not None)
    where = making.where(setup)
    refuse_mixture(study.read(), where, command)
    return where


def _virtual(study: "StudyFolder", making: Making, reporter: "Reporter") -> None:
    from edmctl.jobs.parallel import Program, cores, dask_pool, process_pool
    from edmctl.study.running import run_virtual

    if making.dask is not None:
        with dask_pool(making.dask) as pool:
            run_virtual(study, reporter, None, pool)
        return
    program = Program(shell, ignore_signals)
    many = cores() if making.workers is None else making.workers
    run_virtual(study, reporter, program, process_pool(many, program) if many > 1 else None)


def _on_machine(
    outcome: Outcome, study: "StudyFolder", port: str, making: Making, reporter: "Reporter", command: str
) -> None:
    from edmctl.study.on_machine import MachineRuns, run_on_machine

    def approve(run: "StudyRun", plan: "Plan") -> bool:
        return making.yes or _asked(run, plan)

    options = MachineRuns(
        port, shell(), approve, outcome.warn, making.wait, making.new_tool, making.homed, command=command
    )
    run_on_machine(study, options, reporter)


def _asked(run: "StudyRun", plan: "Plan") -> bool:
    """Ask at a terminal; without one the run is not approved."""
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        return False
    settings = shortened(settings_words(run.planned.settings))
    words = (
        f"run {run.planned.number} ({run.planned.kind}): {settings}; takes {duration(plan.forecast.time_s)}"
    )
    sys.stderr.write(f"{words}\nMake it? [y/N] ")
    sys.stderr.flush()
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def _tell(outcome: Outcome, study: "StudyFolder", command: str) -> None:
    from edmctl.study.table import counts_of, in_words, what_next

    state = study.read()
    outcome.result = {
        "folder": str(study.path),
        "study": study.plan.name,
        "runs": len(state.runs),
        "counts": counts_of(state.runs),
    }
    columns = stream_style(sys.stdout).columns or USUAL_COLUMNS
    told = [f"{study.plan.name}: {in_words(state.runs)}.", *what_next(state, command)]
    outcome.text = "\n".join(line for one in told for line in wrapped(one, columns, "  "))


def _raise_failed(study: "StudyFolder", kind: "RunKind | None" = None) -> None:
    failed = [
        run
        for run in study.read().runs
        if run.state is RunState.FAILED and run.row is not None and kind in (None, run.planned.kind)
    ]
    if failed:
        first = failed[0]
        assert first.row is not None
        raise failures.study_runs_failed(
            runs=plural(len(failed), "run"),
            number=first.planned.number,
            error=first.row.error,
            command=study.command("judge"),
        )


@command("study suggest", PROGRESS)
def suggest(outcome: Outcome, folder: FolderArgument, count: CountOption = 1, add: AddOption = False) -> None:
    """Suggest the runs that the models expect most of; --add puts them into the study."""
    from edmctl.study.suggestions import suggestions
    from edmctl.study.table import way_on

    study = opened(folder)
    with (
        study.claimed("suggestions") if add else nullcontext()
    ):  # who only looks writes nothing, not even a lock
        state = study.read()
        found = suggestions(state, count, shell())
        if add:
            with study.writer() as writer:
                writer.planned(found)
    outcome.result = {"suggestions": found, "added": add}
    words = [_suggested(one, state) for one in found]
    after = f"Make them: `{way_on(study.read())}`." if add else "Nothing was added; --add does."
    outcome.text = "\n".join([*words, after])


@command("study extend")
def extend(outcome: Outcome, folder: FolderArgument, fold_over: FoldOverOption = False) -> None:
    """Add one more replicate of the design, or its fold-over, in a block of its own; `resume` makes the runs."""
    from edmctl.study.suggestions import extension_runs
    from edmctl.study.table import way_on

    study = opened(folder)
    with study.claimed("suggestions"), study.writer() as writer:
        found = extension_runs(study.read(), shell(), is_folded=fold_over)
        writer.planned(found)
    outcome.result = {"added": found}
    what = "the fold-over" if fold_over else "a replicate"
    outcome.text = (
        f"Added {plural(len(found), 'run')}: {what} of the design. Make them: `{way_on(study.read())}`."
    )


def _suggested(run: "PlannedRun", state: "StudyState", which: str = "") -> str:
    """Return a suggestion in one line: a tool's centre run among them, and what was run before, are called so."""
    before = {one.planned.point for one in state.runs}
    if run.kind is not RunKind.SUGGESTED:
        which += f", a {run.kind} run"
    elif run.point in before:
        which += f", repeats point {run.point}"
    return f"run {run.number}{which}: {settings_words(run.settings)}"


@command("study optimize", PROGRESS)
def optimize(outcome: Outcome, folder: FolderArgument, making: Making) -> None:
    """Make runs where the models expect most, one after the other, up to the number in [optimize]; recommend one.

    The design comes first. Every suggestion is checked as a job is, and on a machine that lasts approved.
    """
    from edmctl.study.analysis import has_suggestions
    from edmctl.study.report import render_recommendation
    from edmctl.study.suggestions import counted, next_batch, recommended

    study = opened(folder)
    total = study.source.file.optimize.runs
    while True:
        rows = len(study.read().rows.attempts)
        _make(outcome, study, making, "optimize", to_the_end=True)  # a failed run tells where runs fail
        if len(study.read().rows.attempts) > rows:  # the new tool is in use now
            making = replace(making, new_tool=False, homed=False)
        with study.claimed("suggestions"), study.writer() as writer:
            state = study.read()
            batch, number = next_batch(state, shell()), counted(state)
            if not batch:
                break
            writer.planned(batch)
        for one in batch:
            number += one.kind is RunKind.SUGGESTED
            which = f", {number} of {total}" if one.kind is RunKind.SUGGESTED else ""
            tell(outcome.output, _suggested(one, state, which))
    best = recommended(study.read(), shell())
    assert isinstance(outcome.result, dict)
    outcome.result["recommendation"] = best
    style = stream_style(sys.stdout)
    way_on = f"Confirm it with runs that no model has seen: `{study.read().making_command('confirm')}`."
    if not has_suggestions(study.read()):
        way_on = f"No run was suggested: the design has all of the {total} runs of [optimize].\n{way_on}"
    outcome.text += f"\n\n{render_recommendation(study.plan, best, style)}\n{way_on}"
    _raise_failed(study)


@command("study confirm", PROGRESS)
def confirm(outcome: Outcome, folder: FolderArgument, making: Making, runs: ConfirmRunsOption = 3) -> None:
    """Run the recommended settings anew, on machines no model has seen, and say whether the expectation held."""
    from edmctl.study.report import render_confirmation, render_recommendation
    from edmctl.study.suggestions import confirmation_runs, confirmations_of, recommended
    from edmctl.study.table import not_yet_known

    study = opened(folder)
    _where(study, making, "confirm")
    told = ""
    with study.claimed("suggestions"), study.writer() as writer:
        state = study.read()
        asked = [
            run.planned
            for run in state.runs
            if run.planned.kind is RunKind.CONFIRMATION and run.state is RunState.OPEN
        ]
        if asked:
            tell(outcome.output, f"making the {plural(len(asked), 'confirmation run')} that were left")
        else:
            best = recommended(state, shell())
            told = f"{render_recommendation(study.plan, best, stream_style(sys.stdout))}\n\n"
            asked = confirmation_runs(state, best.settings, runs)
            writer.planned(asked, best.intervals)
    _make(outcome, study, making, "confirm", to_the_end=True)  # another run that failed before is no answer
    after = study.read()
    found = confirmations_of(after)
    assert isinstance(outcome.result, dict)
    outcome.result["confirmations"] = found
    style = stream_style(sys.stdout)
    shown = (render_confirmation(study.plan, one, style) for one in found)
    outcome.text = told + "\n\n".join([outcome.text, *shown])
    numbers = {run.number for run in asked}
    mine = [one for one in found if numbers.intersection(one.runs)]
    outcome.text += "".join(f"\n{line}" for line in not_yet_known(after, numbers))
    broken = dict.fromkeys(str(limit.constraint) for one in mine for limit in one.limits if not limit.is_kept)
    if broken:
        raise failures.recommendation_breaks_limits(
            broken=", ".join(broken), command=study.command("suggest", "--add")
        )
    _raise_failed(study, RunKind.CONFIRMATION)
