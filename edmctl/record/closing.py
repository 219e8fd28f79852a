"""Gives a complete `.partial` file its name: compressed and sealed where the disk has room for that."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.errors import RunFileError
from edmctl.record.compaction import compact
from edmctl.record.disk import HDF5_ERRORS, cannot_name, rename_without_replacing
from edmctl.record.hdf5 import open_hdf5

if TYPE_CHECKING:
    from pathlib import Path

CLOSING = ".closing"
"""Ending of the compressed copy while it is written; whoever dies then leaves the `.partial` file as it was."""


def close_run(partial: Path, path: Path) -> None:
    """Make `path` of the complete and closed file `partial`; a file of that name is never replaced.

    Raises RunFileError E9004 when the name is taken or cannot be given; then `partial` stays.
    """
    closing = path.with_name(path.name + CLOSING)
    try:
        closing.unlink(missing_ok=True)
        # Every chunk is read once: a cache would keep up to 8 MB of each dataset.
        with open_hdf5(partial, rdcc_nbytes=0) as source:
            compact(source, closing)
    except HDF5_ERRORS:
        # Better large than lost: the disk may not have room for a second file.
        rename_without_replacing(partial, path)
        return
    try:
        rename_without_replacing(closing, path)
    except RunFileError as error:
        closing.unlink(missing_ok=True)
        raise cannot_name(partial, path, error.__cause__ or error) from error
    partial.unlink(missing_ok=True)
