"""Reading a run file that may hold anything: whatever goes wrong with a file that is not sealed is its own fault."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

from edmctl.errors import EdmError
from edmctl.record.checksum import Seal, look_at_seal
from edmctl.record.opening import damaged, open_file
from edmctl.record.reader import RunFile, open_run

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


@contextmanager
def reading(path: Path) -> Iterator[RunFile]:
    """Open the run file at `path` for a `with` block that works on what is in it.

    A file without a fitting check sum may hold anything: texts that are none, rows of another form, places that lead
    nowhere. What that brings about in the block becomes RunFileError E9007; with a file that is whole it is a bug,
    and stays as it is. Raises RunFileError as `open_run`.
    """
    with _blamed(path), open_run(path) as run:
        yield run


@contextmanager
def reading_unverified(path: Path) -> Iterator[RunFile]:
    """Do as `reading`, without comparing the check sum first: that takes reading the whole file."""
    with _blamed(path), RunFile(open_file(path, verify=False), path) as run:
        yield run


@contextmanager
def _blamed(path: Path) -> Iterator[None]:
    try:
        yield
    except EdmError:
        raise
    except Exception as error:
        if _is_whole(path):
            raise
        why = next(iter(str(error).splitlines()), "") or type(error).__name__
        raise damaged(path, why.rstrip(".")) from error


def _is_whole(path: Path) -> bool:
    try:
        return look_at_seal(path) is Seal.WHOLE
    except OSError:
        return False
