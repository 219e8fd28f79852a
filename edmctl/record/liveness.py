"""Whether somebody is writing a run file: its writer holds a shared lock on it, which ends with its process.

The lock also keeps programs out that would open the file for writing. HDF5 itself gives its lock up in SWMR
mode, and readers, which lock shared, do not meet this one.
"""

from __future__ import annotations

import errno
import os
import time
from contextlib import suppress
from typing import TYPE_CHECKING

from edmctl.errors import RunFileError

from .disk import PARTIAL

if TYPE_CHECKING:
    from pathlib import Path

FRESH_S = 5.0
"""Where a file system knows no locks, a file that was written to within this time counts as live."""

_HELD = (errno.EWOULDBLOCK, errno.EACCES)


def hold(path: Path) -> int | None:
    """Lock the file at `path` as its writer; return what `release` wants, None where there are no locks."""
    try:
        import fcntl
    except ImportError:  # Windows
        return None
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
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
        import fcntl
    except ImportError:  # Windows
        return _is_fresh(path)
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
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


def _is_fresh(path: Path) -> bool:
    return time.time() - path.stat().st_mtime < FRESH_S
