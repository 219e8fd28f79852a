"""`edmctl run recover`: a complete file of a run that was interrupted, or whose file was damaged."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from edmctl.cli import completion
from edmctl.cli.options import DebugOption, JsonOption
from edmctl.cli.outcome import Outcome, Output, run_command
from edmctl.errors import Diagnostic, RunFileError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from edmctl.jobs.plan import Resumption
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
    typer.Option("--out", "-o", metavar="FILE", help="The new file; else RUN without .partial, beside it."),
]


def recover(
    file: FileArgument,
    out: OutOption = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> int:
    """Make a complete file of a run that was interrupted. The old file stays as it is."""

    def body(outcome: Outcome) -> None:
        from edmctl.jobs.run_opening import find_run
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
        outcome.text = told(path, made, status)

    return run_command(Output("run recover", as_json, debug=debug), body)


def recover_file(file: Path, out: Path | None = None) -> "Recovered":
    """Recover `file`, and save what can be read where it is damaged. Raises RunFileError."""
    from edmctl.record.damaged_file_recovery import recover_damaged
    from edmctl.record.recovery import recover as recover_whole

    try:
        return recover_whole(file, out)
    except RunFileError as error:
        if error.code != "E9007":
            raise
        return recover_damaged(file, out)


def told(file: Path, made: "Recovered", status: str) -> str:
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


def recovered_before(resumption: "Resumption") -> list[Diagnostic]:
    """Recover the file of the run that is taken up, where it has no end; what hinders that is a warning.

    The job goes by its journal, so it does not depend on this.
    """
    from edmctl.record.disk import partial_path
    from edmctl.record.locks import is_live

    path = resumption.path.with_name(f"{resumption.job.run_id}.h5")
    partial = partial_path(path)
    try:
        if path.exists() or not partial.exists() or is_live(partial):
            return []
        recover_file(partial)
    except (RunFileError, OSError) as error:
        message = error.message if isinstance(error, RunFileError) else str(error)
        return [
            Diagnostic(
                "W9001",
                f"The file of the run before could not be recovered: {message}",
                f"The job goes on all the same. Try `edmctl run recover {partial}` later.",
                is_warning=True,
            )
        ]
    return []
