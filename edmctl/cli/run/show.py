"""`edmctl run list`, `show` and `explain`: the runs of a folder, one on a page, and in plain sentences."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from edmctl import failures
from edmctl.cli.options import PROGRESS, RunArgument, command
from edmctl.cli.outcome import Outcome, watching
from edmctl.errors import RunFileError
from edmctl.jobs.runs.opening import RUNS, command_to_go_on, find_run, unless_killed
from edmctl.results.run_file import RunHead, Unreadable
from edmctl.wording import iso_of, utc_of

FollowOption = Annotated[
    bool,
    typer.Option("--follow", "-f", help="Follow a run until it ends; Ctrl-C ends the following."),
]


@command("run show", PROGRESS)
def show(outcome: Outcome, file: RunArgument, follow: FollowOption = False) -> None:
    """Show one run: target, results, times and contents of the file."""
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
    _tell(outcome, path)
    if killed is not None:
        raise killed


def _tell(outcome: Outcome, path: Path) -> None:
    """Set the summary as the result. Raises RunFileError E9008 if the writer was killed."""
    from edmctl.cli.render.run_view import render_run
    from edmctl.jobs.runs.summary import summary_of
    from edmctl.record.reader import reading

    with reading(path) as opened:
        outcome.run_file = path
        summary = summary_of(opened)
        outcome.simulated, outcome.seed = summary.simulated, summary.seed
        outcome.result = summary.as_mapping()
        outcome.show(lambda style: render_run(summary, style))
        unless_killed(opened, summary.way_on)


@command("run explain")
def explain(outcome: Outcome, file: RunArgument) -> None:
    """Describe a run in plain sentences: what it did, when, and why."""
    from edmctl.cli.render.run_view import render_sentences
    from edmctl.jobs.runs.explanation import sentences_of
    from edmctl.record.reader import reading

    with reading(find_run(file)) as opened:
        outcome.run_file = opened.path
        outcome.simulated = opened.is_simulated
        sentences = sentences_of(opened)
        outcome.result = {"story": sentences}
        outcome.show(lambda style: render_sentences(sentences, style))
        unless_killed(opened, command_to_go_on(opened.path))


FolderArgument = Annotated[
    Path | None, typer.Argument(metavar="[FOLDER]", help=f"Folder of the run files. Default: {RUNS}.")
]
OutOption = Annotated[
    Path | None,
    typer.Option(
        "--out", metavar="DIR", help="The same folder, by the option of the commands that make runs."
    ),
]


@command("run list")
def list_runs(outcome: Outcome, folder: FolderArgument = None, out: OutOption = None) -> None:
    """List the runs of a folder: status, depth, wear and time of each, the newest last."""
    _list(outcome, _only(folder, out))


def _only(folder: Path | None, out: Path | None) -> Path:
    """Return the folder. Raises UsageError E2063 if two are named."""
    if folder is not None and out is not None:
        raise failures.two_folders_named(folder=folder, out=out)
    return folder or out or RUNS


def _list(outcome: Outcome, folder: Path) -> None:
    from edmctl.cli.render.runs_tables import render_runs
    from edmctl.record.run_index import heads_of, read_head

    if folder == RUNS and not folder.exists():
        outcome.result = {"folder": str(folder), "runs": []}
        outcome.text = f"No runs yet: there is no folder {folder} here."
        return
    named = folder if folder.is_dir() else find_run(folder)
    if not named.exists():
        raise failures.folder_or_run_missing(folder=folder)
    found: list[RunHead | Unreadable] = list(heads_of(named)) if folder.is_dir() else [read_head(named)]
    found.sort(key=_since)
    outcome.result = {
        "folder": str(folder),
        "runs": [_as_mapping(head) for head in found],
    }
    if found:
        outcome.show(lambda style: render_runs(found, style))
    else:
        outcome.text = f"No run files in {folder}."


def _since(head: "RunHead | Unreadable") -> tuple[str, str]:
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
