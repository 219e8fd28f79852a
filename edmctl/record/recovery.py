"""Makes a complete run file of one that has no end because its writer was killed.

The old file is only read. The new one holds every row that was flushed. Columns of one group are cut to the
shortest, as they were written one after another.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from edmctl.dataclasses import dataclass, field
from edmctl.errors import RunFileError
from edmctl.record import layout
from edmctl.record.compaction import CLOSING, compact
from edmctl.record.disk import HDF5_ERRORS, PARTIAL, error_number, reason, rename_without_replacing
from edmctl.record.hdf5 import refuse_endless
from edmctl.record.integrity import is_whole
from edmctl.record.locks import is_live
from edmctl.record.opening import damaged, open_file
from edmctl.record.stores import fit_utf8
from edmctl.version import __version__
from edmctl.wording import iso_of

if TYPE_CHECKING:
    import h5py

RECOVERED = "recovered"
RECOVERING = ".recovering"
"""Ending of the new file while it is written."""
BROKEN = (*HDF5_ERRORS, LookupError, AttributeError, TypeError)
"""What h5py raises on files that are not what they were, from which call depends."""


@dataclass(frozen=True, slots=True)
class Recovered:
    """A new run file at `path`.

    rows : by table, how many are in it
    lost_rows : by table, how many more the old file had begun or said it had
    unread_rows : by dataset, how many of the rows could not be read; there it says NaN, or 0 where that is no number
    """

    path: Path
    rows: dict[str, int]
    lost_rows: dict[str, int]
    unread_rows: dict[str, int] = field(default_factory=dict)


def recovered_name(path: Path) -> Path:
    """Return what the complete file is called: `a.h5` for `a.h5.partial`, `a.recovered.h5` for a damaged `a.h5`."""
    if path.suffix == PARTIAL:
        return path.with_suffix("")
    return path.parent / f"{path.stem}.recovered{path.suffix}"


def is_complete(path: Path) -> bool:
    """Whether there is nothing to recover: a file with an end and a check sum that fits."""
    return path.suffix != PARTIAL and is_whole(path)


def recover(path: Path, target: Path | None = None) -> Recovered:
    """Write all that a killed writer left at `path` into a new file; the old one stays as it is.

    Raises RunFileError: E9001 the new name is taken, E9002 it cannot be written, E9005 this is no run file, E9006 a
    later version wrote it, E9007 a part of it cannot be read (`recover_damaged` copes with that), E9014 a process
    is still writing it.
    """
    target = target or recovered_name(path)
    refuse(path, target)
    with open_file(path) as source:
        try:
            found = dict(_found_rows(source))
            values = ending(source["/entry/end_time"][()], path)
            rows = {dataset: part.whole for part in found.values() for dataset in part.datasets}
            new = temporary(target)
            compact(source, new, rows, values)
        except BROKEN as error:
            raise _blamed(path, target, error) from error
    give_name(new, target)
    lost = {table: part.begun - part.whole for table, part in found.items() if part.begun > part.whole}
    return Recovered(target, {table: part.whole for table, part in found.items()}, lost)


def refuse(path: Path, target: Path) -> None:
    """Raise RunFileError: E9001 `target` is taken, E9014 a process is writing `path`."""
    if os.path.lexists(target):
        raise name_taken(target)
    if path.is_file() and is_live(path):
        raise RunFileError(
            f"{path} is still being written by a run that goes on.",
            code="E9014",
            hint="Wait for its end; `edmctl run show --follow` shows how it does.",
        )


def name_taken(target: Path) -> RunFileError:
    """Return the error for a new file whose name is taken."""
    return RunFileError(
        f"{target} exists already and is not overwritten.",
        code="E9001",
        hint="Name another file with --out FILE.",
    )


def temporary(target: Path) -> Path:
    """What the new file is called while this process writes it."""
    return target.with_name(f"{target.name}.{os.getpid()}{RECOVERING}")


def give_name(new: Path, target: Path) -> None:
    """Give the complete file `new` its name. Raises RunFileError E9001 when that was taken meanwhile."""
    try:
        rename_without_replacing(new, target)
    except RunFileError as error:
        new.unlink(missing_ok=True)
        raise name_taken(target) from error
    # What a writer left that died while it closed the file.
    target.with_name(target.name + CLOSING).unlink(missing_ok=True)


def _blamed(path: Path, target: Path, error: Exception) -> RunFileError:
    """The old file's damage, or the new one's disk: refusals of the operating system have a number."""
    if error_number(error) is None:
        return damaged(path, reason(error))
    return RunFileError(
        f"Cannot recover {path} into {target}: {reason(error)}.",
        code="E9002",
        hint="Check that its folder can be written and has space, or name another file with --out.",
    )


@dataclass(frozen=True, slots=True)
class _Rows:
    """Rows of one table that all its datasets have, and those that its longest has."""

    datasets: tuple[str, ...]
    whole: int
    begun: int


def _found_rows(source: h5py.File) -> Iterator[tuple[str, _Rows]]:
    for table in layout.TABLES:
        if table.path not in source:
            continue
        item = source[table.path]
        datasets = {table.path: item} if table.is_compound else {f"{table.path}/{n}": item[n] for n in item}
        lengths = [dataset.shape[0] for dataset in datasets.values()]
        for dataset in datasets.values():
            refuse_endless(dataset.id)
        yield table.path, _Rows(tuple(datasets), min(lengths), max(lengths))


def ending(end_time: bytes, path: Path) -> dict[str, bytes | int]:
    """What the new file says of its end; that of a run that came to its own end stays."""
    now = datetime.now(UTC).isoformat(timespec="seconds")
    values: dict[str, bytes | int] = {
        "/entry/recovery": fit_utf8(f"from {path.name} by edmctl {__version__} at {now}", 160)
    }
    if not end_time:
        values["/entry/end_time"] = (iso_of(path.stat().st_mtime) or now).encode()
        values["/entry/status"] = RECOVERED.encode()
    return values
