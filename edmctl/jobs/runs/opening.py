"""Find run files by path or id, complete or live, and the command that resumes an interrupted run."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from edmctl import failures
from edmctl.errors import Diagnostic, EdmError, RunFileError
from edmctl.record.disk import is_live, partial_path

if TYPE_CHECKING:
    from edmctl.jobs.plan import Resumption
    from edmctl.record.reader import RunFile
    from edmctl.record.recovery import Recovered

RUNS = Path("runs")
"""Where runs are looked for by their ids."""
_COMPLETE, _PARTIAL = ".h5", ".partial"


def find_run(named: Path) -> Path:
    """Return a run file: by a path, with or without its endings, or by the id of a run in `RUNS`.

    A name with an ending of run files is a path. A name that is not found is returned unchanged, so that opening it
    reports it.
    """
    from edmctl.record.reader import present_name

    if named.name.endswith((_COMPLETE, _PARTIAL)):
        return present_name(named)
    folder = RUNS if named.name == str(named) else named.parent
    with_ending = present_name(folder / f"{named.name}{_COMPLETE}")
    return with_ending if with_ending.is_file() else named


@contextmanager
def reading_unless_killed(path: Path) -> Iterator[RunFile]:
    """Open a run file that is finished or whose writer lives, for a `with` block."""
    from edmctl.record.reader import reading

    with reading(path) as opened:
        unless_killed(opened)
        yield opened


def unless_killed(opened: RunFile, command: str = "") -> None:
    """Raise RunFileError E9008 if the writer of an open run file was killed.

    command : resumes its job, which also completes the file; empty if that is impossible
    """
    if not opened.is_finished and not is_live(opened.path):
        error = failures.run_file_without_end(path=opened.path)
        if command:
            error.hint = f"Go on with `{command}`."
        raise error


def plain_stem(path: Path) -> str:
    """Return the name of a run file without the endings that it has while it is written and after."""
    return path.name.removesuffix(_PARTIAL).removesuffix(_COMPLETE)


def command_to_go_on(run_file: Path) -> str:
    """Return the command that resumes the job of a run file; empty if the job is done, running or cannot be resumed.

    It names the machine as the run did.
    """
    from edmctl.jobs.resume import checked, find_run

    try:
        resumption = find_run(str(run_file), run_file.parent)
        if is_live(partial_path(resumption.path.with_suffix(".h5"))):
            return ""
        checked(resumption, resumption.job.port, 0.0)
    except (EdmError, OSError):
        return ""
    return resume_command(run_file, resumption.job.port)


def resume_command(run_file: Path, port: str) -> str:
    """Return `edmctl machine --resume RUN --port PORT` for a run file that may have its endings or not."""
    run = plain_stem(run_file) if run_file.parent == RUNS else str(run_file.with_name(plain_stem(run_file)))
    return on_machine(f"edmctl machine --resume {shlex.quote(run)}", port)


def on_machine(command: str, port: str) -> str:
    """Return a command as it is typed for the machine at `port`; empty is the one that needs no name."""
    return f"{command} --port {shlex.quote(port)}" if port else command


def recover_file(file: Path, out: Path | None = None) -> Recovered:
    """Recover `file`, and save the readable part of a damaged one. Raises RunFileError."""
    from edmctl.record.recovery import recover as recover_whole
    from edmctl.record.recovery import recover_damaged

    try:
        return recover_whole(file, out)
    except RunFileError as error:
        if error.code != "E9007":
            raise
        return recover_damaged(file, out)


def recovered_before(resumption: Resumption) -> list[Diagnostic]:
    """Recover the file of the run that is resumed, if it has no end; return a warning if that fails.

    The job uses its journal, so it does not depend on this.
    """
    path = resumption.path.with_name(f"{resumption.job.run_id}.h5")
    partial = partial_path(path)
    try:
        if path.exists() or not partial.exists() or is_live(partial):
            return []
        recover_file(partial)
    except (RunFileError, OSError) as error:
        message = error.message if isinstance(error, RunFileError) else str(error)
        return [failures.earlier_run_not_recovered(message=message, partial=partial)]
    return []
