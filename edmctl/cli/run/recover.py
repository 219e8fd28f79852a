"""`edmctl run recover`: a complete file of a run that was interrupted, or whose file was damaged."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from edmctl.cli import completion
from edmctl.cli.options import command
from edmctl.cli.outcome import Outcome
from edmctl.jobs.runs.opening import find_run

if TYPE_CHECKING:
    from edmctl.record.recovery import Recovered

FileArgument = Annotated[
    Path,
    typer.Argument(
        metavar="RUN",
        help="A run file without an end (.h5.partial), or a damaged one; or the id of a run in runs/.",
        autocompletion=completion.unfinished,
    ),
]
OutOption = Annotated[
    Path | None,
    typer.Option(
        "--out", "-o", metavar="FILE", help="The new file. Default: RUN without .partial, beside it."
    ),
]


@command("run recover")
def recover(outcome: Outcome, file: FileArgument, out: OutOption = None) -> None:
    """Make a complete file of an interrupted run. The old file is not changed."""
    from edmctl.jobs.runs.opening import recover_file
    from edmctl.record.reader import open_run
    from edmctl.record.recovery import is_complete

    path = find_run(file)
    if is_complete(path):
        with open_run(path) as opened:
            outcome.simulated = opened.is_simulated
        outcome.run_file = path
        outcome.result = {"recovered": False, "from": str(path)}
        outcome.text = f"{path} is complete: there is nothing to recover."
        return
    made = recover_file(path, out)
    with open_run(made.path) as opened:
        outcome.simulated = opened.is_simulated
        status = opened.text("/entry/status")
    outcome.run_file = made.path
    outcome.result = {
        "recovered": True,
        "from": str(path),
        "status": status,
        "rows": made.rows,
        "lost_rows": made.lost_rows,
        "unread_rows": made.unread_rows,
    }
    outcome.text = recovery_message(path, made, status)


def recovery_message(file: Path, made: "Recovered", status: str) -> str:
    """What was recovered, for people."""
    lines = [
        f"Recovered into {made.path}, status `{status}`.",
        f"Rows: {_counted(made.rows) or 'none'}.",
        f"Rows that were begun or cannot be read: {_counted(made.lost_rows)}." if made.lost_rows else "",
        f"Not readable, and NaN or 0 in the new file: {_counted(made.unread_rows)}."
        if made.unread_rows
        else "",
        f"{file} is as it was; it can be deleted when the new file is what you need.",
    ]
    return "\n".join(filter(None, lines))


def _counted(rows: "Mapping[str, int]") -> str:
    return ", ".join(
        f"{count:,} of {_short(path)}".replace(",", " ") for path, count in rows.items() if count
    )


def _short(table: str) -> str:
    return table.removeprefix("/entry/").replace("_", " ")
