"""Writes a run file so that a killed process loses at most its last half second.

The file is created new, never opened again for writing, and written in SWMR mode under `NAME.partial`;
`finish` gives it its name. A killed writer leaves a file that opens with `h5py.File(path, "r", swmr=True)`
and holds every flushed row.

A thread of its own writes it, so that control of the machine never waits for the disk. Rows are handed over in about
a microsecond and written in order: urgent ones at once, others after 0.5 s, and synced every ten seconds. h5py,
`posix_fallocate` and `fsync` let other threads run while they wait for the disk.
"""

from __future__ import annotations

import contextlib
import json
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from operator import attrgetter
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import numpy as np
from h5py import h5s, h5t
from numpy.typing import NDArray

from edmctl import failures
from edmctl.errors import RunFileError
from edmctl.record import disk, layout
from edmctl.record.disk import GIVE_UP_S
from edmctl.record.layout import Column, Table, fit_utf8
from edmctl.record.opening import image_of, open_hdf5, read_superblock
from edmctl.record.recovery import close_run
from edmctl.record.rows import EventRow, RejectedTouch, Row, RunMeta, Segment, Summary, TruthMap
from edmctl.results.job import SiteResult
from edmctl.results.telemetry import PulseTrain

CHUNKS_PER_WRITE = 4
"""A store writes when this many chunks wait: fewer and larger calls into HDF5. The flush does not wait."""
FLUSH_INTERVAL_S = 0.5
"""Rows reach the disk at most this long, plus one block, after they were handed over."""
CHUNK_CACHE_BYTES = 256 * 1024
"""Of each of the 70 datasets: two of the largest chunks. HDF5 would keep up to 8 MB that are never read again."""
_ARGS_BYTES = next(np.dtype(c.dtype).itemsize for c in layout.EVENTS.columns if c.name == "args")


class _Store:
    """Rows of a table that wait to be written, handed over one by one or as blocks of arrays."""

    def __init__(self, file: h5py.File, table: Table) -> None:
        self._table, self._row_type = table, table.row_type
        self._fields = attrgetter(*(column.field for column in table.columns))
        # h5py's low-level calls with a type made once take a sixth of the time of `dataset[a:b] = values`.
        datasets = [file[path] for path in table.datasets]
        self._datasets = [(one.id, h5t.py_create(one.dtype, logical=True)) for one in datasets]
        self._waiting: list[tuple[Any, ...]] = []
        self._written = 0
        self.waiting = 0
        """Rows that wait."""
        self.limit = CHUNKS_PER_WRITE * table.chunk_rows
        """Rows from which on it is worth writing."""

    def add(self, row: object) -> None:
        """Keep a row or block until it is written."""
        values = self._fields(row)
        self._waiting.append(values)
        self.waiting += len(values[0]) if self._table.in_blocks else 1

    @property
    def rows(self) -> int:
        """Rows handed over so far."""
        return self._written + self.waiting

    @property
    def growth_bytes(self) -> int:
        """How much the file may grow when everything that waits is written: space is taken by whole chunks."""
        rows = self._table.chunk_rows
        chunks = -(-self.rows // rows) - -(-self._written // rows)
        return chunks * rows * self._row_type.itemsize

    def write(self, *, everything: bool) -> None:
        """Write the whole chunks that wait, or everything. Raises what HDF5 raises."""
        count = self.waiting - (0 if everything else self.rows % self._table.chunk_rows)
        if count <= 0:
            return
        space = h5s.create_simple((count,))
        for (dataset, kind), column in zip(self._datasets, self._take(count), strict=True):
            dataset.set_extent((self._written + count,))
            place = dataset.get_space()
            place.select_hyperslab((self._written,), (count,))
            dataset.write(space, place, column, kind)
        self._written += count
        self.waiting -= count

    def _take(self, count: int) -> list[NDArray[Any]]:
        """Take the first rows that wait, as each dataset stores them."""
        columns = self._table.columns
        if self._table.in_blocks:
            arrays = [np.concatenate(parts) for parts in zip(*self._waiting, strict=True)]
            if any(array.shape != (self.waiting,) for array in arrays):
                raise TypeError("columns of a block differ in length")
            # What still waits is kept as it was handed over: it is not put into steps twice.
            self._waiting = [tuple(array[count:] for array in arrays)] if count < self.waiting else []
            return [_stored(array[:count], column) for array, column in zip(arrays, columns, strict=True)]
        rows, self._waiting = self._waiting[:count], self._waiting[count:]
        if not self._table.is_compound:
            pairs = zip(columns, zip(*rows, strict=True), strict=True)
            return [np.array(values, column.dtype) for column, values in pairs]
        widths = [np.dtype(column.dtype).itemsize for column in columns]
        fitted = [
            tuple(
                fit_utf8(v or "", width) if v is None or isinstance(v, str) else v
                for v, width in zip(row, widths, strict=True)
            )
            for row in rows
        ]
        return [np.array(fitted, self._row_type)]


def _stored(values: NDArray[Any], column: Column) -> NDArray[Any]:
    """Return a column as it is stored; values beyond the range of its steps become its ends."""
    dtype = np.dtype(column.dtype)
    if column.step != 1.0:
        steps = np.divide(values, column.step, dtype="f8")
        values = np.rint(np.clip(steps, 0, 256**dtype.itemsize - 1))
    return np.ascontiguousarray(values, dtype)


class RunWriter:
    """Recorder into one run file. Build it with `create`; end it with `finish`."""

    def __init__(self, file: h5py.File, path: Path, partial: Path) -> None:
        self._file = file
        self._path = path
        self._partial = partial
        self._lock = disk.hold_lock(partial)
        self._failure: RunFileError | None = None
        self._accepts = True
        self._stores = {kind: _Store(file, table) for kind, table in layout.TABLE_OF.items()}
        self._segment: Segment | None = None
        self._wear_um = 0.0

    @classmethod
    def create(cls, path: Path, meta: RunMeta) -> RunWriter:
        """Create `path`.partial with its layout, in SWMR mode. Raises RunFileError E9001, E9002."""
        partial, content = disk.partial_path(path), layout.initial_content(meta)
        versions = layout.LIBRARY_VERSIONS
        try:
            disk.make_folder(path.parent)
            if os.path.lexists(path):
                raise failures.run_file_exists(existing=path)
            disk.write_new(partial, image_of(lambda file: layout.build_tree(file, content), libver=versions))
        except FileExistsError as error:
            raise failures.run_file_exists(existing=partial) from error
        except OSError as error:
            raise failures.run_file_not_created(path=path, why=disk.reason(error)) from error
        try:
            file = open_hdf5(partial, "r+", libver=versions, rdcc_nbytes=CHUNK_CACHE_BYTES)
            file.swmr_mode = True
        except disk.HDF5_ERRORS as error:
            raise failures.run_file_not_created(path=path, why=disk.reason(error)) from error
        return cls(file, path, partial)

    @property
    def path(self) -> Path:
        """The file under its present name."""
        return self._partial if self._partial.exists() else self._path

    def append(self, row: Row) -> None:
        """Append a row, or a block by reference; urgent ones are then on disk. Raises RunFileError E9003 once."""
        if not self._accepts:
            return
        store = self._stores.get(type(row))
        if store is None:
            self._put(row)
            return
        if isinstance(row, PulseTrain):
            self._follow(row, store.rows)
        elif isinstance(row, SiteResult):
            self._wear_um += row.wear_um
            self._guarded(lambda: self._set("/entry/tool/length_wear_total", self._wear_um))
        store.add(_stored_event(row, store.rows) if isinstance(row, EventRow) else row)
        if layout.is_urgent(row):
            self.flush()
        elif store.waiting >= store.limit:
            self._guarded(lambda: store.write(everything=False))

    def _put(self, row: Row) -> None:
        """Write what has no table of its own."""
        if isinstance(row, RejectedTouch):
            self._guarded(lambda: self._reject_touch(row.time_s))
            return
        if isinstance(row, TruthMap):
            truth = layout.TRUTH
            arrays = {f"{truth.path}/{one.name}": getattr(row, one.field) for one in truth.columns}
        else:
            assert isinstance(row, Summary)
            arrays = {"/entry/summary": np.frombuffer(row.json_text.encode(), np.uint8)}
        growth_bytes = 2 * sum(values.nbytes for values in arrays.values())
        self._guarded(lambda: self._replace(arrays), growth_bytes)

    def flush(self) -> None:
        """Bring everything handed over so far to the operating system."""
        if self._accepts:
            self._guarded(self._flush)

    def sync(self) -> None:
        """Bring everything handed over so far to the disk itself, and wait until it has it."""

        def write_through() -> None:
            self._flush()
            os.fsync(self._file.id.get_vfd_handle())

        if self._accepts:
            self._guarded(write_through)

    def finish(self, status: str, exit_code: int) -> Path:
        """Write the end, close, and name the file. Raises RunFileError E9003 (disk), E9004 (name is taken)."""
        if self._failure is not None:
            raise self._failure
        if self._accepts:
            self._guarded(lambda: self._end(status, exit_code))
            self._accepts = False
            try:
                close_run(self._partial, self._path)
            finally:
                disk.release_lock(self._lock)
        return self._path

    def _follow(self, train: PulseTrain, row: int) -> None:
        """Begin a segment where `train`, stored from `row` on, does not continue the last one."""
        if self._segment is None or not self._segment.continues_in(train, row):
            self._segment = Segment(row, train.first_pulse, train.start_s, train.period_s)
            self._stores[Segment].add(self._segment)

    def _guarded(self, action: Callable[[], None], more_bytes: int = 0) -> None:
        """Do what writes to the file, in space taken before; the rows that wait and `more_bytes` fit into it."""
        try:
            waiting_bytes = sum(store.growth_bytes for store in self._stores.values())
            disk.reserve(self._file, more_bytes + waiting_bytes)
            action()
        except disk.HDF5_ERRORS as error:
            self._accepts = False
            disk.close_without_writing(self._file)
            disk.release_lock(self._lock)
            why = disk.reason(error)
            self._failure = failures.run_file_not_written(partial=self._partial, error=why)
            raise self._failure from error

    def _flush(self) -> None:
        for store in self._stores.values():
            store.write(everything=True)
        self._file.flush()

    def _reject_touch(self, time_s: float) -> None:
        table = self._file[layout.TOUCHES.path]
        rows = table[:]
        rows["accepted"][rows["time"] == time_s] = 0
        table[:] = rows
        self._file.flush()

    def _set(self, path: str, value: object) -> None:
        self._file[path][()] = value

    def _replace(self, arrays: Mapping[str, NDArray[np.generic]]) -> None:
        for path, values in arrays.items():
            self._file[path].resize(values.shape)
            self._file[path][...] = values

    def _end(self, status: str, exit_code: int) -> None:
        self._flush()
        self._set("/entry/end_time", datetime.now(UTC).isoformat(timespec="milliseconds").encode())
        self._set("/entry/exit_code", exit_code)
        self._set("/entry/status", status.encode())
        self._file.flush()
        self._file.close()
        # What was reserved and not used is cut off the file, if it is still there.
        with contextlib.suppress(FileNotFoundError):
            if (end_bytes := read_superblock(self._partial)[0]) is not None:
                os.truncate(self._partial, end_bytes)


def _stored_event(row: EventRow, seq: int) -> SimpleNamespace:
    args = dict(row.args)
    while len(text := json.dumps(args, separators=(",", ":"))) > _ARGS_BYTES:
        args.popitem()
    return SimpleNamespace(
        time_s=row.time_s, seq=seq, code=row.code, level=row.level, message=row.message, args=text
    )


BACKLOG_BYTES = 64 * 1024 * 1024
"""Rows that may wait in memory: about six minutes of the full log (1 kHz servo and every pulse at 2.3 kHz are
0.15 MB/s here). A network share that is away for a minute costs nothing, and a run of 8 h stays below 300 MB."""
SYNC_INTERVAL_S = 10.0
"""A power cut loses at most the rows of this time, plus what the disk takes to keep them."""
LOOK_S = 0.5
"""At the end the thread is looked at so often."""
_WAKE_BYTES = 1024 * 1024
"""The thread does not sleep on more: far above what comes in half a second of a real run, so that only a virtual
one, which is a thousand times as fast, wakes it by this."""
_ROW_BYTES = 1024
"""Counted for whatever is handed over as a single row."""


class BackgroundWriter:
    """Recorder whose rows a thread writes. An error of the disk is raised once; all calls come from one thread."""

    def __init__(self, writer: RunWriter, *, waits: bool) -> None:
        self._writer = writer
        self._waits = waits
        self._rows: deque[tuple[Row, int]] = deque()
        """Rows that wait, each with its memory."""
        # Each is changed by one thread only: handing over takes no lock.
        self._handed_bytes = self._taken_bytes = 0
        self._taken_at_s = time.monotonic()
        self._wake, self._taken = threading.Event(), threading.Event()
        self._end: tuple[str, int] | None = None
        self._failure: BaseException | None = None
        self._accepts = True
        self._hangs = self._closes = False
        self._thread = threading.Thread(target=self._run, name="run file", daemon=True)
        self._thread.start()

    @classmethod
    def create(cls, path: Path, meta: RunMeta, *, waits: bool = False) -> BackgroundWriter:
        """As `RunWriter.create`; `waits` makes callers wait for a slow disk, as in virtual time, without E9009."""
        return cls(RunWriter.create(path, meta), waits=waits)

    @property
    def path(self) -> Path:
        return self._writer.path

    @property
    def _backlog_bytes(self) -> int:
        return self._handed_bytes - self._taken_bytes

    def append(self, row: Row) -> None:
        """Hand a row over, or a block whose arrays are kept by reference; urgent ones are flushed at once."""
        if not self._accepts:
            return
        backlog_bytes = self._backlog_bytes
        if self._failure is None and backlog_bytes > BACKLOG_BYTES:
            self._hold_up()
        if self._failure is not None:
            self._accepts = False
            raise self._failure
        size = _size(row)
        self._rows.append((row, size))
        self._handed_bytes += size
        # A thread that is awake, but has not cleared this yet, takes the row too.
        if (backlog_bytes > _WAKE_BYTES or layout.is_urgent(row)) and not self._wake.is_set():
            self._wake.set()

    def _hold_up(self) -> None:
        """Wait until there is room, or conclude that the disk hangs."""
        if not self._waits:
            self._give_up()
        while self._waits and self._backlog_bytes > BACKLOG_BYTES and self._thread.is_alive():
            self._taken.clear()
            self._wake.set()
            # With a limit, in case the last was taken just before `clear`.
            self._taken.wait(0.1)

    def _give_up(self) -> None:
        self._hangs = True
        still_s, waiting_mb = time.monotonic() - self._taken_at_s, self._backlog_bytes / 2**20
        error = failures.disk_too_slow(path=self.path, still_s=still_s, waiting_mb=waiting_mb)
        self._failure = self._failure or error

    def finish(self, status: str, exit_code: int) -> Path:
        """Write the remaining rows and finish. Raises RunFileError: E9003, E9004, and E9009 if the disk hangs."""
        self._accepts = False
        self._end = self._end or (status, exit_code)
        self._wake.set()
        begun_s = time.monotonic()
        while self._thread.is_alive():
            self._thread.join(GIVE_UP_S if self._hangs else LOOK_S)
            if self._hangs:
                break
            # Closing may take its time.
            if not self._closes and time.monotonic() - max(begun_s, self._taken_at_s) > GIVE_UP_S:
                self._give_up()
                break
        if self._failure is not None:
            raise self._failure
        return self.path

    def abandon(self, status: str, exit_code: int) -> Path:
        """As `finish`, for a run that did not reach its aim; raises no RunFileError. Returns where its rows are."""
        with contextlib.suppress(RunFileError):
            self.finish(status, exit_code)
        return self.path

    def _run(self) -> None:
        disk.leave_signals_to_the_main_thread()
        try:
            self._write_until_the_end()
        except BaseException as error:
            # Whatever it is, the caller gets it; it ends the job.
            self._failure = self._failure or error
        finally:
            self._rows.clear()
            self._taken.set()

    def _write_until_the_end(self) -> None:
        unflushed = unsynced = False
        flushed_s = synced_s = time.monotonic()
        while True:
            self._wake.wait(FLUSH_INTERVAL_S)
            self._wake.clear()
            # Read first: what was handed over before the end is written before it.
            end = self._end
            if self._rows:
                unflushed = unsynced = True
            for _ in range(len(self._rows)):
                row, size = self._rows.popleft()
                self._writer.append(row)
                self._taken_bytes += size
                self._taken_at_s = time.monotonic()
            self._taken.set()
            if end is not None:
                self._closes = True
                path = self._writer.finish(*end)
                disk.sync_if_possible(path, path.parent)
                return
            now_s = time.monotonic()
            if unsynced and now_s - synced_s >= SYNC_INTERVAL_S:
                self._writer.sync()
                unsynced = unflushed = False
                flushed_s = synced_s = now_s
            elif unflushed and now_s - flushed_s >= FLUSH_INTERVAL_S:
                self._writer.flush()
                unflushed, flushed_s = False, now_s


def _size(row: Row) -> int:
    """Return the memory of a row, or of a block, whose arrays have at most 8 bytes a value."""
    table = layout.TABLE_OF.get(type(row))
    if table is not None and table.in_blocks:
        return 8 * len(table.columns) * len(getattr(row, table.columns[0].field))
    return row.depth_um.nbytes if isinstance(row, TruthMap) else _ROW_BYTES
