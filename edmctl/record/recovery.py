"""Writes complete run files: of a run that has ended, of one that was killed, of what can be read of a damaged one.

During a run nothing is compressed, because SWMR never reuses the space of a compressed chunk that grows. A complete
file is written anew, in the oldest format that can hold it: its rows in large chunks through the filters shuffle and
gzip, which every HDF5 library has. Then it is sealed. The old file is only read.

Columns of a killed run are cut to the shortest of their group, as they were written one after another. A damaged
file is read in a process of its own, which has a time limit, because HDF5 does not survive every damage; and from a
copy, if its end is lost or its texts are endless. Rows that cannot be read become NaN, or 0 in columns of whole
numbers, and are counted.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import zlib
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from h5py import h5d, h5s
from numpy.typing import NDArray

from edmctl import failures
from edmctl.dataclasses import asdict, dataclass, field
from edmctl.errors import RunFileError
from edmctl.files import sync
from edmctl.record import layout, opening
from edmctl.record.disk import (
    HDF5_ERRORS,
    PARTIAL,
    cannot_name,
    error_number,
    is_live,
    reason,
    rename_without_replacing,
)
from edmctl.record.layout import GZIP_LEVEL, UNKNOWN, Content, Scalar, Table, build_tree, fit_utf8
from edmctl.record.opening import open_dataset, read_value
from edmctl.version import __version__
from edmctl.wording import iso_of

RECOVERED = "recovered"
RECOVERING = ".recovering"
"""Ending of the new file while it is written."""
CLOSING = ".closing"
"""Ending of the compressed copy of a run that ends; if its process dies, the `.partial` file is unchanged."""
BROKEN = (*HDF5_ERRORS, LookupError, AttributeError, TypeError)
"""What h5py raises on files that are not what they were, from which call depends."""
_WORKERS = min(4, os.cpu_count() or 1)
_IN_FLIGHT = 4 * _WORKERS
_LONGEST_BYTES = 1 << 40
"""A length beyond this is part of the damage."""
_LEAST_S, _BYTES_PER_S = 60.0, 1e6
"""The time limit for a damaged file: so much, and for each byte."""


@dataclass(frozen=True, slots=True)
class Recovered:
    """A new run file at `path`.

    rows : by table, how many are in it
    lost_rows : by table, how many more the old file had begun or claimed
    unread_rows : by dataset, how many rows could not be read; they are NaN, or 0 where that is no number
    """

    path: Path
    rows: dict[str, int]
    lost_rows: dict[str, int]
    unread_rows: dict[str, int] = field(default_factory=dict)


class Source:
    """A run file that is written anew. Raises what h5py raises for a part that cannot be read, unless `damaged`."""

    def __init__(self, file: h5py.File, *, damaged: bool = False) -> None:
        self._file, self._damaged = file, damaged
        self._ignored: tuple[type[Exception], ...] = BROKEN if damaged else ()
        self.begun: dict[str, int] = {}
        """Rows of the longest column of each table."""
        self.unread: dict[str, int] = {}

    def content(self) -> Content:
        """Return all but the rows."""
        values = {scalar.path: self._scalar(scalar) for scalar in layout.SCALARS}
        for path in layout.TRUTH.datasets:
            with suppress(*self._ignored):
                values[path] = read_value(self._file, path)
        profile = {}
        with suppress(*self._ignored):
            attributes = self._file["/entry/profile/values"].attrs
            for name in attributes:
                with suppress(*self._ignored):
                    profile[name] = opening.plain(attributes[name])
        profile.pop("NX_class", None)
        return Content(values, profile, {table.path: self._rows(table) for table in layout.TABLES})

    def _scalar(self, scalar: Scalar) -> Any:
        with suppress(*self._ignored):
            value = read_value(self._file, scalar.path)
            if value is not None and scalar.dtype == "json":
                return value.tobytes()
            if value is not None and scalar.dtype == "texts":
                return [one.decode() for one in value.tolist()]
            if value is not None:
                return value.item().decode() if scalar.dtype == "text" else value.item()
        return UNKNOWN.get(scalar.dtype, b"")

    def dataset(self, path: str) -> h5d.DatasetID | None:
        """Return a column or a compound table; None if there is none, or it is damaged."""
        with suppress(*self._ignored):
            dataset = open_dataset(self._file, path)
            if dataset is not None and dataset.rank != 1:
                raise ValueError(f"{path} is no column")
            return dataset
        return None

    def _rows(self, table: Table) -> int:
        """Return the number of rows to write: if damaged, of the longest column, as far as times can be read."""
        datasets = {path: dataset for path in table.datasets if (dataset := self.dataset(path)) is not None}
        lengths = [int(dataset.shape[0]) for dataset in datasets.values()]
        self.begun[table.path] = max(lengths, default=0)
        if not self._damaged:
            return min(lengths, default=0)
        clock = datasets.get(f"{table.path}/time")
        if clock is None:
            return max(lengths, default=0)
        rows, step = int(clock.shape[0]), _chunk_rows(clock)
        for first in range(0, rows, step):
            try:
                _read_rows(clock, first, np.empty(min(step, rows - first), clock.dtype))
            except BROKEN:
                return first
        return rows

    def read(self, path: str, dataset: h5d.DatasetID, first: int, values: NDArray[Any]) -> None:
        """Fill `values`, which are unknown, with rows from `first` on; of a damaged dataset chunk by chunk."""
        present = min(len(values), max(0, dataset.shape[0] - first))
        step = _chunk_rows(dataset) if self._damaged else max(1, present)
        unread = len(values) - present
        for start in range(0, present, step):
            piece = values[start : min(start + step, present)]
            try:
                _read_rows(dataset, first + start, piece)
            except self._ignored:
                piece[...] = unknown_rows(len(piece), piece.dtype)
                unread += len(piece)
        if unread:
            self.unread[path] = self.unread.get(path, 0) + unread


def _read_rows(dataset: h5d.DatasetID, first: int, values: NDArray[Any]) -> None:
    place = dataset.get_space()
    place.select_hyperslab((first,), values.shape)
    dataset.read(h5s.create_simple(values.shape), place, values)


def _chunk_rows(dataset: h5d.DatasetID) -> int:
    properties = dataset.get_create_plist()
    if properties.get_layout() == h5d.CHUNKED:
        return int(properties.get_chunk()[0])
    return max(1, int(dataset.shape[0]))


def unknown_rows(count: int, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return rows of NaN, or 0 where that is no number."""
    rows: NDArray[Any] = np.zeros(count, dtype)
    for column in [rows[name] for name in dtype.names] if dtype.names else [rows]:
        if column.dtype.kind == "f":
            column[:] = np.nan
    return rows


def write_anew(source: Source, content: Content, target: Path) -> None:
    """Write the new file `target`, and sync it. Raises what h5py raises; then there is no `target`."""
    try:
        with (
            opening.open_hdf5(target, "x", libver=("earliest", "v110")) as file,
            ThreadPoolExecutor(_WORKERS) as pool,
        ):
            build_tree(file, content)
            for path in (path for table in layout.TABLES for path in table.datasets):
                _write_rows(source, path, h5d.open(file.id, path.encode()), pool)
        opening.append_checksum(target)
        sync(target)
    except BaseException as error:
        if not isinstance(error, FileExistsError):
            target.unlink(missing_ok=True)
        raise


def _write_rows(source: Source, path: str, made: h5d.DatasetID, pool: ThreadPoolExecutor) -> None:
    """Write all rows of a dataset; threads compress chunks while the next ones are read."""
    dataset = source.dataset(path)
    rows, step = made.shape[0], _chunk_rows(made)
    compressed = made.get_create_plist().get_layout() == h5d.CHUNKED
    waiting: deque[tuple[int, Future[bytes]]] = deque()
    for first in range(0, rows, step):
        values = unknown_rows(min(step, rows - first), made.dtype)
        if dataset is not None:
            source.read(path, dataset, first, values)
        if not compressed:
            made.write(h5s.ALL, h5s.ALL, values)
            continue
        waiting.append((first, pool.submit(_filtered, values, step)))
        if len(waiting) >= _IN_FLIGHT:
            start, chunk = waiting.popleft()
            made.write_direct_chunk((start,), chunk.result())
    for start, chunk in waiting:
        made.write_direct_chunk((start,), chunk.result())


def _filtered(values: NDArray[np.generic], chunk_rows: int) -> bytes:
    """Return a chunk as HDF5's filters shuffle and gzip make it; a last one that is not full ends in zeros."""
    size = values.dtype.itemsize
    planes = np.zeros((size, chunk_rows), np.uint8)
    planes[:, : len(values)] = values.view(np.uint8).reshape(len(values), size).T
    return zlib.compress(planes.data, GZIP_LEVEL)


def close_run(partial: Path, path: Path) -> None:
    """Make `path` of the closed file `partial`. Raises RunFileError E9004 for a taken name; `partial` stays then."""
    closing = path.with_name(path.name + CLOSING)
    try:
        closing.unlink(missing_ok=True)
        # Every chunk is read once: a cache would keep up to 8 MB of each dataset.
        with opening.open_hdf5(partial, rdcc_nbytes=0) as file:
            source = Source(file)
            write_anew(source, source.content(), closing)
    except HDF5_ERRORS:
        # Better large than lost: the disk may not have room for a second file.
        rename_without_replacing(partial, path)
        return
    try:
        rename_without_replacing(closing, path)
    except RunFileError as error:
        closing.unlink(missing_ok=True)
        raise cannot_name(partial, path, error.__cause__ or error) from error
    partial.unlink(missing_ok=True)


def is_complete(path: Path) -> bool:
    """Whether there is nothing to recover: a file with an end and a check sum that fits."""
    return path.suffix != PARTIAL and opening.is_whole(path)


def recover(path: Path, target: Path | None = None) -> Recovered:
    """Write all that a killed writer left at `path` into a new file; the old one stays as it is.

    Raises RunFileError: E9001 the new name is taken, E9002 it cannot be written, E9005 this is no run file, E9006
    another version wrote it, E9007 a part of it cannot be read (`recover_damaged` copes with that), E9014 a process
    is still writing it.
    """
    target = _target(path, target)
    with opening.open_file(path) as file:
        try:
            source = Source(file)
            return _written(source, source.content(), path, target)
        except BROKEN as error:
            if error_number(error) is None:
                raise failures.run_file_damaged(path=path, why=reason(error)) from error
            # The operating system has refused: it is the new file's disk.
            raise failures.run_not_recovered(path=path, target=target, error=reason(error)) from error


def recover_damaged(path: Path, target: Path | None = None) -> Recovered:
    """Write what can be read of a damaged file into a new one. Raises as `recover`, E9007 if that is nothing."""
    target = _target(path, target)
    command = [sys.executable, "-m", "edmctl.record.recovery", str(path), str(target)]
    limit_s = _LEAST_S + path.stat().st_size / _BYTES_PER_S
    try:
        ended = subprocess.run(command, capture_output=True, text=True, check=False, timeout=limit_s)
        answer = json.loads(ended.stdout)
    except subprocess.TimeoutExpired:
        why = f"reading it did not end within {limit_s:.0f} s"
        raise failures.run_file_beyond_recovery(path=path, why=why) from None
    except ValueError:
        why = f"reading it ended with status {ended.returncode}"
        raise failures.run_file_beyond_recovery(path=path, why=why) from None
    if "error" in answer:
        raise RunFileError(answer["error"], code=answer["code"], hint=answer["hint"])
    return Recovered(**answer | {"path": Path(answer["path"])})


def _target(path: Path, target: Path | None) -> Path:
    """Return `a.h5` or `a.recovered.h5`. Raises RunFileError: E9001 it is taken, E9014 `path` is still written."""
    if target is None and path.suffix == PARTIAL:
        target = path.with_suffix("")
    target = target or path.parent / f"{path.stem}.recovered{path.suffix}"
    if os.path.lexists(target):
        raise failures.recovery_target_exists(target=target)
    if is_live(path):
        raise failures.run_still_written(path=path)
    return target


def _temporary(target: Path, ending: str) -> Path:
    """Return the name of a file while this process makes it."""
    return target.with_name(f"{target.name}.{os.getpid()}{ending}")


def _written(source: Source, content: Content, path: Path, target: Path) -> Recovered:
    """Write the new file with an end and name it. Raises what h5py raises, RunFileError E9001 for a taken name."""
    values, new = content.values, _temporary(target, RECOVERING)
    now = datetime.now(UTC).isoformat(timespec="seconds")
    values["/entry/recovery"] = fit_utf8(f"from {path.name} by edmctl {__version__} at {now}", 160)
    if not values["/entry/end_time"]:
        values["/entry/end_time"] = (iso_of(path.stat().st_mtime) or now).encode()
        values["/entry/status"] = RECOVERED.encode()
    write_anew(source, content, new)
    try:
        rename_without_replacing(new, target)
    except RunFileError as error:
        new.unlink(missing_ok=True)
        raise failures.recovery_target_exists(target=target) from error
    # Of a writer that died while it closed the file.
    target.with_name(target.name + CLOSING).unlink(missing_ok=True)
    rows = dict(content.rows or {})
    lost = {name: source.begun[name] - count for name, count in rows.items() if source.begun[name] > count}
    return Recovered(target, rows, lost, source.unread)


def _recover_damaged_here(path: Path, target: Path) -> Recovered:
    copy = _temporary(target, ".copy")
    try:
        end_bytes = opening.read_superblock(path)[0] or 0
        missing = end_bytes - path.stat().st_size if end_bytes <= _LONGEST_BYTES else 0
        is_copied = missing > 0 or bool(opening.heap_breaks(path))
        if is_copied:
            shutil.copyfile(path, copy)
            if missing > 0:
                os.truncate(copy, end_bytes)
            opening.end_at_breaks(copy)
        with opening.open_unjudged(copy if is_copied else path) as file:
            opening.refuse_foreign(path, file)
            source = Source(file, damaged=True)
            content = source.content()
            if not any((content.rows or {}).values()):
                raise failures.run_file_beyond_recovery(path=path, why="none of its rows can be read")
            content.values["/entry/status"] = RECOVERED.encode()
            return _written(source, content, path, target)
    except BROKEN as error:
        raise failures.run_file_beyond_recovery(path=path, why=reason(error)) from error
    finally:
        copy.unlink(missing_ok=True)


def main() -> None:
    """Recover for the parent process; the answer is one JSON object."""
    path, target = map(Path, sys.argv[1:])
    try:
        answer = asdict(_recover_damaged_here(path, target))
    except RunFileError as error:
        answer = {"error": error.message, "code": error.code, "hint": error.hint}
    print(json.dumps(answer, default=str))  # noqa: T201 - the parent reads it


if __name__ == "__main__":
    main()
