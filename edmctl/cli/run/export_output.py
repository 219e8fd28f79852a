"""Where exported rows go: a new file, or stdout. What they refuse is an error of theirs, never of the run file."""

from __future__ import annotations

import os
import sys
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, BinaryIO

from edmctl.cli.outcome import unwritable
from edmctl.errors import EdmError
from edmctl.jobs import output_files

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path


class NobodyReads(EdmError):
    """The reader of stdout has gone: no failure of the command."""


class Sink:
    """A binary file whose errors become those that `told` makes of them."""

    closed = False

    def __init__(self, file: BinaryIO, told: Callable[[OSError], EdmError]) -> None:
        self._file = file
        self._told = told
        self._written = 0

    def write(self, data: bytes) -> int:
        """Write all of `data`. Raises what `told` makes of an OSError."""
        try:
            self._file.write(data)
        except OSError as refused:
            raise self._told(refused) from refused
        self._written += len(data)
        return len(data)

    def flush(self) -> None:
        """Hand on what waits. Raises as `write`."""
        try:
            self._file.flush()
        except OSError as refused:
            raise self._told(refused) from refused

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
        """Leave the file open: it is closed by who opened it."""
        self.flush()


@contextmanager
def new_file(path: Path, *, overwrite: bool = False) -> Iterator[Sink]:
    """Give a sink into a new file; when the block fails, none is left.

    overwrite : take the place of a file of that name, which stays until the new one is whole

    Raises RunFileError: E9011 there is something of that name, E9012 it cannot be written.
    """

    def told(refused: OSError) -> EdmError:
        return output_files.unwritable(str(path), str(refused.strerror), "Check folder and space.")

    written = path.with_name(f".{path.name}.new") if overwrite else path
    try:
        if overwrite:
            written.unlink(missing_ok=True)
        file = _opened(written)
    except FileExistsError:
        output_files.check_free(path)
        raise
    except OSError as refused:
        raise told(refused) from refused
    try:
        sink = Sink(file, told)
        yield sink
        sink.flush()
        file.close()
        if overwrite:
            _take_the_place(written, path, told)
    except BaseException:
        with suppress(OSError):
            file.close()
        written.unlink(missing_ok=True)
        raise


def _take_the_place(written: Path, path: Path, told: Callable[[OSError], EdmError]) -> None:
    try:
        written.replace(path)
    except OSError as refused:
        raise told(refused) from refused


def _opened(path: Path) -> BinaryIO:
    return path.open("xb", buffering=1 << 20)


@contextmanager
def stdout() -> Iterator[Sink]:
    """Give a sink into stdout; that nobody reads any more ends the block in order. Raises RunFileError E9010."""

    def told(refused: OSError) -> EdmError:
        return NobodyReads("") if isinstance(refused, BrokenPipeError) else unwritable(refused)

    sys.stdout.flush()
    try:
        sink = Sink(sys.stdout.buffer, told)
        yield sink
        sink.flush()
    except NobodyReads:
        with suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
