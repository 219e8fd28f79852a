"""Makes a complete run file of one that has no end, or that was damaged after it was written.

The old file is only read. The new one holds every row that can be read: of a killed writer all that was flushed,
of a damaged file the rows before the damage. Columns of one group are cut to the shortest, as they were written
one after another.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING

from edmctl import __version__
from edmctl.errors import RunFileError

from . import layout
from .closing import CLOSING
from .compaction import compact
from .disk import HDF5_ERRORS, PARTIAL, already_there, reason, rename_without_replacing
from .liveness import is_live
from .opening import damaged, open_file
from .seal import Seal, look_at_seal
from .stores import fit_utf8

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    import h5py

RECOVERED = "recovered"
RECOVERING = ".recovering"
"""Ending of the new file while it is written."""
_ROWS_AT_ONCE = 1 << 16


@dataclass(frozen=True, slots=True)
class Recovered:
    """A new run file at `path`; rows by table, and how many more the old file said it had."""

    path: Path
    rows: dict[str, int]
    lost_rows: dict[str, int]


def recovered_name(path: Path) -> Path:
    """Return what the complete file is called: `a.h5` for `a.h5.partial`, `a.recovered.h5` for a damaged `a.h5`."""
    if path.suffix == PARTIAL:
        return path.with_suffix("")
    return path.with_name(f"{path.stem}.recovered{path.suffix}")


def is_complete(path: Path) -> bool:
    """Whether there is nothing to recover: a file with an end and a check sum that fits."""
    return path.suffix != PARTIAL and _seal_of(path) is Seal.WHOLE


def is_damaged(path: Path) -> bool:
    """Whether the file is not what it was when it was sealed."""
    return _seal_of(path) is Seal.BROKEN


def _seal_of(path: Path) -> Seal:
    try:
        return look_at_seal(path) if path.is_file() else Seal.NONE
    except OSError:
        return Seal.NONE


def recover(path: Path, target: Path | None = None) -> Recovered:
    """Write what can be read of the run file at `path` into a new file; it stays as it is itself.

    Raises RunFileError: E9001 the new name is taken, E9002 it cannot be written, E9005 this is no run file, E9006 a
    later version wrote it, E9007 it is damaged beyond recovery, E9014 a process is still writing it.
    """
    target = target or recovered_name(path)
    if target.exists():
        raise already_there(target)
    with open_file(path, verify=False) as source:
        if is_live(path):
            raise RunFileError(
                f"{path} is still being written by a run that goes on.",
                code="E9014",
                hint="Wait for its end; `edmctl run show --follow` shows how it does.",
            )
        try:
            found = dict(_found_rows(source))
            values = _ending(source, path, whole=not is_damaged(path))
        except HDF5_ERRORS as error:
            raise damaged(path, reason(error)) from error
        new = target.with_name(target.name + RECOVERING)
        try:
            new.unlink(missing_ok=True)
            rows = {dataset: part.readable for part in found.values() for dataset in part.datasets}
            compact(source, new, rows, values)
        except HDF5_ERRORS as error:
            # The operating system's refusals have a number; those of HDF5 are about what it read.
            if getattr(error, "errno", None) is None:
                raise damaged(path, reason(error)) from error
            raise RunFileError(
                f"Cannot recover {path} into {target}: {reason(error)}.",
                code="E9002",
                hint="Check that its folder can be written and has space, or name another file with --out.",
            ) from error
    try:
        rename_without_replacing(new, target)
    except RunFileError as error:
        new.unlink(missing_ok=True)
        raise already_there(target) from error
    target.with_name(target.name + CLOSING).unlink(missing_ok=True)
    lost = {table: part.told - part.readable for table, part in found.items() if part.told > part.readable}
    return Recovered(target, {table: part.readable for table, part in found.items()}, lost)


@dataclass(frozen=True, slots=True)
class _Rows:
    """Rows of one table that all its datasets have and that can be read, of those that the file tells."""

    datasets: tuple[str, ...]
    readable: int
    told: int


def _found_rows(source: h5py.File) -> Iterator[tuple[str, _Rows]]:
    for table in layout.TABLES:
        if table.path not in source:
            continue
        item = source[table.path]
        datasets = {table.path: item} if table.is_compound else {f"{table.path}/{n}": item[n] for n in item}
        readable = min(_readable_rows(dataset) for dataset in datasets.values())
        told = max(dataset.shape[0] for dataset in datasets.values())
        yield table.path, _Rows(tuple(datasets), readable, told)


def _readable_rows(dataset: h5py.Dataset) -> int:
    """Rows before the first part that cannot be read."""
    rows: int = dataset.shape[0]
    for start in range(0, rows, _ROWS_AT_ONCE):
        try:
            dataset[start : min(start + _ROWS_AT_ONCE, rows)]
        except HDF5_ERRORS:
            return start
    return rows


def _ending(source: h5py.File, path: Path, *, whole: bool) -> dict[str, bytes | int]:
    """What the new file says of its end; the status of a run that came to its own end stays."""
    values: dict[str, bytes | int] = {}
    if not source["/entry/end_time"][()]:
        last_write = datetime.fromtimestamp(path.stat().st_mtime, UTC)
        values["/entry/end_time"] = last_write.isoformat(timespec="milliseconds").encode()
        values["/entry/status"] = RECOVERED.encode()
    elif not whole:
        values["/entry/status"] = RECOVERED.encode()
    if "/entry/recovery" in source:
        now = datetime.now(UTC).isoformat(timespec="seconds")
        values["/entry/recovery"] = fit_utf8(f"from {path.name} by edmctl {__version__} at {now}", 160)
    return values
