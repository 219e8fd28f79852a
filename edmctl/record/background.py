"""A run file written by a thread of its own, so that control of the machine never waits for the disk.

Rows are handed over in about a microsecond and written in order: urgent ones at once, others after 0.5 s, and
synced every ten seconds. h5py, `posix_fallocate` and `fsync` let other threads run while they wait for the disk.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque
from pathlib import Path

from edmctl import failures
from edmctl.errors import RunFileError
from edmctl.record import layout
from edmctl.record.disk import make_lasting
from edmctl.record.disk_thread import GIVE_UP_S, leave_signals_to_the_main_thread
from edmctl.record.rows import Row, TruthMap
from edmctl.record.run_meta import RunMeta
from edmctl.record.writer import FLUSH_INTERVAL_S, RunWriter

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
        E9009; for a virtual machine, whose clock stands meanwhile. Raises RunFileError E9001, E9002.
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
