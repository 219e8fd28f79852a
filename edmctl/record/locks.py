"""File locks, and whether a run file has a living writer.

Network disks without a lock service answer ENOLCK. There nothing keeps two programs apart, and a job warns (W9002).

The writer of a run file holds a lock that ends with its process: a record lock on a byte beyond the end of the file.
HDF5's own lock does not show the writer: it is given up in SWMR mode, and readers take it too.
"""

from __future__ import annotations

import errno
import os
import struct
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from edmctl.files import open_descriptor
from edmctl.record.disk import PARTIAL

try:
    import fcntl
except ImportError:  # Windows, whose locks HDF5 knows
    fcntl = None  # type: ignore[assignment]

RETRY_S = 0.05
FRESH_S = 5.0
"""Where a file system knows no locks, a file that was written to within this time counts as live."""
_UNKNOWN = (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP)
_HELD = (errno.EWOULDBLOCK, errno.EACCES)
_PLACE = 1 << 62
"""The byte that a writer locks."""


def are_known(folder: Path) -> bool:
    """Whether files in a folder, or its nearest parent, can be locked; True if that cannot be tried."""
    while not folder.is_dir() and folder != folder.parent:
        folder = folder.parent
    # Network disks lock folders by themselves: only a file shows it.
    with suppress(OSError), tempfile.NamedTemporaryFile(prefix=".edmctl-", dir=folder) as file:
        return _takes_lock(file.fileno())
    return True


def of_hdf5(path: Path) -> bool | None:
    """Return h5py's `locking` for a file at `path`: None, its own way, where there are locks, else False."""
    try:
        descriptor = open_descriptor(path, os.O_RDONLY)
    except OSError:
        return None if are_known(path.parent) else False
    try:
        return None if _takes_lock(descriptor) else False
    finally:
        os.close(descriptor)


def _takes_lock(descriptor: int) -> bool:
    if fcntl is None:
        return True
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
        fcntl.flock(descriptor, fcntl.LOCK_UN)
    except OSError as error:
        return error.errno not in _UNKNOWN
    return True


@contextmanager
def exclusive(descriptor: int) -> Iterator[None]:
    """Lock an open file, if its disk knows locks. Raises OSError, BlockingIOError if another program has it."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno not in _UNKNOWN:
            raise
    yield


def retried(attempt: Callable[[], object], longest_s: float) -> None:
    """Call `attempt` until it raises no BlockingIOError. Raises BlockingIOError after `longest_s`."""
    until_s = time.monotonic() + longest_s
    while True:
        try:
            attempt()
            return
        except BlockingIOError:
            if time.monotonic() >= until_s:
                raise
            time.sleep(RETRY_S)


def is_alive(number: int) -> bool:
    """Whether this computer has a process of that number."""
    try:
        os.kill(number, 0)
    except PermissionError:
        return True
    except (OSError, OverflowError):
        return False
    return True


def hold(path: Path) -> int | None:
    """Lock the file at `path` as its writer; return the descriptor to close, None if there are no locks."""
    if fcntl is None:
        return None
    descriptor = open_descriptor(path, os.O_RDWR)
    try:
        _lock_record(descriptor, exclusive=True)
    except OSError:
        os.close(descriptor)
        return None
    return descriptor


def release(descriptor: int | None) -> None:
    """Give the lock up."""
    if descriptor is not None:
        with suppress(OSError):
            os.close(descriptor)


def is_live(path: Path) -> bool:
    """Whether a process is writing the run file at `path`. Nothing is changed. Raises OSError."""
    if path.suffix != PARTIAL or not path.exists():
        return False
    if fcntl is not None:
        try:
            descriptor = open_descriptor(path, os.O_RDONLY)
        except FileNotFoundError:  # it got its final name a moment ago
            return False
        try:
            _lock_record(descriptor, exclusive=False)
            return False
        except OSError as error:
            if error.errno in _HELD:
                return True
        finally:
            os.close(descriptor)
    return time.time() - path.stat().st_mtime < FRESH_S


def _lock_record(descriptor: int, *, exclusive: bool) -> None:
    """Lock one byte. A lock of the process, as outside Linux, ends when it closes the file anywhere."""
    open_file_lock = getattr(fcntl, "F_OFD_SETLK", None)
    if open_file_lock is None or struct.calcsize("P") != 8:
        kind = fcntl.LOCK_EX if exclusive else fcntl.LOCK_SH
        fcntl.lockf(descriptor, kind | fcntl.LOCK_NB, 1, _PLACE)
        return
    kind = fcntl.F_WRLCK if exclusive else fcntl.F_RDLCK
    fcntl.fcntl(descriptor, open_file_lock, struct.pack("hhqqi4x", kind, os.SEEK_SET, _PLACE, 1, 0))
