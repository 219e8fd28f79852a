"""Handling of the disk: names that are never overwritten, space taken before it is needed, a disk that fails; locks.

HDF5 does not survive a disk that fills up in the middle of its writing: a failed write leaves its caches in a
state that crashes the interpreter at the next flush or close. So a file is made longer before each write by
more than that write can add, and the excess is cut off at the end.

Sparks and moves wait until what precedes them is on the disk, and a disk may not answer for seconds: such writes
run in a thread, and meanwhile the caller serves the machine.

Network disks without a lock service answer ENOLCK. There nothing keeps two programs apart, and a job warns (W9002).
The writer of a run file holds a lock that ends with its process: a record lock on a byte beyond the end of the file.
HDF5's own lock does not show the writer: it is given up in SWMR mode, and readers take it too.
"""

from __future__ import annotations

import errno
import os
import re
import signal
import struct
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, wait
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from edmctl import failures
from edmctl.errors import EdmError, LinkLost, RunFileError
from edmctl.files import open_descriptor, sync

try:
    import fcntl
except ImportError:  # Windows, whose locks HDF5 knows
    fcntl = None  # type: ignore[assignment]

if TYPE_CHECKING:
    import h5py

HDF5_ERRORS = (OSError, RuntimeError, ValueError)
"""What h5py raises when the disk refuses, depending on the call that met it."""
PARTIAL = ".partial"
"""Ending of a run file that is not finished."""
RESERVE_BYTES = 128 * 1024
"""What HDF5 may add beside the rows, mostly chunk indexes: up to 8 kB in each of the ten to fifteen columns of a
table that grow together. Also enough for the last values and for closing."""
GIVE_UP_S = 10.0
"""A disk that has not answered for so long hangs, and the job ends safely."""
PROMPT_S = 0.05
"""A write usually takes less, and nothing else is done so long."""
_NO_HARD_LINKS = (errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EMLINK)
_NO_RESERVING = (errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL)
_STOPPING = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))

RETRY_S = 0.05
FRESH_S = 5.0
"""Where a file system knows no locks, a file that was written to within this time counts as live."""
_UNKNOWN = (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP)
_HELD = (errno.EWOULDBLOCK, errno.EACCES)
_PLACE = 1 << 62
"""The byte that a writer locks."""


def partial_path(path: Path) -> Path:
    """Return the name that the file at `path` has until it is finished."""
    return path.with_name(path.name + PARTIAL)


def make_folder(folder: Path) -> None:
    """Make `folder` and its parents; raises NotADirectoryError when a file is in the way."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError as error:
        raise NotADirectoryError(errno.ENOTDIR, f"{folder} is not a folder") from error


def write_new(path: Path, content: bytes) -> None:
    """Write a file that must not exist yet; remove it when the disk is full."""
    with path.open("xb") as file:
        try:
            file.write(content)
            file.flush()
        except OSError:
            path.unlink(missing_ok=True)
            raise


def sync_if_possible(*paths: Path) -> None:
    """Wait until the disk itself holds files and the names in folders, except where that cannot be requested."""
    for path in paths:
        with suppress(OSError):
            sync(path)


def close_without_writing(file: h5py.File) -> None:
    """Close `file` as it is on disk: HDF5 writes its caches to the null device, instead of failing and crashing."""
    with suppress(*HDF5_ERRORS):
        null = os.open(os.devnull, os.O_RDWR)
        os.dup2(null, file.id.get_vfd_handle())
        os.close(null)
    with suppress(*HDF5_ERRORS):
        file.close()


def rename_without_replacing(source: Path, target: Path) -> None:
    """Give `source` the name `target`; raises RunFileError E9004 when that is impossible or taken."""
    try:
        try:
            os.link(source, target)
            source.unlink()
        except OSError as error:
            if error.errno not in _NO_HARD_LINKS:
                raise
            # Without hard links (FAT, some network shares) an empty file of our own is replaced.
            os.close(os.open(target, os.O_CREAT | os.O_EXCL))
            try:
                source.replace(target)
            except OSError:
                target.unlink(missing_ok=True)
                raise
    except OSError as error:
        raise cannot_name(source, target, error) from error


def cannot_name(source: Path, target: Path, error: BaseException) -> RunFileError:
    """Return the error for a finished file `source` that cannot be called `target`."""
    if source.exists():
        hint = f"The run is complete in {source}; rename it."
    else:
        hint = f"{source} was moved or deleted while the run was going on; look for it where it was moved to."
    why = reason(error) if isinstance(error, Exception) else str(error)
    return failures.run_file_not_named(target=target, why=why, remedy=hint)


def refuse_place(path: Path) -> None:
    """Raise RunFileError if no run file can be made at `path`: E9001 taken, E9002 no folder. Makes nothing."""
    for existing in (path, partial_path(path)):
        if os.path.lexists(existing):
            raise failures.run_file_exists(existing=existing)
    folder = path.parent
    while not os.path.lexists(folder):
        folder = folder.parent
    if not folder.is_dir():
        raise failures.run_file_not_created(path=path, why=f"{folder} is not a folder")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise failures.run_file_not_created(path=path, why=f"{folder} cannot be written")


def reason(error: Exception) -> str:
    """Return the operating system's reason out of what h5py raised."""
    is_of_hdf5 = "errno = " in str(error)
    if isinstance(error, OSError) and error.strerror and not is_of_hdf5:
        return error.strerror
    if (number := error_number(error)) is not None:
        return os.strerror(number)
    return str(error).splitlines()[0]


def error_number(error: Exception) -> int | None:
    """Return the number of the operating system's refusal; None if HDF5 itself refused what it read."""
    if isinstance(error, OSError) and error.errno is not None:
        return error.errno
    match = re.search(r"errno = (\d+)", str(error))
    return int(match[1]) if match else None


def reserve(file: h5py.File, growth_bytes: int) -> None:
    """Take space for `growth_bytes` more in `file` and the reserve; raises OSError when the disk is full."""
    if not hasattr(os, "posix_fallocate"):  # macOS
        return
    try:
        os.posix_fallocate(file.id.get_vfd_handle(), 0, file.id.get_filesize() + growth_bytes + RESERVE_BYTES)
    except OSError as error:
        # On a file system that cannot reserve, the write itself finds the disk full.
        if error.errno not in _NO_RESERVING:
            raise


class DiskThread:
    """Runs one write at a time.

    attend : serves a live machine until its argument holds or some tenths of a second are over. None where the
        machine's time stops while the host does something else: there writes run in the caller's thread
    """

    def __init__(self, attend: Callable[[Callable[[], bool]], object] | None = None) -> None:
        self._attend = attend
        self._writing: Future[None] | None = None
        self._line_is_lost = self._hangs = False
        self._error_of_line: EdmError | None = None

    def run(self, path: Path, write: Callable[[], None]) -> None:
        """Return when `write` has run. Raises its errors, then those of the line; RunFileError E9009 for a hang."""
        if self._attend is None:
            write()
            return
        while self._writing is not None:
            self._wait(path)
        own = self._writing = _in_thread(write)
        self._wait(path)
        own.result()
        if self._error_of_line is not None:
            error, self._error_of_line = self._error_of_line, None
            raise error

    def start(self, write: Callable[[], None]) -> bool:
        """Begin a write that nothing waits for; False if the one before is still under way. Raises its error."""
        if self._attend is None:
            write()
            return True
        if self._writing is not None:
            if not self._writing.done():
                return False
            before, self._writing = self._writing, None
            before.result()
        self._writing = _in_thread(write)
        return True

    def close(self) -> None:
        """Wait for a write that is under way, unless the disk hangs. Its outcome is ignored."""
        if self._writing is not None and not self._hangs:
            wait([self._writing], GIVE_UP_S)

    def _wait(self, path: Path) -> None:
        writing, begun_s = self._writing, time.monotonic()
        if writing is None:
            return
        if not self._hangs:
            wait([writing], PROMPT_S)
        while not writing.done():
            if self._hangs or time.monotonic() - begun_s > GIVE_UP_S:
                self._hangs = True
                raise failures.disk_does_not_answer(give_up_s=GIVE_UP_S, path=path)
            self._attend_to(writing)
        self._hangs = False
        # While the line was read, a further write may have begun.
        if self._writing is writing:
            self._writing = None

    def _attend_to(self, writing: Future[None]) -> None:
        """Read the line for a while, or only wait after an error of the line."""
        assert self._attend is not None
        if self._line_is_lost or self._error_of_line is not None:
            wait([writing], PROMPT_S)
            return
        try:
            self._attend(writing.done)
        except LinkLost:
            self._line_is_lost = True
        except EdmError as error:
            self._error_of_line = error


def _in_thread(write: Callable[[], None]) -> Future[None]:
    """Run a write in a thread that does not keep the program from ending."""
    future: Future[None] = Future()

    def run() -> None:
        leave_signals_to_the_main_thread()
        try:
            write()
            future.set_result(None)
        except BaseException as error:
            future.set_exception(error)

    threading.Thread(target=run, name="disk", daemon=True).start()
    return future


def leave_signals_to_the_main_thread() -> None:
    """Python handles them there, and only a signal that arrives there ends its waiting."""
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_BLOCK, _STOPPING)


def locks_are_known(folder: Path) -> bool:
    """Whether files in a folder, or its nearest parent, can be locked; True if that cannot be tried."""
    while not folder.is_dir() and folder != folder.parent:
        folder = folder.parent
    # Network disks lock folders by themselves: only a file shows it.
    with suppress(OSError), tempfile.NamedTemporaryFile(prefix=".edmctl-", dir=folder) as file:
        return _takes_lock(file.fileno())
    return True


def hdf5_locking(path: Path) -> bool | None:
    """Return h5py's `locking` for a file at `path`: None, its own way, where there are locks, else False."""
    try:
        descriptor = open_descriptor(path, os.O_RDONLY)
    except OSError:
        return None if locks_are_known(path.parent) else False
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
def exclusive_lock(descriptor: int) -> Iterator[None]:
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


def hold_lock(path: Path) -> int | None:
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


def release_lock(descriptor: int | None) -> None:
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
