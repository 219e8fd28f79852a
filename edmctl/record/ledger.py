"""The job ledger: what was done on which machine with which tool, line by line, beside the run files.

A line of `ledger.jsonl` is one JSON object and is never changed. What holds now (where there are holes, where a tool
would touch, how much it has lost) follows from reading all lines of a machine in order: `tool_account`.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from edmctl.errors import RunFileError
from edmctl.files import lock_holder, open_descriptor, read_bytes, refuse_locked
from edmctl.record.ledger_entries import (
    VERSION,
    Entry,
    JobBegun,
    LaterVersion,
    Line,
    ReferenceTouched,
    RunEnded,
    SiteMachined,
    ToolChanged,
    WearMeasured,
    line_of,
    text_of,
)
from edmctl.record.locks import exclusive, retried

__all__ = [
    "Entry",
    "JobBegun",
    "Ledger",
    "Line",
    "ReferenceTouched",
    "RunEnded",
    "SiteMachined",
    "ToolChanged",
    "WearMeasured",
]

LEDGER_BYTES = 200_000_000
FILE_NAME = "ledger.jsonl"
LONGEST_WAIT_S = 10.0
"""Longest wait to add the result of a job: a slow disk must not cost it."""
OPENING_WAIT_S = 1.0
"""Longest wait to open: a ledger that stays locked is refused before anything moves."""


class Ledger:
    """The ledger of a folder of run files."""

    def __init__(self, path: Path, lines: tuple[Line, ...]) -> None:
        self.path = path
        self.lines = lines

    @classmethod
    def open(cls, folder: Path) -> Ledger:
        """Read the ledger of a folder; an empty one where there is none.

        A last line that was cut off while it was written is left out.

        Raises RunFileError: E9030 it cannot be read, E9031 a line of it is damaged, E9032 a later version wrote it.
        """
        path = folder / FILE_NAME
        try:
            retried(lambda: refuse_locked(path), OPENING_WAIT_S)
            data = read_bytes(path, LEDGER_BYTES)
        except FileNotFoundError:
            return cls(path, ())
        except OSError as refused:
            raise RunFileError(
                f"The job ledger {path} cannot be read: {refused.strerror}.",
                hint="Close the program that has locked it, check its permissions, or give another --out.",
                code="E9030",
            ) from refused
        return cls(path, tuple(_lines(path, data)))

    def append(self, serial: str, *entries: Entry, bench_s: float = math.nan) -> None:
        """Add entries of a machine; they are on the disk when the call returns. `bench_s` as in `Line`.

        Raises RunFileError E9033 where that is not possible.
        """
        if not entries:
            return
        new = tuple(Line(serial, time.time(), entry, bench_s) for entry in entries)
        text = "".join(text_of(line) for line in new).encode()
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with _locked(self.path) as descriptor:
                _mend_end(descriptor)
                _write(descriptor, text)
        except OSError as refused:
            holder = lock_holder(self.path) if isinstance(refused, BlockingIOError) else ""
            why = f"{holder} has locked it" if holder else refused.strerror or refused
            raise RunFileError(
                f"Cannot write the job ledger {self.path}: {why}.",
                hint="Check that the folder can be written and has space.",
                code="E9033",
            ) from refused
        self.lines += new


def _lines(path: Path, data: bytes) -> Iterator[Line]:
    """Every whole line. The last one counts where it is whole, even if its end of line is missing."""
    rows = data.split(b"\n")
    for number, row in enumerate(rows, start=1):
        is_last = number == len(rows)
        if is_last and not row:
            return
        try:
            yield line_of(row)
        except LaterVersion as later:
            raise RunFileError(
                f"{path}:{number}: a later edmctl wrote this line (version {later}; this one knows {VERSION}).",
                hint="Use that version of edmctl, or keep run files elsewhere with --out.",
                code="E9032",
            ) from None
        except (ValueError, TypeError, KeyError) as error:
            if is_last:
                return
            raise RunFileError(
                f"{path}:{number}: this line of the job ledger is damaged: {error}.",
                hint="Take the line out with an editor if you know what it said, or keep run files elsewhere with "
                "--out.",
                code="E9031",
            ) from error


@contextmanager
def _locked(path: Path) -> Iterator[int]:
    """Open the ledger for appending while nobody else does."""
    descriptor = open_descriptor(path, os.O_RDWR | os.O_CREAT | os.O_APPEND)
    with ExitStack() as held:
        held.callback(os.close, descriptor)
        retried(lambda: held.enter_context(exclusive(descriptor)), LONGEST_WAIT_S)
        yield descriptor


def _mend_end(descriptor: int) -> None:
    """Give a whole last line its end of line, and take a torn one away: nothing may be glued to it."""
    size = os.fstat(descriptor).st_size
    last = os.pread(descriptor, size, 0).rpartition(b"\n")[2]
    if not last:
        return
    try:
        line_of(last)
    except LaterVersion:
        _write(descriptor, b"\n")
    except (ValueError, TypeError, KeyError):
        os.ftruncate(descriptor, size - len(last))
    else:
        _write(descriptor, b"\n")


def _write(descriptor: int, text: bytes) -> None:
    while text:
        text = text[os.write(descriptor, text) :]
    os.fsync(descriptor)
