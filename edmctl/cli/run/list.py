"""`edmctl run list`: the runs of a folder in a table."""

import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from edmctl.cli.options import command
from edmctl.cli.outcome import Outcome, stream_style
from edmctl.errors import RunFileError, UsageError
from edmctl.jobs.runs.opening import RUNS, find_run
from edmctl.results.run_file import RunHead, Unreadable
from edmctl.wording import iso_of, utc_of

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
    """List the runs of a folder, and what became of them.

    The newest comes last: status, depth, wear and time of each.
    """
    _list(outcome, _only(folder, out))


def _only(folder: Path | None, out: Path | None) -> Path:
    """Return the folder that is meant. Raises UsageError E2063 where two are named."""
    if folder is not None and out is not None:
        raise UsageError(
            f"Two folders are named: {folder}, and {out} with --out.", hint="Leave one out.", code="E2063"
        )
    return folder or out or RUNS


def _list(outcome: Outcome, folder: Path) -> None:
    from edmctl.console.runs_tables import render_runs
    from edmctl.record.run_index import heads_of, read_head

    if folder == RUNS and not folder.exists():
        outcome.result = {"folder": str(folder), "runs": []}
        outcome.text = f"No runs yet: there is no folder {folder} here."
        return
    named = folder if folder.is_dir() else find_run(folder)
    if not named.exists():
        raise RunFileError(
            f"There is neither a folder nor a run {folder}.",
            hint="Give the folder that the runs were written to (--out), or the id of a run in runs/.",
            code="E9005",
        )
    found: list[RunHead | Unreadable] = list(heads_of(named)) if folder.is_dir() else [read_head(named)]
    found.sort(key=_since)
    outcome.result = {
        "folder": str(folder),
        "runs": [_as_mapping(head) for head in found],
    }
    outcome.text = render_runs(found, stream_style(sys.stdout)) if found else f"No run files in {folder}."


def _since(head: "RunHead | Unreadable") -> tuple[str, str]:
    """What the runs are sorted by: their start, of unreadable ones their last change."""
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
