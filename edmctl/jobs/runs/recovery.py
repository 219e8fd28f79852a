"""Run files without an end, or damaged: recovered as far as they can be read."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from edmctl.errors import Diagnostic, RunFileError
from edmctl.record.disk import partial_path
from edmctl.record.locks import is_live

if TYPE_CHECKING:
    from edmctl.jobs.plan import Resumption
    from edmctl.record.recovery import Recovered


def recover_file(file: Path, out: Path | None = None) -> Recovered:
    """Recover `file`, and save what can be read where it is damaged. Raises RunFileError."""
    from edmctl.record.damaged_file_recovery import recover_damaged
    from edmctl.record.recovery import recover as recover_whole

    try:
        return recover_whole(file, out)
    except RunFileError as error:
        if error.code != "E9007":
            raise
        return recover_damaged(file, out)


def recovered_before(resumption: Resumption) -> list[Diagnostic]:
    """Recover the file of the run that is taken up, where it has no end; what hinders that is a warning.

    The job goes by its journal, so it does not depend on this.
    """
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
