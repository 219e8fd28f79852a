"""Whether somebody is writing a run file: its writer holds a lock on it, which ends with its process.

HDF5's own lock does not tell: it is given up in SWMR mode, and readers take it too. This one is a record lock on a
byte beyond the end of every file, which nobody else takes.
"""

from __future__ import annotations

import errno
import os
import struct
import time
from contextlib import suppress
from typing import TYPE_CHECKING

from edmctl.errors import RunFileError
from edmctl.record.disk import PARTIAL

if TYPE_CHECKING:
    from pathlib import Path

FRESH_S = 5.0
"""Where a file system knows no locks, a file that was written to within this time counts as live."""

_HELD = (errno.EWOULDBLOCK, errno.EACCES)
_PLACE = 1 << 62
"""The byte that is locked."""


def hold(path: Path) -> int | None:
    """Lock the file at `path` as its writer; return what `release` wants, None where there are no locks."""
    try:
        import fcntl  # noqa: F401 - Windows has none
    except ImportError:
        return None
    descriptor = os.open(path, os.O_RDWR | os.O_CLOEXEC)
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
    if path.suffix != PARTIAL:
        return False
    try:
        import fcntl  # noqa: F401 - Windows has none
    except ImportError:
        return _is_fresh(path)
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        _lock_record(descriptor, exclusive=False)
    except OSError as error:
        return True if error.errno in _HELD else _is_fresh(path)
    finally:
        os.close(descriptor)
    return False


def interrupted(path: Path) -> RunFileError:
    """Return the error for a run whose writer died."""
    return RunFileError(
        f"The run in {path} was interrupted: its file has no end.",
        code="E9008",
        hint=f"`edmctl run recover {path}` makes a complete file of what was recorded.",
    )


def _lock_record(descriptor: int, *, exclusive: bool) -> None:
    """Lock one byte. Raises OSError when another has it.

    A lock of an open file is asked for where there is one (Linux): one of a process would end when anything in the
    process closes the file.
    """
    import fcntl

    open_file_lock = getattr(fcntl, "F_OFD_SETLK", None)
    if open_file_lock is None or struct.calcsize("P") != 8:
        kind = fcntl.LOCK_EX if exclusive else fcntl.LOCK_SH
        fcntl.lockf(descriptor, kind | fcntl.LOCK_NB, 1, _PLACE)
        return
    kind = fcntl.F_WRLCK if exclusive else fcntl.F_RDLCK
    fcntl.fcntl(descriptor, open_file_lock, struct.pack("hhqqi4x", kind, os.SEEK_SET, _PLACE, 1, 0))


def _is_fresh(path: Path) -> bool:
    return time.time() - path.stat().st_mtime < FRESH_S
