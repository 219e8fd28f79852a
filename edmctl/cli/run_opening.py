"""Run files that a command goes by: complete ones, and live ones as far as they go."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

    from edmctl.record.reader import RunFile

_ENDINGS = (".partial", ".h5")


def open_unless_killed(path: Path) -> RunFile:
    """Open a run file that has an end, or whose writer lives.

    Raises RunFileError: E9005–E9007 it cannot be read, E9008 its writer was killed.
    """
    from edmctl.record.reader import open_run

    opened = open_run(path)
    try:
        unless_killed(opened)
    except BaseException:
        opened.close()
        raise
    return opened


def unless_killed(opened: RunFile) -> None:
    """Raise RunFileError E9008 where the writer of an open run file was killed."""
    from edmctl.record.liveness import interrupted, is_live

    if not opened.is_finished and not is_live(opened.path):
        raise interrupted(opened.path)


def plain_stem(path: Path) -> str:
    """Return the name of a run file without the endings that it has while it is written and after."""
    name = path.name
    for ending in _ENDINGS:
        name = name.removesuffix(ending)
    return name
