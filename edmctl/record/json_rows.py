"""Dataclasses out of plain values, and rows appended to files, one JSON object a line.

Each writer of rows has a file of its own, and no line is changed: a network disk keeps such files whole without
locks. A line that a crash has cut off is no row.
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
import secrets
import socket
from collections.abc import Callable, Mapping
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from enum import Enum
from functools import cache
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Self, TypeVar, get_args, get_origin, get_type_hints

from edmctl import failures
from edmctl.files import json_of, open_descriptor, read_bytes
from edmctl.results.job import SiteResult

T = TypeVar("T")
_LARGEST_INT = 1 << 1000
"""A float holds it."""
SUFFIX = ".jsonl"
ROWS_BYTES = 100_000_000
"""Rows of 40,000 runs by one writer; reading them takes a second or two."""
_hints: Callable[[Any], dict[str, Any]] = cache(get_type_hints)


def record_of(kind: type[T], values: Mapping[str, Any]) -> T:
    """Return a record from plain values; None for a float is NaN. Raises TypeError or ValueError for others."""
    hints = _hints(kind)
    if unknown := values.keys() - hints.keys():
        raise TypeError(f"{kind.__name__} has no {', '.join(sorted(map(str, unknown)))}")
    return kind(**{name: typed(hints[name], value, name) for name, value in values.items()})


def typed(kind: Any, value: Any, name: str) -> Any:
    """Return a plain value as the type of its field. Raises TypeError or ValueError for another one."""
    origin, parts = get_origin(kind), get_args(kind)
    if origin is UnionType:
        one = next(one for one in parts if one is not NoneType)
        return None if value is None else typed(one, value, name)
    if origin is tuple and isinstance(value, list | tuple):
        kinds = parts[:1] * len(value) if parts[-1] is Ellipsis else parts
        return tuple(typed(one, part, name) for one, part in zip(kinds, value, strict=True))
    if origin is Mapping and isinstance(value, Mapping):
        return {str(key): typed(parts[1], part, name) for key, part in value.items()}
    if kind is object:
        return value
    if kind is float and value is None:
        return math.nan
    if kind is float and type(value) is int and abs(value) < _LARGEST_INT:
        return float(value)
    if dataclasses.is_dataclass(kind) and isinstance(value, Mapping):
        return record_of(kind, value)  # type: ignore[arg-type]
    if isinstance(kind, type) and issubclass(kind, Enum):
        return kind(value)
    if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
        raise TypeError(f"{name} is no {getattr(kind, '__name__', kind)}")
    return value


def site_result_of(mapping: Mapping[str, object]) -> SiteResult:
    """Return the result that a journal has kept, estimated if without a basis. Raises TypeError for other values."""
    return record_of(SiteResult, {"depth_basis": "estimated", "wear_basis": "estimated"} | dict(mapping))


def write_through(descriptor: int, data: bytes) -> None:
    """Write all of `data`, and come back when the disk has it. Raises OSError."""
    while data:
        data = data[os.write(descriptor, data) :]
    os.fsync(descriptor)


class RowWriter:
    """Appends rows to a file of its own in a folder. Raises RunFileError E9110 where the disk refuses."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._descriptor: int | None = None
        self._newest = ""

    def append(self, kind: str, values: Mapping[str, Any]) -> None:
        """Append one row and sync it. Its time is later than those before, also if a clock was put back."""
        try:
            if self._descriptor is None:
                self._newest = max((when for when, *_ in _dated(self._folder)[0]), default="")
                self._descriptor = self._open()
            self._newest = when = _later_than(self._newest)
            line = json.dumps({"row": kind, "when": when, **values}, ensure_ascii=False, allow_nan=False)
            write_through(self._descriptor, f"{line}\n".encode())
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


def _later_than(newest: str) -> str:
    """Return the time now, or the next microsecond after a time that is still to come."""
    now = datetime.now(UTC)
    with suppress(ValueError, TypeError, OverflowError):
        now = max(now, datetime.fromisoformat(newest) + timedelta(microseconds=1))
    return now.isoformat(timespec="microseconds")


def read_lines(folder: Path) -> tuple[list[dict[str, Any]], int]:
    """Return the rows of a folder by their times, with the number of torn lines. Raises RunFileError E9111."""
    lines, torn = _dated(folder)
    lines.sort(key=lambda line: line[:3])
    return [values for *_, values in lines], torn


def _dated(folder: Path) -> tuple[list[tuple[str, str, int, dict[str, Any]]], int]:
    """Return time, file and line number of each row, with the row, and how many lines were none."""
    lines: list[tuple[str, str, int, dict[str, Any]]] = []
    torn, file = 0, folder
    try:
        for file in sorted(folder.glob(f"*{SUFFIX}")) if folder.is_dir() else []:
            for number, line in enumerate(read_bytes(file, ROWS_BYTES).splitlines(keepends=True)):
                row = None
                with suppress(ValueError):
                    row = json_of(line)
                if line.endswith(b"\n") and isinstance(row, dict) and isinstance(row.get("row"), str):
                    lines.append((str(row.pop("when", "")), file.name, number, row))
                else:
                    torn += 1
    except OSError as refused:
        raise failures.rows_unreadable(file=file, reason=refused.strerror) from refused
    return lines, torn
