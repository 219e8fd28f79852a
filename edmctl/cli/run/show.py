"""`edmctl run list`, `show`, `explain`, `compare` and `recover`: run files on the terminal, and made complete."""

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from edmctl import failures
from edmctl.cli import completion
from edmctl.cli.options import PROGRESS, RunArgument, command
from edmctl.cli.outcome import Outcome, watching
from edmctl.cli.render.result_table import render_run, render_sentences
from edmctl.cli.render.runs_tables import letter, render_comparison, render_runs
from edmctl.errors import RunFileError
from edmctl.jobs.runs.opening import RUNS, command_to_go_on, find_run, reading_unless_killed, unless_killed
from edmctl.results.run_file import RunHead, Unreadable
from edmctl.wording import count, iso_of, utc_of

if TYPE_CHECKING:
    from edmctl.record.reader import RunFile

FollowOption = Annotated[
    bool, typer.Option("--follow", "-f", help="Follow a run until it ends; Ctrl-C ends the following.")
]
FolderArgument = Annotated[
    Path | None, typer.Argument(metavar="[FOLDER]", help=f"Folder of the run files. Default: {RUNS}.")
]
ListOutOption = Annotated[
    Path | None,
    typer.Option(
        "--out", metavar="DIR", help="The same folder, by the option of the commands that make runs."
    ),
]
FilesArgument = Annotated[
    list[Path],
    typer.Argument(
        metavar="RUN RUN...",
        help="Run files, or ids of runs in runs/. All are compared with the first.",
        autocompletion=completion.runs,
    ),
]
FigureOption = Annotated[
    Path | None,
    typer.Option("--out", "-o", metavar="FIGURE", help="Draw them too, into a new file: .png, .svg or .pdf."),
]
DamagedArgument = Annotated[
    Path,
    typer.Argument(
        metavar="RUN",
        help="A run file without an end (.h5.partial), or a damaged one; or the id of a run in runs/.",
        autocompletion=completion.unfinished,
    ),
]
NewFileOption = Annotated[
    Path | None,
    typer.Option(
        "--out", "-o", metavar="FILE", help="The new file. Default: RUN without .partial, beside it."
    ),
]


@command("run show", PROGRESS)
def show(outcome: Outcome, file: RunArgument, follow: FollowOption = False) -> None:
    """Show one run: target, results, times and contents of the file."""
    from edmctl.jobs.runs.summary import summary_of
    from edmctl.record.reader import reading

    path = find_run(file)
    killed: RunFileError | None = None
    if follow:
        from edmctl.jobs.runs.follow import follow_run

        try:
            with watching(outcome.output) as reporter:
                path = follow_run(path, reporter)
        except RunFileError as error:
            if error.code != "E9008":
                raise
            killed = error
    with reading(path) as opened:
        outcome.run_file = path
        summary = summary_of(opened)
        outcome.simulated, outcome.seed = summary.simulated, summary.seed
        outcome.result = summary.as_mapping()
        outcome.show(lambda style: render_run(summary, style))
        unless_killed(opened, summary.way_on)
    if killed is not None:
        raise killed


@command("run explain")
def explain(outcome: Outcome, file: RunArgument) -> None:
    """Describe a run in plain sentences: what it did, when, and why."""
    from edmctl.jobs.runs.explanation import sentences_of
    from edmctl.record.reader import reading

    with reading(find_run(file)) as opened:
        outcome.run_file = opened.path
        outcome.simulated = opened.is_simulated
        sentences = sentences_of(opened)
        outcome.result = {"story": sentences}
        outcome.show(lambda style: render_sentences(sentences, style))
        unless_killed(opened, command_to_go_on(opened.path))


@command("run list")
def list_runs(outcome: Outcome, folder: FolderArgument = None, out: ListOutOption = None) -> None:
    """List the runs of a folder: status, depth, wear and time of each, the newest last."""
    from edmctl.record.run_index import heads_of, read_head

    if folder is not None and out is not None:
        raise failures.two_folders_named(folder=folder, out=out)
    folder = folder or out or RUNS
    if folder == RUNS and not folder.exists():
        outcome.result = {"folder": str(folder), "runs": []}
        outcome.text = f"No runs yet: there is no folder {folder} here."
        return
    named = folder if folder.is_dir() else find_run(folder)
    if not named.exists():
        raise failures.folder_or_run_missing(folder=folder)
    found: list[RunHead | Unreadable] = list(heads_of(named)) if folder.is_dir() else [read_head(named)]
    found.sort(key=_since)
    outcome.result = {"folder": str(folder), "runs": [_as_mapping(head) for head in found]}
    if found:
        outcome.show(lambda style: render_runs(found, style))
    else:
        outcome.text = f"No run files in {folder}."


def _since(head: RunHead | Unreadable) -> tuple[str, str]:
    """Return the sort key: the start, or the last change of an unreadable file."""
    if isinstance(head, Unreadable):
        return iso_of(head.changed_s), head.path.name
    start = utc_of(head.start_time)
    return start.isoformat() if start else "", head.path.name


def _as_mapping(file: RunHead | Unreadable) -> dict[str, object]:
    if not isinstance(file, Unreadable):
        return {**asdict(file), "path": str(file.path), "error": None}
    return {
        "path": str(file.path),
        "size_bytes": file.size_bytes,
        "error": {"code": file.error.code, "message": file.error.message, "hint": file.error.hint},
    }


@command("run compare")
def compare(outcome: Outcome, files: FilesArgument, out: FigureOption = None) -> None:
    """Compare settings and results of runs.

    Marks differences larger than the uncertainty.
    """
    from edmctl.jobs import output_files
    from edmctl.report.comparison import compare as compared

    if len(files) < 2:
        raise failures.one_run_to_compare()
    if out is not None:
        from edmctl.report.kinds import check_figure

        check_figure(out.name)
        output_files.check_free(out)
    with ExitStack() as stack:
        runs = [stack.enter_context(reading_unless_killed(find_run(file))) for file in files]
        found = compared(runs)
        result: dict[str, object] = {
            **{key: getattr(found, key) for key in ("runs", "differs", "quantities", "sites")},
            "figure": None,
        }
        outcome.simulated = all(run.simulated for run in found.runs)
        outcome.result = result
        outcome.show(lambda style: render_comparison(found, style))
        if out is not None:
            output_files.write(out, _drawn(runs, out))
            result["figure"] = str(out)
            outcome.text = f"Figure {out}"


def _drawn(runs: "list[RunFile]", out: Path) -> bytes:
    from edmctl.report.figures.runs import draw_runs
    from edmctl.report.style import house_style, rendered

    with house_style():
        return rendered(draw_runs(runs, [letter(number) for number in range(len(runs))]), out.suffix.lower())


@command("run recover")
def recover(outcome: Outcome, file: DamagedArgument, out: NewFileOption = None) -> None:
    """Make a complete file of an interrupted run. The old file is not changed."""
    from edmctl.jobs.runs.opening import recover_file
    from edmctl.record.reader import open_run
    from edmctl.record.recovery import is_complete

    path = find_run(file)
    made = None if is_complete(path) else recover_file(path, out)
    outcome.run_file = made.path if made else path
    with open_run(outcome.run_file) as opened:
        outcome.simulated = opened.is_simulated
        status = opened.text("/entry/status")
    if made is None:
        outcome.result = {"recovered": False, "from": str(path)}
        outcome.text = f"{path} is complete: there is nothing to recover."
        return
    outcome.result = {
        "recovered": True,
        "from": str(path),
        "status": status,
        **{key: getattr(made, key) for key in ("rows", "lost_rows", "unread_rows")},
    }
    lost, unread = _counted(made.lost_rows), _counted(made.unread_rows)
    lines = [
        f"Recovered into {made.path}, status `{status}`.",
        f"Rows: {_counted(made.rows) or 'none'}.",
        f"Rows that were begun or cannot be read: {lost}." if made.lost_rows else "",
        f"Not readable, and NaN or 0 in the new file: {unread}." if made.unread_rows else "",
        f"{path} is as it was; it can be deleted when the new file is what you need.",
    ]
    outcome.text = "\n".join(filter(None, lines))


def _counted(rows: Mapping[str, int]) -> str:
    return ", ".join(
        f"{count(number)} of {table.removeprefix('/entry/').replace('_', ' ')}"
        for table, number in rows.items()
        if number
    )
