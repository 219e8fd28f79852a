"""Locks that also hold where the file system knows none: network disks without a lock service answer ENOLCK.

There a lock is a file that only one can make, with computer and process of who did. One whose process is gone is
taken away; of another computer's, or of one that has restarted since, that cannot be known, and it stays until it is
removed by hand.

Of a run file its writer holds a lock that ends with its process. HDF5's own lock is no sign: it is given up in
SWMR mode, and readers take it too. The writer's is a record lock on a byte beyond the end of every file, which
nobody else takes.
"""

from __future__ import annotations

import errno
import os
import socket
import struct
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from edmctl.errors import RunFileError
from edmctl.files import open_descriptor, read_bytes
from edmctl.record.disk import PARTIAL

UNWRITTEN_S = 10.0
"""A lock that still says nothing after so long was left by whoever was killed, or met a full disk, as it made it."""
RETRY_S = 0.05
_UNKNOWN = (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP)


class LockHeld(BlockingIOError):
    """Another program has the lock that the name `lock` is; `by` is what the file says of who that is."""

    def __init__(self, lock: Path, by: str) -> None:
        super().__init__(errno.EWOULDBLOCK, f"{lock} says that {by or 'another program'} has it")
        self.lock, self.by = lock, by


def are_known(folder: Path) -> bool:
    """Whether files in a folder, or its parent until it is there, can be locked; yes where that cannot be known."""
    while not folder.is_dir() and folder != folder.parent:
        folder = folder.parent
    # Network disks lock folders by themselves: only a file tells.
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
    try:
        import fcntl
    except ImportError:  # Windows, whose locks HDF5 knows
        return True
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
        fcntl.flock(descriptor, fcntl.LOCK_UN)
    except OSError as error:
        return error.errno not in _UNKNOWN
    return True


@contextmanager
def exclusive(descriptor: int, path: Path) -> Iterator[None]:
    """Lock an open file for a `with` block, or in its stead the name `path`, where no locks are known.

    Raises BlockingIOError where another has it, which is `LockHeld` where the name is the lock; OSError where
    neither can be done.
    """
    import fcntl

    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno not in _UNKNOWN:
            raise
        with _named(path):
            yield
        return
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


@contextmanager
def _named(path: Path) -> Iterator[None]:
    me = _name_of(os.getpid())
    try:
        _make(path, me)
    except FileExistsError:
        _take_away_left(path)
        try:
            _make(path, me)
        except FileExistsError:
            raise LockHeld(path, _content(path)) from None
    try:
        yield
    finally:
        with suppress(OSError):
            if _content(path) == me:
                path.unlink()


def _make(path: Path, text: str) -> None:
    descriptor = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY | os.O_CLOEXEC, 0o666)
    try:
        os.write(descriptor, text.encode())
    except OSError:
        path.unlink(missing_ok=True)
        raise
    finally:
        os.close(descriptor)


def _take_away_left(path: Path) -> None:
    """Remove a lock whose process is gone. Only one program at a time may, so that none removes a new one."""
    clearing = path.with_name(f"{path.name}.clearing")
    with suppress(OSError):
        if _is_old(clearing):
            clearing.unlink()
        _make(clearing, _name_of(os.getpid()))
        try:
            content = _content(path)
            if _is_gone(content) if content else _is_old(path):
                _remove(path, content)
        finally:
            clearing.unlink()


def _remove(path: Path, content: str) -> None:
    """Remove a lock that says this, and none that somebody has made in its place meanwhile."""
    aside = path.with_name(f"{path.name}.{os.getpid()}")
    path.rename(aside)
    if _content(aside) == content:
        aside.unlink()
    else:
        aside.rename(path)


def _is_old(path: Path) -> bool:
    """Whether nobody has written it for long, by the clock of its disk, which may be another computer's."""
    with suppress(OSError), tempfile.NamedTemporaryFile(prefix=".edmctl-", dir=path.parent) as file:
        return os.fstat(file.fileno()).st_mtime - path.stat().st_mtime > UNWRITTEN_S
    return False


def _name_of(number: int) -> str:
    """Computer, its present start, the room of its process numbers, number and start of a process."""
    with suppress(OSError, IndexError):
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        began = Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()[19]
        return f"{socket.gethostname()} {boot} {Path('/proc/self/ns/pid').readlink()} {number} {began}"
    return f"{socket.gethostname()} - - {number} -"


def _is_gone(content: str) -> bool:
    """Whether a name of a process is of this computer, and of none that lives."""
    *where, number, _ = content.split(" ") if content.count(" ") == 4 else ["", "", ""]
    if where != _name_of(os.getpid()).split(" ")[:3] or not (number.isascii() and number.isdigit()):
        return False
    if not is_alive(int(number)):
        return True
    now = _name_of(int(number))
    # Of other people's processes not every computer tells when they began.
    return now != content and not now.endswith(" -")


def _content(path: Path) -> str:
    try:
        return read_bytes(path).decode(errors="replace")
    except OSError:
        return ""


def is_alive(number: int) -> bool:
    """Whether this computer has a process of that number."""
    try:
        os.kill(number, 0)
    except PermissionError:
        return True
    except (OSError, OverflowError):
        return False
    return True


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
    if path.suffix != PARTIAL:
        return False
    try:
        import fcntl  # noqa: F401 - Windows has none
    except ImportError:
        return _is_fresh(path)
    descriptor = open_descriptor(path, os.O_RDONLY)
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
