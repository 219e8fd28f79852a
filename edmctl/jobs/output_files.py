"""Output files of commands: an existing file is not replaced unless requested."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from edmctl import failures
from edmctl.errors import EdmError, RunFileError
from edmctl.record.disk import make_folder as make

_ANOTHER = "Choose another name."
LONGEST_NAME = 200
"""Bytes; a file system takes 255, and a file that is being written has a longer name."""


def check_free(path: Path, hint: str = _ANOTHER) -> None:
    """Raise RunFileError E9011 when there is something of that name."""
    if path.exists():
        raise failures.output_exists(path=path, remedy=hint)


def check_new(path: Path) -> None:
    """Refuse a calibration file that exists (RunFileError E9011) or could not be written (E9012)."""
    _check_name(path)
    check_free(path)
    check_writable(path)


def check_writable(path: Path) -> None:
    """Refuse (RunFileError E9012) a calibration file that could not be written, by the nearest existing folder."""
    _check_name(path)
    folder = next(parent for parent in path.absolute().parents if parent.exists())
    if path.is_dir() or not (folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)):
        why = "is a folder" if path.is_dir() else f"{folder} is no folder that can be written"
        raise unwritable(f"the calibration file {path}", why, "Name another file with --output.")


def _check_name(path: Path) -> None:
    name_bytes = len(os.fsencode(path.name))
    if name_bytes > LONGEST_NAME:
        raise failures.calibration_name_too_long(path_count=name_bytes, longest_name=LONGEST_NAME)


def check_folder(folder: Path) -> None:
    """Raise RunFileError E9012 if a path of the folder is not a folder."""
    existing = next((path for path in (folder, *folder.parents) if path.exists()), folder)
    if existing.exists() and not existing.is_dir():
        raise unwritable(f"into {folder}", f"{existing} is not a folder", "Check the path.")


def make_folder(folder: Path) -> None:
    """Make the folder that files are to go into. Raises RunFileError E9012."""
    try:
        make(folder)
    except OSError as refused:
        raise unwritable(f"into {folder}", str(refused.strerror), "Check the path.") from refused


def unwritable(what: str, why: str, hint: str) -> RunFileError:
    """Return the error E9012 for a file that cannot be written."""
    return failures.output_not_written(what=what, why=why, remedy=hint)


class Sink:
    """A binary file whose OSErrors are converted by `error_of`; it is closed by its owner."""

    closed = False

    def __init__(self, file: BinaryIO, error_of: Callable[[OSError], EdmError]) -> None:
        self._file = file
        self._error_of = error_of
        self._written = 0

    def write(self, data: bytes) -> int:
        """Write all of `data`. Raises the error that `error_of` returns for an OSError."""
        try:
            self._file.write(data)
        except OSError as refused:
            raise self._error_of(refused) from refused
        self._written += len(data)
        return len(data)

    def flush(self) -> None:
        """Flush the file. Raises as `write`."""
        try:
            self._file.flush()
        except OSError as refused:
            raise self._error_of(refused) from refused

    def tell(self) -> int:
        """How many bytes were written."""
        return self._written

    def readable(self) -> bool:
        return False

    def writable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return False

    def close(self) -> None:
        """Leave the file open."""
        self.flush()


def write(path: Path, content: bytes, hint: str = _ANOTHER, *, overwrite: bool = False) -> None:
    """Write a file of that name. Raises RunFileError, and replaces a file, as `new_file` does."""
    with new_file(path, hint, overwrite=overwrite) as file:
        file.write(content)


@contextmanager
def new_file(path: Path, hint: str = _ANOTHER, *, overwrite: bool = False) -> Iterator[Sink]:
    """Give a sink into a new file, which is removed if the block fails.

    overwrite : take the place of a file of that name, which stays until the new one is whole

    Raises RunFileError: E9011 there is something of that name, E9012 it cannot be written.
    """

    def error_of(refused: OSError) -> EdmError:
        return unwritable(str(path), str(refused.strerror), "Check folder and space.")

    written = path.with_name(f".{path.name}.new") if overwrite else path
    try:
        if overwrite:
            written.unlink(missing_ok=True)
        file = _opened(written)
    except FileExistsError:
        raise failures.output_exists(path=path, remedy=hint) from None
    except OSError as refused:
        raise error_of(refused) from refused
    try:
        sink = Sink(file, error_of)
        yield sink
        sink.flush()
        file.close()
        if overwrite:
            try:
                written.replace(path)
            except OSError as refused:
                raise error_of(refused) from refused
    except BaseException:
        with suppress(OSError):
            file.close()
        written.unlink(missing_ok=True)
        raise


def _opened(path: Path) -> BinaryIO:
    return path.open("xb", buffering=1 << 20)
