"""Rows on disk: one JSON object a line, appended and synced; each writer has a file of its own.

A network disk keeps such files whole without locks: nobody changes a line, and nobody writes into another's file.
A line that a crash has cut off is no row.
"""

from __future__ import annotations

import json
import os
import secrets
import socket
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Self

from edmctl.errors import RunFileError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

SUFFIX = ".jsonl"


class RowWriter:
    """Appends rows to a file of its own in a folder. Raises RunFileError E9110 where the disk refuses."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._descriptor: int | None = None

    def append(self, kind: str, values: Mapping[str, Any]) -> None:
        """Append one row, and come back when the disk has it."""
        when = datetime.now(UTC).isoformat(timespec="microseconds")
        line = json.dumps({"row": kind, "when": when, **values}, ensure_ascii=False, allow_nan=False) + "\n"
        try:
            if self._descriptor is None:
                self._descriptor = self._open()
            data = line.encode()
            while data:
                data = data[os.write(self._descriptor, data) :]
            os.fsync(self._descriptor)
        except OSError as refused:
            raise RunFileError(
                f"Cannot write a row into {self._folder}: {refused.strerror}.",
                hint="Check folder and space, and go on: rows that are there are kept.",
                code="E9110",
            ) from refused

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
        flags = os.O_CREAT | os.O_EXCL | os.O_WRONLY | os.O_APPEND | getattr(os, "O_CLOEXEC", 0)
        return os.open(self._folder / name, flags, 0o644)


def read_lines(folder: Path) -> tuple[list[dict[str, Any]], int]:
    """Return the rows of a folder in the order of their times, and how many lines were none.

    Each has its kind as `row`. Raises RunFileError E9111 where a file cannot be read.
    """
    lines: list[tuple[str, str, int, dict[str, Any]]] = []
    torn = 0
    try:
        files = sorted(folder.glob(f"*{SUFFIX}")) if folder.is_dir() else []
        for file in files:
            for number, line in enumerate(file.read_bytes().splitlines(keepends=True)):
                found = _parsed(line)
                if found is None:
                    torn += 1
                else:
                    lines.append((str(found.pop("when", "")), file.name, number, found))
    except OSError as refused:
        raise RunFileError(
            f"Cannot read the rows in {folder}: {refused.strerror}.",
            hint="Check its permissions.",
            code="E9111",
        ) from refused
    lines.sort(key=lambda line: line[:3])
    return [values for *_, values in lines], torn


def _parsed(line: bytes) -> dict[str, Any] | None:
    if not line.endswith(b"\n"):
        return None
    try:
        found = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) and isinstance(found.get("row"), str) else None
