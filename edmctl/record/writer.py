"""Writes a run file so that a killed process loses at most its last half second.

The file is created new, never opened again for writing, and written in SWMR mode under `NAME.partial`;
`finish` gives it its name. A killed writer leaves a file that opens with `h5py.File(path, "r", swmr=True)`
and holds every flushed row.
"""

from __future__ import annotations

import contextlib
import json
import os
import time
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING

import numpy as np

from edmctl.errors import RunFileError
from edmctl.record import layout
from edmctl.record.closing import close_run
from edmctl.record.create import LIBRARY_VERSIONS, empty_run_file
from edmctl.record.disk import (
    HDF5_ERRORS,
    already_there,
    cannot_create,
    close_without_writing,
    make_folder,
    partial_path,
    reason,
    write_new,
)
from edmctl.record.hdf5 import open_hdf5
from edmctl.record.liveness import hold, release
from edmctl.record.rows import EventLevel
from edmctl.record.segments import Segments
from edmctl.record.space import give_back, reserve
from edmctl.record.stores import BlockStore, CompoundStore, RowStore, Store

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    import h5py

    from edmctl.record.rows import LinkRow, RunMeta, ServoBlock, SiteRow, SlowRow, TouchRow, TruthMap
    from edmctl.results.telemetry import PulseBlockBatch, PulseTrain, TelemetryBlock, WaveformBatch

FLUSH_INTERVAL_S = 0.5
"""Rows reach the disk at most this long, plus one block, after they were handed over."""
CHUNK_CACHE_BYTES = 256 * 1024
"""Of each of the 70 datasets: two of the largest chunks. HDF5 would keep up to 8 MB that nobody reads again."""


@dataclass(frozen=True, slots=True)
class _Event:
    time_s: float
    seq: int
    code: int
    level: int
    message: str
    args: str


class RunWriter:
    """Recorder into one run file. Build it with `create`; end it with `finish` or `abandon`."""

    def __init__(self, file: h5py.File, path: Path, partial: Path, monotonic_s: Callable[[], float]) -> None:
        self._file = file
        self._path = path
        self._partial = partial
        self._lock = hold(partial)
        self._monotonic_s = monotonic_s
        self._flush_due_s = monotonic_s() + FLUSH_INTERVAL_S
        self._failure: RunFileError | None = None
        self._accepts = True
        self._events = 0
        self._servo = BlockStore(file, layout.SERVO)
        self._slow = RowStore(file, layout.SLOW)
        self._pulse_blocks = BlockStore(file, layout.PULSE_BLOCKS)
        self._pulses = BlockStore(file, layout.PULSES)
        self._segments = RowStore(file, layout.SEGMENTS)
        self._event_rows = CompoundStore(file, layout.EVENTS)
        self._touches = CompoundStore(file, layout.TOUCHES)
        self._results = CompoundStore(file, layout.RESULTS)
        self._black_box = BlockStore(file, layout.BLACK_BOX)
        self._waveforms = BlockStore(file, layout.WAVEFORMS)
        self._link = RowStore(file, layout.LINK)
        self._stores: tuple[Store, ...] = (
            self._servo,
            self._slow,
            self._pulse_blocks,
            self._segments,
            self._pulses,
            self._event_rows,
            self._touches,
            self._results,
            self._black_box,
            self._waveforms,
            self._link,
        )
        self._train = Segments()
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
                raise already_there(path)
            write_new(partial, empty_run_file(meta))
        except FileExistsError as error:
            raise already_there(partial) from error
        except OSError as error:
            raise cannot_create(path, reason(error)) from error
        try:
            file = open_hdf5(partial, "r+", libver=LIBRARY_VERSIONS, rdcc_nbytes=CHUNK_CACHE_BYTES)
            file.swmr_mode = True
        except HDF5_ERRORS as error:
            raise cannot_create(path, reason(error)) from error
        return cls(file, path, partial, monotonic_s)

    @property
    def path(self) -> Path:
        """The file as it is called now."""
        return self._partial if self._partial.exists() else self._path

    def append_servo(self, block: ServoBlock) -> None:
        """Append servo samples; the arrays are kept by reference."""
        if self._accepts:
            self._servo.add(block)
            self._tend(self._servo)

    def append_slow(self, row: SlowRow) -> None:
        """Append one row of the supervisor's view."""
        if self._accepts:
            self._slow.add(row)
            self._tend(self._slow)

    def append_pulse_blocks(self, blocks: PulseBlockBatch) -> None:
        """Append pulse sums; the arrays are kept by reference."""
        if self._accepts:
            self._pulse_blocks.add(blocks)
            self._tend(self._pulse_blocks)

    def append_pulses(self, train: PulseTrain) -> None:
        """Append single pulses; the arrays are kept by reference."""
        if self._accepts:
            segment = self._train.follow(train, self._pulses.rows)
            if segment is not None:
                self._segments.add(segment)
            self._pulses.add(train)
            self._tend(self._pulses)

    def event(
        self,
        time_s: float,
        code: int,
        level: EventLevel,
        message: str,
        args: Mapping[str, float | int | str | bool] | None = None,
    ) -> None:
        """Append an event; from WARNING on it is on disk when the call returns.

        `message` is cut to 160 bytes; of `args` the last values are left out when their JSON exceeds 200
        bytes.
        """
        if not self._accepts:
            return
        self._event_rows.add(_Event(time_s, self._events, code, level, message, _compact_json(args or {})))
        self._events += 1
        if level >= EventLevel.WARNING:
            self.flush()
        else:
            self._tend(self._event_rows)

    def touch(self, row: TouchRow) -> None:
        """Append a reading of surface or bottom; it is on disk when the call returns."""
        if self._accepts:
            self._touches.add(row)
            self.flush()

    def reject_touch(self, time_s: float) -> None:
        """Mark the reading of that time as one that was not used, by what was touched after it.

        The mark is on disk when the call returns.
        """
        if self._accepts:
            self._guarded(lambda: self._reject_touch(time_s))

    def site_result(self, row: SiteRow) -> None:
        """Append the result at a site and add its wear to the tool's; both are on disk when the call returns."""
        if self._accepts:
            self._results.add(row)
            self._wear_um += row.wear_um
            self._guarded(self._put_wear)
            self.flush()

    def black_box(self, block: TelemetryBlock) -> None:
        """Append what the controller kept from before a fault; it is on disk when the call returns."""
        if self._accepts:
            self._black_box.add(block)
            self.flush()

    def waveforms(self, block: WaveformBatch) -> None:
        """Append the gap about a fault; it is on disk when the call returns."""
        if self._accepts:
            self._waveforms.add(block)
            self.flush()

    def append_link(self, row: LinkRow) -> None:
        """Append how the line did."""
        if self._accepts:
            self._link.add(row)
            self._tend(self._link)

    def truth_map(self, truth: TruthMap) -> None:
        """Write (or replace) the true floor of a channel."""
        if self._accepts:
            self._guarded(lambda: self._put_truth(truth), more_bytes=2 * truth.depth_um.nbytes)

    def summary(self, json_text: str) -> None:
        """Write (or replace) the result as a JSON object."""
        if self._accepts:
            utf8 = json_text.encode()
            self._guarded(lambda: self._put_summary(utf8), more_bytes=2 * len(utf8))

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

    def abandon(self, status: str, exit_code: int) -> Path:
        """End a run that did not reach its aim: as `finish`, but never raises a RunFileError.

        Returns where the rows are: the final path, or the `.partial` file after a disk failure.
        """
        with contextlib.suppress(RunFileError):
            self.finish(status, exit_code)
        return self.path

    def _tend(self, store: Store) -> None:
        if self._monotonic_s() >= self._flush_due_s:
            self.flush()
        elif store.waiting >= store.limit:
            self._guarded(lambda: store.write(everything=False))

    def _guarded(self, action: Callable[[], None], more_bytes: int = 0) -> None:
        """Do what writes to the file, in space taken before; the rows that wait and `more_bytes` fit into it."""
        try:
            reserve(self._file, more_bytes + sum(store.growth_bytes for store in self._stores))
            action()
        except HDF5_ERRORS as error:
            self._accepts = False
            close_without_writing(self._file)
            release(self._lock)
            self._failure = RunFileError(
                f"Cannot write {self._partial}: {reason(error)}.",
                code="E9003",
                hint=f"Free some space or choose another folder with --out; "
                f"`edmctl run recover {self._partial}` then saves what was recorded before.",
            )
            raise self._failure from error

    def _flush(self) -> None:
        for store in self._stores:
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

    def _put_truth(self, truth: TruthMap) -> None:
        group = self._file[layout.TRUTH.path]
        for column in (layout.TRUTH.signal, *layout.TRUTH.axes):
            values = getattr(truth, column.field)
            group[column.name].resize(values.shape)
            group[column.name][...] = values

    def _put_summary(self, utf8: bytes) -> None:
        dataset = self._file["/entry/summary"]
        dataset.resize((len(utf8),))
        dataset[:] = np.frombuffer(utf8, np.uint8)

    def _end(self, status: str, exit_code: int) -> None:
        self._flush()
        entry = self._file["/entry"]
        entry["end_time"][()] = datetime.now(UTC).isoformat(timespec="milliseconds").encode()
        entry["exit_code"][()] = exit_code
        entry["status"][()] = status.encode()
        self._file.flush()
        self._file.close()
        give_back(self._partial)


def _compact_json(args: Mapping[str, float | int | str | bool]) -> str:
    width = next(np.dtype(c.dtype).itemsize for c in layout.EVENTS.columns if c.name == "args")
    kept = dict(args)
    while len(text := json.dumps(kept, separators=(",", ":"))) > width:
        kept.popitem()
    return text
