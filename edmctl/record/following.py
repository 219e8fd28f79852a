"""Follows a run file that another process writes: look, wait, look again, until it has an end or its writer died."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.record.closing import CLOSING
from edmctl.record.disk import PARTIAL, partial_path
from edmctl.record.liveness import interrupted, is_live
from edmctl.record.safe_reading import reading

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from edmctl.record.reader import RunFile

LONGEST_CLOSING_LOOKS = 240
"""How often to look for the final name of a file that is being compressed."""


def present_name(path: Path) -> Path:
    """Return what a run file is called now: with `.partial` until it is finished, without after.

    The name is returned as it is where there is neither.
    """
    if path.exists():
        return path
    other = path.with_suffix("") if path.suffix == PARTIAL else partial_path(path)
    return other if other.exists() else path


def follow(path: Path, pause: Callable[[], None]) -> Iterator[RunFile]:
    """Yield the run file at `path`, again after each `pause`, with what its writer has added, until it has an end.

    The last one yielded has the end in it. A file that is finished is yielded once. Raises RunFileError: E9008 its
    writer died, else as `open_run`.
    """
    with reading(path) as run:
        while True:
            # Asked first: rows that were flushed between the two are seen, however the writer ended.
            lives = _lives(path)
            if not run.is_finished:
                run.refresh()
            yield run
            if run.is_finished or (not lives and not path.exists()):
                return
            if not lives:
                raise interrupted(path)
            pause()


def final_name(path: Path, pause: Callable[[], None]) -> Path:
    """Return the name that the run file at `path` has got at its end; wait while it is being compressed."""
    if path.suffix != PARTIAL:
        return path
    complete = path.with_suffix("")
    closing = complete.with_name(complete.name + CLOSING)
    for _ in range(LONGEST_CLOSING_LOOKS):
        if complete.exists() or not closing.exists():
            break
        pause()
    return complete if complete.exists() else path


def _lives(path: Path) -> bool:
    try:
        return is_live(path)
    except OSError:
        return False
