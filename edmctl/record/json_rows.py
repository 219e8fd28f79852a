"""Records and rows as JSON: dataclasses out of plain values, and rows appended to files, one JSON object a line.

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
from collections.abc import Mapping
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


@cache
def _hints(kind: Any) -> dict[str, Any]:
    return get_type_hints(kind)


def record_of(kind: type[T], values: Mapping[str, Any]) -> T:
    """Return the record whose fields are kept as plain values, as JSON has them: None for a float is NaN.

    Raises TypeError or ValueError if the values do not fit such a record.
    """
    hints = _hints(kind)  # type: ignore[arg-type]
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
