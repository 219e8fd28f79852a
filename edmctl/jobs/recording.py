"""The run file of a command: its summary, status and end are written however the command ends."""

from __future__ import annotations

from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from edmctl.errors import EdmError, RunFileError
from edmctl.exitcodes import MEANING, ExitCode, error_exit_code
from edmctl.jsonout import render_json
from edmctl.labels import NOT_SHOWN_CODE, Verdict
from edmctl.record.rows import Summary

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    from edmctl.jobs.run_header import RunName
    from edmctl.record.rows import Recorder
    from edmctl.record.run_meta import RunMeta


@contextmanager
def recorded(
    name: RunName | None,
    meta: Callable[[RunName], RunMeta],
    summary: Callable[[], Mapping[str, object]],
    written: Callable[[Path | None], None],
    *,
    waits: bool,
) -> Iterator[Recorder]:
    """Record into the file `name`, into none where it is None.

    `meta` describes the run before its first row, `summary` is its result in the end, and `written` is told what the
    file is called then. `waits` says that the machine's time stands still while a slow disk is waited for.
    """
    if name is None:
        from edmctl.record.rows import NullRecorder

        yield NullRecorder()
        return
    from edmctl.record.background import BackgroundWriter

    def summarize() -> None:
        writer.append(Summary(render_json(summary())))

    writer = BackgroundWriter.create(name.path, meta(name), waits=waits)
    try:
        yield writer
    except BaseException as error:
        with suppress(RunFileError):
            summarize()
        written(writer.abandon(*ending(error)))
        raise
    try:
        summarize()
        written(writer.finish("done", 0))
    except RunFileError:
        # The final name may be another run's now.
        written(name.partial if name.partial.exists() else None)
        raise


def ending(error: BaseException) -> tuple[str, int]:
    """Status and exit code of a run file whose command ended with `error`."""
    if not isinstance(error, EdmError):
        return "internal error", int(ExitCode.INTERNAL)
    code = error_exit_code(error)
    if error.code == NOT_SHOWN_CODE:
        return Verdict.NOT_SHOWN.value, code
    return MEANING[ExitCode(code)].partition(" (")[0], code
