"""Makes a complete run file of one without an end, or of what can be read of a damaged one.

The old file is only read. What a killed writer left is copied as it is; columns of one group are cut to the
shortest, as they were written one after another. A damaged file is read in a process of its own, which has a time
limit, because HDF5 does not survive every damage; and from a copy, if its end is lost or its texts are endless. Rows
of a column that cannot be read become NaN, or 0 in columns of whole numbers, and are counted.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from edmctl import failures
from edmctl.dataclasses import asdict, dataclass, field
from edmctl.errors import RunFileError
from edmctl.record import layout
from edmctl.record.compaction import CLOSING, compact
from edmctl.record.create import LIBRARY_VERSIONS, empty_run_file
from edmctl.record.disk import HDF5_ERRORS, PARTIAL, error_number, reason, rename_without_replacing, write_new
from edmctl.record.integrity import are_sound, end_at_breaks, is_whole, read_superblock
from edmctl.record.layout import Scalar, Table
from edmctl.record.locks import is_live
from edmctl.record.opening import damaged, open_file, open_hdf5, open_unjudged, refuse_endless, refuse_foreign
from edmctl.record.run_meta import Leaf, RunMeta, SourceText
from edmctl.record.writer import fit_utf8
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
        raise failures.run_still_written(path=path)


def name_taken(target: Path) -> RunFileError:
    """Return the error for a new file whose name is taken."""
    return failures.recovery_target_exists(target=target)


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
    return failures.run_not_recovered(path=path, target=target, error=reason(error))


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


_LONGEST_BYTES = 1 << 40
"""A length beyond this is part of the damage."""
_LEAST_S, _BYTES_PER_S = 60.0, 1e6
"""The time that is given: so much, and for each byte."""
_COPY, _RAW = ".copy", ".raw"


def recover_damaged(path: Path, target: Path | None = None) -> Recovered:
    """Write what can be read of the damaged file at `path` into a new one; the old one stays as it is.

    Raises RunFileError: as `recover`, and E9007 where nothing can be read.
    """
    target = target or recovered_name(path)
    refuse(path, target)
    command = [sys.executable, "-m", "edmctl.record.recovery", str(path), str(target)]
    limit_s = _LEAST_S + path.stat().st_size / _BYTES_PER_S
    try:
        ended = subprocess.run(command, capture_output=True, text=True, check=False, timeout=limit_s)
        answer = json.loads(ended.stdout)
    except subprocess.TimeoutExpired:
        raise _beyond(path, f"reading it did not end within {limit_s:.0f} s") from None
    except ValueError:
        raise _beyond(path, f"reading it ended with status {ended.returncode}") from None
    if "error" in answer:
        raise RunFileError(answer["error"], code=answer["code"], hint=answer["hint"])
    return Recovered(Path(answer["path"]), answer["rows"], answer["lost_rows"], answer["unread_rows"])


def _beyond(path: Path, why: str) -> RunFileError:
    return failures.run_file_beyond_recovery(path=path, why=why)


def _recovered(path: Path, target: Path) -> Recovered:
    copy = temporary(target).with_suffix(_COPY)
    try:
        with _opened(path, copy) as source:
            refuse_foreign(path, source)
            return _rebuilt(source, path, target)
    except BROKEN as error:
        raise _beyond(path, reason(error)) from error
    finally:
        copy.unlink(missing_ok=True)


def _opened(path: Path, copy: Path) -> h5py.File:
    """Open the file, or a mended copy of it. Raises what h5py raises."""
    end_bytes = read_superblock(path).end_bytes or 0
    missing = end_bytes - path.stat().st_size if end_bytes <= _LONGEST_BYTES else 0
    if missing > 0 or not are_sound(path):
        shutil.copyfile(path, copy)
        if missing > 0:
            with copy.open("r+b") as file:
                file.truncate(end_bytes)
        end_at_breaks(copy)
        path = copy
    return open_unjudged(path)


def _rebuilt(source: h5py.File, path: Path, target: Path) -> Recovered:
    """Fill an empty run file with what can be read of `source`."""
    raw, new = temporary(target).with_suffix(_RAW), temporary(target)
    rows: dict[str, int] = {}
    lost: dict[str, int] = {}
    unread: dict[str, int] = {}
    end_time: bytes = _value(source, "/entry/end_time", b"")
    write_new(raw, empty_run_file(_meta(source)))
    try:
        with open_hdf5(raw, "r+", libver=LIBRARY_VERSIONS) as file:
            for scalar in layout.SCALARS:
                if not scalar.source and scalar.dtype not in ("text", "texts", "json"):
                    with suppress(*BROKEN):
                        file[scalar.path][()] = _value(source, scalar.path, file[scalar.path][()])
            summary = _value(source, "/entry/summary", np.empty(0, "u1"))
            file["/entry/summary"].resize(summary.shape)
            file["/entry/summary"][:] = summary
            for table in layout.TABLES:
                claimed = _copy_table(source, file, table, unread)
                rows[table.path] = count = _length(file, table)
                if claimed > count:
                    lost[table.path] = claimed - count
            if not any(rows.values()):
                raise _beyond(path, "none of its rows can be read")
            values = ending(end_time, path) | {"/entry/status": RECOVERED.encode()}
            compact(file, new, values=values)
    finally:
        raw.unlink(missing_ok=True)
    give_name(new, target)
    return Recovered(target, rows, lost, unread)


def _meta(source: h5py.File) -> RunMeta:
    """What the file says of its run, as far as it can be read."""
    blank: dict[str, Any] = {
        "run_id": "",
        "title": "",
        "start_time": "",
        "command": [],
        "host": "",
        "simulated": False,
        "seed": None,
        "profile_text": "",
        "profile_sha256": "",
        "edmctl_version": "",
        "procedure": "",
    }
    for scalar in layout.SCALARS:
        if scalar.source:
            value = _value(source, scalar.path, None)
            with suppress(*BROKEN):
                blank[scalar.source] = _plain(scalar, value)
    blank["profile_leaves"] = _leaves(source)
    with suppress(*BROKEN):
        places, texts = source["/entry/profile/parent_paths"][:], source["/entry/profile/parents"][:]
        blank["profile_parents"] = [
            SourceText(place.decode(), text.decode()) for place, text in zip(places, texts, strict=True)
        ]
    with suppress(*BROKEN):
        blank["command"] = json.loads(source["/entry/command"][()])
    return RunMeta(**blank)


def _plain(scalar: Scalar, value: Any) -> object:
    if scalar.source == "profile_overrides":
        return value.decode().splitlines()
    return value.decode() if scalar.dtype == "text" else value.item()


def _leaves(source: h5py.File) -> list[Leaf]:
    found: dict[str, float | int | str | bool] = {}
    with suppress(*BROKEN):
        attributes = source["/entry/profile/values"].attrs
        for key in attributes:
            with suppress(*BROKEN):
                value = attributes[key]
                found[key] = value.item() if isinstance(value, np.generic) else value
    return [
        Leaf(key, value, str(found.get(f"{key}_units", "")))
        for key, value in found.items()
        if not key.endswith("_units") and key != "NX_class"
    ]


def _value(source: h5py.File, path: str, default: Any) -> Any:
    with suppress(*BROKEN):
        refuse_endless(source[path].id)
        return source[path][()]
    return default


def _length(file: h5py.File, table: Table) -> int:
    item = file[table.path]
    length: int = (item if table.is_compound else item[table.columns[0].name]).shape[0]
    return length


def _copy_table(source: h5py.File, file: h5py.File, table: Table, unread: dict[str, int]) -> int:
    """Fill a table; returns how many rows the source said it has."""
    names = [""] if table.is_compound else [f"/{column.name}" for column in table.columns]
    found = {name: _dataset(source, table.path + name) for name in names}
    lengths = {name: dataset.shape[0] for name, dataset in found.items() if dataset is not None}
    if not lengths:
        return 0
    # A row whose time cannot be read has no place; of other columns, the longest tells how many rows there are.
    clock = found.get("/time")
    rows = _readable_rows(clock) if clock is not None else max(lengths.values())
    for name in names:
        target = file[table.path + name]
        target.resize((rows,))
        bad = _copy_rows(found[name], target, rows, table)
        if bad and not _is_absent(source, table, name):
            unread[table.path + name] = bad
    claimed: int = max(lengths.values())
    return claimed


def _is_absent(source: h5py.File, table: Table, name: str) -> bool:
    """Whether an older version wrote the file, which had no such column."""
    with suppress(*BROKEN):
        return not table.is_compound and name.lstrip("/") not in list(source[table.path])
    return False


def _dataset(source: h5py.File, path: str) -> h5py.Dataset | None:
    """The dataset, None where it cannot be read or claims what cannot be."""
    with suppress(*BROKEN):
        dataset = source[path]
        refuse_endless(dataset.id)
        return dataset if len(dataset.shape) == 1 else None
    return None


def _pieces(dataset: h5py.Dataset, rows: int) -> list[tuple[int, int]]:
    """Rows that can be read or not as a whole: chunks."""
    step = dataset.chunks[0] if dataset.chunks else max(1, rows)
    return [(start, min(start + step, rows)) for start in range(0, rows, step)]


def _readable_rows(dataset: h5py.Dataset) -> int:
    """Rows before the first that cannot be read."""
    for start, stop in _pieces(dataset, dataset.shape[0]):
        if _read(dataset, start, stop) is None:
            return start
    rows: int = dataset.shape[0]
    return rows


def _read(dataset: h5py.Dataset, start: int, stop: int) -> NDArray[np.generic] | None:
    with suppress(*BROKEN):
        values: NDArray[np.generic] = dataset[start:stop]
        return values
    return None


def _copy_rows(dataset: h5py.Dataset | None, target: h5py.Dataset, rows: int, table: Table) -> int:
    """Copy rows, and put NaN or 0 where none can be read; returns how many those are."""
    unknown = np.nan if target.dtype.kind == "f" else np.zeros((), target.dtype)
    there, good = 0, 0
    if dataset is not None:
        there = min(rows, dataset.shape[0])
        for start, stop in _pieces(dataset, there):
            values = _read(dataset, start, stop)
            target[start:stop] = unknown if values is None else _fitted(values, target.dtype, table)
            good += 0 if values is None else stop - start
    if there < rows:
        target[there:rows] = unknown
    return rows - good


def _fitted(values: NDArray[Any], dtype: np.dtype[Any], table: Table) -> NDArray[Any]:
    """Return rows of a compound dataset with all columns of the layout; unknown ones are NaN or 0."""
    there = values.dtype.names
    if there is None or there == dtype.names:
        return values
    rows: NDArray[Any] = np.zeros(values.shape, dtype)
    for column in table.columns:
        if column.name in there:
            rows[column.name] = values[column.name]
        elif dtype[column.name].kind == "f":
            rows[column.name] = np.nan
    return rows


def main() -> None:
    """Recover for the parent process; the answer is one JSON object."""
    path, target = map(Path, sys.argv[1:])
    try:
        answer = asdict(_recovered(path, target))
    except RunFileError as error:
        answer = {"error": error.message, "code": error.code, "hint": error.hint}
    print(json.dumps(answer, default=str))  # noqa: T201 - the parent reads it


if __name__ == "__main__":
    main()
