"""Locks that also hold where the file system knows none: network disks without a lock service answer ENOLCK.

There a lock is a file that only one can make, with host and process of who did. One whose process is gone is taken
away; of another computer's nobody here can tell, and it stays until it is removed by hand.
"""

from __future__ import annotations

import errno
import os
import socket
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_UNKNOWN = (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP)


def are_known(folder: Path) -> bool:
    """Whether the file system of a folder knows locks; a folder that is not there yet is its parent's."""
    try:
        import fcntl
    except ImportError:  # Windows, whose locks HDF5 knows
        return True
    while not folder.is_dir() and folder != folder.parent:
        folder = folder.parent
    try:
        descriptor = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return True
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError as error:
        return error.errno not in _UNKNOWN
    finally:
        os.close(descriptor)
    return True


def of_hdf5(path: Path) -> bool | None:
    """What h5py is told of locks for a file at `path`: its own way where there are any, none where there are not."""
    return None if are_known(path.parent) else False


@contextmanager
def exclusive(descriptor: int, path: Path) -> Iterator[None]:
    """Lock an open file for a `with` block, or in its stead the name `path`, where no locks are known.

    Raises BlockingIOError where another has it, OSError where neither can be done.
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


@contextmanager
def _named(path: Path) -> Iterator[None]:
    me = f"{socket.gethostname()} {os.getpid()}"
    for _ in range(2):
        try:
            _make(path, me)
            break
        except FileExistsError:
            _take_away_left(path)
    else:
        raise BlockingIOError(
            errno.EWOULDBLOCK, f"{path} says that {_told(path) or 'another program'} has it"
        )
    try:
        yield
    finally:
        with suppress(OSError):
            path.unlink()


def _make(path: Path, text: str) -> None:
    descriptor = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY | os.O_CLOEXEC, 0o666)
    try:
        os.write(descriptor, text.encode())
    finally:
        os.close(descriptor)


def _take_away_left(path: Path) -> None:
    """Remove a lock of this computer whose process is gone; by another name first, as two may try at once."""
    told = _told(path)
    host, _, number = told.rpartition(" ")
    if host != socket.gethostname() or not number.isdigit() or _lives(int(number)):
        return
    aside = path.with_name(f"{path.name}.{os.getpid()}")
    with suppress(OSError):
        path.rename(aside)
        if _told(aside) == told:
            aside.unlink()
        else:  # somebody was quicker, and this is a new one
            aside.rename(path)


def _told(path: Path) -> str:
    from edmctl.files import read_bytes

    try:
        return read_bytes(path).decode(errors="replace")
    except OSError:
        return ""


def _lives(number: int) -> bool:
    try:
        os.kill(number, 0)
    except PermissionError:
        return True
    except (OSError, OverflowError):
        return False
    return True
