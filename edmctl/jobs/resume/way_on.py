"""How a run that was interrupted goes on: the command that a person may give."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING

from edmctl.errors import EdmError
from edmctl.jobs.run_opening import RUNS, plain_stem

if TYPE_CHECKING:
    from pathlib import Path

    from edmctl.jobs.plan import Resumption


def command_to_go_on(run_file: Path) -> str:
    """Return the command that takes up the job of a run file; empty where it is done, goes on, or has to stay.

    It names the machine as the run did.
    """
    from edmctl.jobs.resume.selection import checked, find_run

    try:
        resumption = find_run(str(run_file), run_file.parent)
        if _is_live(resumption):
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


def _is_live(resumption: Resumption) -> bool:
    from edmctl.record.disk import partial_path
    from edmctl.record.journal import SUFFIX
    from edmctl.record.locks import is_live

    journal = resumption.path
    partial = partial_path(journal.with_name(f"{journal.name.removesuffix(SUFFIX)}.h5"))
    return partial.exists() and is_live(partial)
