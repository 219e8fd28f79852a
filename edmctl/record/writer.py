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
from edmctl.dataclasses import dataclass
from edmctl.errors import RunFileError
from edmctl.record import layout
from edmctl.record.create import LIBRARY_VERSIONS, compound_dtype, empty_run_file, fit_utf8
from edmctl.record.disk import (
    GIVE_UP_S,
    HDF5_ERRORS,
    close_without_writing,
    leave_signals_to_the_main_thread,
    make_folder,
    make_lasting,
    partial_path,
    reason,
    reserve,
    write_new,
)
from edmctl.record.layout import Table
from edmctl.record.locks import hold, release
from edmctl.record.opening import open_hdf5, read_superblock
from edmctl.record.recovery import close_run
from edmctl.record.rows import EventRow, RejectedTouch, Row, RunMeta, Summary, TruthMap
from edmctl.results.job import SiteResult
from edmctl.results.telemetry import PulseTrain

CHUNKS_PER_WRITE = 4
"""A store writes when this many chunks wait: fewer and larger calls into HDF5. The flush does not wait."""
TIME_TOLERANCE_S = 2e-6
"""How far the start of a train may be from a segment's count: twice the LSB of a controller's time."""


class RowStore:
    """Rows of a table that are handed over one by one, the texts among them cut to their field."""

    def __init__(self, file: h5py.File, table: Table) -> None:
        self._table = table
        self._row_type = compound_dtype(table)
        self._fields = attrgetter(*(column.field for column in table.columns))
        item = file[table.path]
        datasets = [item] if table.is_compound else [item[column.name] for column in table.columns]
        # h5py's low-level calls with a type made once take a sixth of the time of `dataset[a:b] = values`.
        self._datasets = [(one.id, h5t.py_create(one.dtype, logical=True)) for one in datasets]
        self._waiting: list[tuple[Any, ...]] = []
        self._written = 0
        self.waiting = 0
        """Rows that wait."""
        self.limit = CHUNKS_PER_WRITE * table.chunk_rows
        """Rows from which on it is worth writing."""

    def add(self, row: object) -> None:
        """Keep a row until it is written."""
        self._waiting.append(self._fields(row))
        self.waiting += 1

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
        values, kept = self._taken(count)
        space = h5s.create_simple((count,))
        for (dataset, kind), column in zip(self._datasets, values, strict=True):
            dataset.set_extent((self._written + count,))
            place = dataset.get_space()
            place.select_hyperslab((self._written,), (count,))
            dataset.write(space, place, column, kind)
        self._waiting = kept
        self._written += count
        self.waiting -= count

    def _taken(self, count: int) -> tuple[list[NDArray[Any]], list[tuple[Any, ...]]]:
        """The first rows that wait, as each dataset stores them, and what waits on."""
        rows, kept = self._waiting[:count], self._waiting[count:]
        if not self._table.is_compound:
            columns = zip(self._table.columns, zip(*rows, strict=True), strict=True)
            return [np.array(values, column.dtype) for column, values in columns], kept
        widths = [np.dtype(column.dtype).itemsize for column in self._table.columns]
        fitted = [
            tuple(
                fit_utf8(v or "", width) if v is None or isinstance(v, str) else v
                for v, width in zip(row, widths, strict=True)
            )
            for row in rows
        ]
        return [np.array(fitted, self._row_type)], kept


class BlockStore(RowStore):
    """Rows of a table that are handed over as blocks of arrays."""

    def add(self, row: object) -> None:
        """Keep a block until it is written."""
        arrays = self._fields(row)
        self._waiting.append(arrays)
        self.waiting += len(arrays[0])

    def _taken(self, count: int) -> tuple[list[NDArray[Any]], list[tuple[Any, ...]]]:
        arrays = [np.concatenate(parts) for parts in zip(*self._waiting, strict=True)]
        if any(array.shape != (self.waiting,) for array in arrays):
            raise TypeError("columns of a block differ in length")
        columns = zip(self._table.columns, arrays, strict=True)
        stored = [_stored(array[:count], np.dtype(column.dtype), column.step) for column, array in columns]
        # What waits on is kept as it was handed over: it is not put into steps twice.
        return stored, [tuple(array[count:] for array in arrays)] if count < self.waiting else []


def store_of(file: h5py.File, table: Table) -> RowStore:
    """Return the store of a table, however its rows are handed over."""
    return BlockStore(file, table) if table.in_blocks else RowStore(file, table)


def _stored(values: NDArray[Any], dtype: np.dtype[Any], step: float) -> NDArray[Any]:
    """Return a column as it is stored; values beyond the range of its steps become its ends."""
    if step != 1.0:
        steps = np.divide(values, step, dtype="f8")
        values = np.rint(np.clip(steps, 0, 256**dtype.itemsize - 1))
    return np.ascontiguousarray(values, dtype)


@dataclass(frozen=True, slots=True)
class Segment:
    """Pulses from row `first_row` on: pulse first_row + i begins at start_s + i × period_s."""

    first_row: int
    first_pulse: int
    start_s: float
    period_s: float

    def continues_in(self, train: PulseTrain, row: int) -> bool:
        """Whether `train`, stored from `row` on, follows the segment's pulses without a gap."""
        passed = row - self.first_row
        return (
            train.period_s == self.period_s
            and train.first_pulse == self.first_pulse + passed
            and abs(self.start_s + passed * self.period_s - train.start_s) <= TIME_TOLERANCE_S
        )


FLUSH_INTERVAL_S = 0.5
"""Rows reach the disk at most this long, plus one block, after they were handed over."""
CHUNK_CACHE_BYTES = 256 * 1024
"""Of each of the 70 datasets: two of the largest chunks. HDF5 would keep up to 8 MB that are never read again."""
_ARGS_BYTES = next(np.dtype(c.dtype).itemsize for c in layout.EVENTS.columns if c.name == "args")


class RunWriter:
    """Recorder into one run file. Build it with `create`; end it with `finish`."""

    def __init__(self, file: h5py.File, path: Path, partial: Path, monotonic_s: Callable[[], float]) -> None:
        self._file = file
        self._path = path
        self._partial = partial
        self._lock = hold(partial)
        self._monotonic_s = monotonic_s
        self._flush_due_s = monotonic_s() + FLUSH_INTERVAL_S
        self._failure: RunFileError | None = None
        self._accepts = True
        self._stores = {table.path: store_of(file, table) for table in layout.TABLES}
        self._store_of = {kind: self._stores[table.path] for kind, table in layout.TABLE_OF.items()}
        self._segment: Segment | None = None
        self._wear_um = 0.0

    @classmethod
    def create(
        cls, path: Path, meta: RunMeta, monotonic_s: Callable[[], float] = time.monotonic
    ) -> RunWriter:
        """Create `path`.partial with the whole layout in it and switch it to SWMR.

        Raises RunFileError: E9001 when the run exists already, E9002 when the file cannot be made.
        """
        partial = partial_path(path)
        try:
            make_folder(path.parent)
            if os.path.lexists(path):
                raise failures.run_file_exists(existing=path)
            write_new(partial, empty_run_file(meta))
        except FileExistsError as error:
            raise failures.run_file_exists(existing=partial) from error
        except OSError as error:
            raise failures.run_file_not_created(path=path, why=reason(error)) from error
        try:
            file = open_hdf5(partial, "r+", libver=LIBRARY_VERSIONS, rdcc_nbytes=CHUNK_CACHE_BYTES)
            file.swmr_mode = True
        except HDF5_ERRORS as error:
            raise failures.run_file_not_created(path=path, why=reason(error)) from error
        return cls(file, path, partial, monotonic_s)

    @property
    def path(self) -> Path:
        """The file as it is called now."""
        return self._partial if self._partial.exists() else self._path

    def append(self, row: Row) -> None:
        """Append a row, or a block whose arrays are kept by reference.

        Urgent ones (`layout.is_urgent`) are on disk when the call returns. Raises RunFileError E9003 once, when the
        disk fails; later rows are ignored.
        """
        if not self._accepts:
            return
        store = self._store_of.get(type(row))
        if store is not None:
            if isinstance(row, PulseTrain):
                self._follow(row, store.rows)
            elif isinstance(row, SiteResult):
                self._wear_um += row.wear_um
                self._guarded(self._put_wear)
            store.add(_stored_event(row, store.rows) if isinstance(row, EventRow) else row)
            if layout.is_urgent(row) or self._monotonic_s() >= self._flush_due_s:
                self.flush()
            elif store.waiting >= store.limit:
                self._guarded(lambda: store.write(everything=False))
        elif isinstance(row, RejectedTouch):
            self._guarded(lambda: self._reject_touch(row.time_s))
        elif isinstance(row, TruthMap):
            columns = (layout.TRUTH.signal, *layout.TRUTH.axes)
            self._put({f"{layout.TRUTH.path}/{one.name}": getattr(row, one.field) for one in columns})
        else:
            assert isinstance(row, Summary)
            self._put({"/entry/summary": np.frombuffer(row.json_text.encode(), np.uint8)})

    def flush(self) -> None:
        """Bring everything handed over so far to the operating system."""
        if self._accepts:
            self._guarded(self._flush)

    def sync(self) -> None:
        """Bring everything handed over so far to the disk itself, and wait until it has it."""
        if self._accepts:
            self._guarded(self._sync)

    def finish(self, status: str, exit_code: int) -> Path:
        """Write the end, close, and give the file its name; an existing file is never replaced.

        Returns the final path. Raises RunFileError: E9003 when the disk fails or failed before, E9004 when
        the name was taken meanwhile. In both cases the rows stay in the `.partial` file.
        """
        if self._failure is not None:
            raise self._failure
        if self._accepts:
            self._guarded(lambda: self._end(status, exit_code))
            self._accepts = False
            try:
                close_run(self._partial, self._path)
            finally:
                release(self._lock)
        return self._path

    def _follow(self, train: PulseTrain, row: int) -> None:
        """Begin a segment where `train`, stored from `row` on, does not continue the last one."""
        if self._segment is None or not self._segment.continues_in(train, row):
            self._segment = Segment(row, train.first_pulse, train.start_s, train.period_s)
            self._stores[layout.SEGMENTS.path].add(self._segment)

    def _guarded(self, action: Callable[[], None], more_bytes: int = 0) -> None:
        """Do what writes to the file, in space taken before; the rows that wait and `more_bytes` fit into it."""
        try:
            reserve(self._file, more_bytes + sum(store.growth_bytes for store in self._stores.values()))
            action()
        except HDF5_ERRORS as error:
            self._accepts = False
            close_without_writing(self._file)
            release(self._lock)
            self._failure = failures.run_file_not_written(partial=self._partial, error=reason(error))
            raise self._failure from error

    def _flush(self) -> None:
        for store in self._stores.values():
            store.write(everything=True)
        self._file.flush()
        self._flush_due_s = self._monotonic_s() + FLUSH_INTERVAL_S

    def _sync(self) -> None:
        self._flush()
        os.fsync(self._file.id.get_vfd_handle())

    def _reject_touch(self, time_s: float) -> None:
        table = self._file[layout.TOUCHES.path]
        rows = table[:]
        rows["accepted"][rows["time"] == time_s] = 0
        table[:] = rows
        self._file.flush()

    def _put_wear(self) -> None:
        self._file["/entry/tool/length_wear_total"][()] = self._wear_um

    def _put(self, arrays: Mapping[str, NDArray[np.generic]]) -> None:
        """Replace whole datasets."""

        def put() -> None:
            for path, values in arrays.items():
                self._file[path].resize(values.shape)
                self._file[path][...] = values

        self._guarded(put, more_bytes=2 * sum(values.nbytes for values in arrays.values()))

    def _end(self, status: str, exit_code: int) -> None:
        self._flush()
        entry = self._file["/entry"]
        entry["end_time"][()] = datetime.now(UTC).isoformat(timespec="milliseconds").encode()
        entry["exit_code"][()] = exit_code
        entry["status"][()] = status.encode()
        self._file.flush()
        self._file.close()
        # What was reserved and not used is cut off the file, if it is still there.
        with contextlib.suppress(FileNotFoundError):
            if (end_bytes := read_superblock(self._partial).end_bytes) is not None:
                os.truncate(self._partial, end_bytes)


def _stored_event(row: EventRow, seq: int) -> SimpleNamespace:
    kept = dict(row.args)
    while len(text := json.dumps(kept, separators=(",", ":"))) > _ARGS_BYTES:
        kept.popitem()
    own = {"time_s": row.time_s, "code": row.code, "level": row.level, "message": row.message}
    return SimpleNamespace(**own, seq=seq, args=text)


BACKLOG_BYTES = 64 * 1024 * 1024
"""Rows that may wait in memory: about six minutes of the full log (1 kHz servo and every pulse at 2.3 kHz are
0.15 MB/s here). A network share that is away for a minute costs nothing, and a run of 8 h stays below 300 MB."""
SYNC_INTERVAL_S = 10.0
"""A power cut loses at most the rows of this time, plus what the disk takes to keep them."""
LOOK_S = 0.5
"""At the end it is looked so often whether the disk still takes rows."""

_WAKE_BYTES = 1024 * 1024
"""The thread does not sleep on more: far above what comes in half a second of a real run, so that only a virtual
one, which is a thousand times as fast, wakes it by this."""
_VALUE_BYTES = 8
_ROW_BYTES = 1024
"""Counted for whatever is handed over as a single row."""


class BackgroundWriter:
    """Recorder that a thread writes into one run file. Build it with `create`; end it with `finish` or `abandon`.

    An error of the disk is raised once, by the first call after it; later rows are ignored. All calls come from one
    thread.
    """

    def __init__(self, writer: RunWriter, *, waits: bool) -> None:
        self._writer = writer
        self._waits = waits
        self._rows: deque[tuple[Row, int]] = deque()
        """Rows that wait, each with its memory."""
        # Each is changed by one thread only: handing over takes no lock.
        self._handed_bytes = 0
        self._taken_bytes = 0
        self._taken_at_s = time.monotonic()
        self._wake = threading.Event()
        self._taken = threading.Event()
        self._end: tuple[str, int] | None = None
        self._failure: BaseException | None = None
        self._accepts = True
        self._hangs = False
        self._closes = False
        self._thread = threading.Thread(target=self._run, name="run file", daemon=True)
        self._thread.start()

    @classmethod
    def create(cls, path: Path, meta: RunMeta, *, waits: bool = False) -> BackgroundWriter:
        """Create `path`.partial, as `RunWriter.create` does, and start to write into it.

        waits : whether the caller is made to wait when the disk is too slow, instead of getting RunFileError
        E9009; for a virtual machine, whose clock stops meanwhile. Raises RunFileError E9001, E9002.
        """
        return cls(RunWriter.create(path, meta), waits=waits)

    @property
    def path(self) -> Path:
        return self._writer.path

    def append(self, row: Row) -> None:
        """Hand a row over, or a block whose arrays are kept by reference; urgent ones are flushed at once."""
        if not self._accepts:
            return
        backlog_bytes = self._handed_bytes - self._taken_bytes
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

    def finish(self, status: str, exit_code: int) -> Path:
        """Have the rest and the end written, close, and give the file its name, as `RunWriter.finish` does.

        Returns the final path when the disk has it all. Raises RunFileError: E9003, E9004, and E9009 when the disk
        hung before.
        """
        self._leave(status, exit_code)
        if self._failure is not None:
            raise self._failure
        return self.path

    def abandon(self, status: str, exit_code: int) -> Path:
        """End a run that did not reach its aim: as `finish`, but never raises a RunFileError.

        Returns where the rows are: the final path, or the `.partial` file after a disk failure.
        """
        with contextlib.suppress(RunFileError):
            self.finish(status, exit_code)
        return self.path

    def _hold_up(self) -> None:
        """Wait until there is room, or take it that the disk hangs."""
        if not self._waits:
            self._hangs = True
            self._failure = self._hung()
            return
        while self._handed_bytes - self._taken_bytes > BACKLOG_BYTES and self._thread.is_alive():
            self._taken.clear()
            self._wake.set()
            # With a limit, in case the last was taken just before `clear`.
            self._taken.wait(0.1)

    def _hung(self) -> RunFileError:
        still_s = time.monotonic() - self._taken_at_s
        waiting_mb = (self._handed_bytes - self._taken_bytes) / 2**20
        return failures.disk_too_slow(path=self.path, still_s=still_s, waiting_mb=waiting_mb)

    def _leave(self, status: str, exit_code: int) -> None:
        """Tell the thread to end, and wait for it; not for ever where its disk hangs."""
        self._accepts = False
        if self._end is None:
            self._end = status, exit_code
        self._wake.set()
        # Closing may take its time; a disk that takes no rows for long is not waited for.
        left_s = time.monotonic()
        while self._thread.is_alive():
            self._thread.join(GIVE_UP_S if self._hangs else LOOK_S)
            if self._hangs:
                return
            if not self._closes and time.monotonic() - max(left_s, self._taken_at_s) > GIVE_UP_S:
                self._hangs = True
                self._failure = self._failure or self._hung()
                return

    def _run(self) -> None:
        leave_signals_to_the_main_thread()
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
        sync_due_s = time.monotonic() + SYNC_INTERVAL_S
        while True:
            woken = self._wake.wait(FLUSH_INTERVAL_S)
            self._wake.clear()
            # Read first: what was handed over before the end is written before it.
            end = self._end
            if self._rows:
                unflushed = unsynced = True
                self._work_off()
            if end is not None:
                self._closes = True
                make_lasting(self._writer.finish(*end))
                return
            # While it is woken all the time, the writer flushes by its own clock.
            if unflushed and not woken:
                self._writer.flush()
                unflushed = False
            if unsynced and time.monotonic() >= sync_due_s:
                self._writer.sync()
                unsynced = unflushed = False
                sync_due_s = time.monotonic() + SYNC_INTERVAL_S

    def _work_off(self) -> None:
        for _ in range(len(self._rows)):
            row, size = self._rows.popleft()
            self._writer.append(row)
            self._taken_bytes += size
            self._taken_at_s = time.monotonic()
        self._taken.set()


def _size(row: Row) -> int:
    """Memory of a row, or of a block, whose arrays are of 8 bytes a value at most."""
    table = layout.TABLE_OF.get(type(row))
    if table is not None and table.in_blocks:
        return _VALUE_BYTES * len(table.columns) * len(getattr(row, table.columns[0].field))
    return row.depth_um.nbytes if isinstance(row, TruthMap) else _ROW_BYTES
