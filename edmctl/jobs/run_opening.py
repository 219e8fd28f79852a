"""Run files that a command goes by: found by path or by the id of a run, complete, or live as far as they go."""

from __future__ import annotations

from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

    from edmctl.record.reader import RunFile

RUNS = Path("runs")
"""Where runs are looked for by their ids."""
_COMPLETE, _PARTIAL = ".h5", ".partial"


def find_run(named: Path) -> Path:
    """Return the run file that is meant: one at that path, with or without its endings, or the run of that id.

    What is not found is returned as it was named, so that opening it says so.
    """
    from edmctl.record.reader import present_name

    at_path = present_name(named)
    if at_path.is_file() or (named.name.endswith((_COMPLETE, _PARTIAL)) and named.name != str(named)):
        return at_path
    if named.name != str(named):
        with_ending = present_name(named.with_name(f"{named.name}{_COMPLETE}"))
        return with_ending if with_ending.is_file() else at_path
    file_name = named.name if named.name.endswith((_COMPLETE, _PARTIAL)) else f"{named.name}{_COMPLETE}"
    of_id = present_name(RUNS / file_name)
    return of_id if of_id.is_file() else named


@contextmanager
def reading_unless_killed(path: Path) -> Iterator[RunFile]:
    """Open a run file that has an end, or whose writer lives, for a `with` block that works on what is in it.

    Raises RunFileError: E9005–E9007 it cannot be read, E9008 its writer was killed.
    """
    from edmctl.record.reader import reading

    with reading(path) as opened:
        unless_killed(opened)
        yield opened


def unless_killed(opened: RunFile, command: str = "") -> None:
    """Raise RunFileError E9008 where the writer of an open run file was killed.

    command : how its job goes on, if it does; the run file becomes whole by that as well.
    """
    from edmctl.record.locks import interrupted, is_live

    if not opened.is_finished and not is_live(opened.path):
        error = interrupted(opened.path)
        if command:
            error.hint = f"Go on with `{command}`."
        raise error


def plain_stem(path: Path) -> str:
    """Return the name of a run file without the endings that it has while it is written and after."""
    return path.name.removesuffix(_PARTIAL).removesuffix(_COMPLETE)
