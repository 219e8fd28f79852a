"""Rows on disk: one JSON object a line, appended and synced; each writer has a file of its own.

A network disk keeps such files whole without locks: nobody changes a line, and nobody writes into another's file.
A line that a crash has cut off is no row.
"""

from __future__ import annotations

import json
import os
import secrets
import socket
from collections.abc import Mapping
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Self

from edmctl import failures
from edmctl.files import json_of, open_descriptor, read_bytes

SUFFIX = ".jsonl"
ROWS_BYTES = 100_000_000
"""Rows of 40,000 runs by one writer; reading them takes a second or two."""


class RowWriter:
    """Appends rows to a file of its own in a folder. Raises RunFileError E9110 where the disk refuses."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._descriptor: int | None = None
        self._newest = ""

    def append(self, kind: str, values: Mapping[str, Any]) -> None:
        """Append one row, and come back when the disk has it.

        Its time is later than that of every row that was there, also where a clock was put back.
        """
        try:
            if self._descriptor is None:
                self._newest = newest_of(self._folder)
                self._descriptor = self._open()
            self._newest = when = later_than(self._newest)
            line = json.dumps({"row": kind, "when": when, **values}, ensure_ascii=False, allow_nan=False)
            data = f"{line}\n".encode()
            while data:
                data = data[os.write(self._descriptor, data) :]
            os.fsync(self._descriptor)
        except OSError as refused:
            raise failures.row_not_written(folder=self._folder, reason=refused.strerror) from refused

    def close(self) -> None:
        """Close the file, if anything was written."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _open(self) -> int:
        self._folder.mkdir(parents=True, exist_ok=True)
        host = "".join(c if c.isalnum() else "-" for c in socket.gethostname())[:40]
        name = f"{datetime.now(UTC):%Y%m%dT%H%M%S}-{host}-{os.getpid()}-{secrets.token_hex(3)}{SUFFIX}"
        return open_descriptor(self._folder / name, os.O_CREAT | os.O_EXCL | os.O_WRONLY | os.O_APPEND)


def later_than(newest: str) -> str:
    """Return the time now, or the next microsecond after a time that is still to come."""
    now = datetime.now(UTC)
    with suppress(ValueError, TypeError, OverflowError):
        now = max(now, datetime.fromisoformat(newest) + timedelta(microseconds=1))
    return now.isoformat(timespec="microseconds")


def newest_of(folder: Path) -> str:
    """Return the newest time of all rows of a folder; empty where there are none."""
    return max((when for when, *_ in _dated(folder)[0]), default="")


def read_lines(folder: Path) -> tuple[list[dict[str, Any]], int]:
    """Return the rows of a folder in the order of their times, and how many lines were none.

    Each has its kind as `row`. Raises RunFileError E9111 where a file cannot be read.
    """
    lines, torn = _dated(folder)
    lines.sort(key=lambda line: line[:3])
    return [values for *_, values in lines], torn


def _dated(folder: Path) -> tuple[list[tuple[str, str, int, dict[str, Any]]], int]:
    """Time, file and line number of each row, with the row, and how many lines were none."""
    lines: list[tuple[str, str, int, dict[str, Any]]] = []
    torn = 0
    file = folder
    try:
        files = sorted(folder.glob(f"*{SUFFIX}")) if folder.is_dir() else []
        for file in files:
            for number, line in enumerate(read_bytes(file, ROWS_BYTES).splitlines(keepends=True)):
                found = _parsed(line)
                if found is None:
                    torn += 1
                else:
                    lines.append((str(found.pop("when", "")), file.name, number, found))
    except OSError as refused:
        raise failures.rows_unreadable(file=file, reason=refused.strerror) from refused
    return lines, torn


def _parsed(line: bytes) -> dict[str, Any] | None:
    if not line.endswith(b"\n"):
        return None
    try:
        found = json_of(line)
    except ValueError:
        return None
    return found if isinstance(found, dict) and isinstance(found.get("row"), str) else None
