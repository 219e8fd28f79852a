"""Dealing with the disk: names that are never overwritten, space taken before it is needed, a disk that fails.

HDF5 does not survive a disk that fills up in the middle of its writing: a failed write leaves its caches in a
state that crashes the interpreter at the next flush or close. So a file is made longer before each write by
more than that write can add, and what is left over is cut off at the end.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from edmctl import failures
from edmctl.errors import RunFileError
from edmctl.files import sync
from edmctl.record.integrity import read_superblock

if TYPE_CHECKING:
    import h5py

HDF5_ERRORS = (OSError, RuntimeError, ValueError)
"""What h5py raises when the disk refuses, depending on the call that met it."""

PARTIAL = ".partial"
"""Ending of a run file that is not finished."""

_NO_HARD_LINKS = (errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EMLINK)


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
    """Write a file that must not exist yet; leave none behind when the disk is full."""
    try:
        with path.open("xb") as file:
            file.write(content)
    except FileExistsError:
        raise
    except OSError:
        path.unlink(missing_ok=True)
        raise


def make_lasting(path: Path) -> None:
    """Wait until the disk itself holds the file at `path` and its name; where neither can be asked for, do not."""
    for place in (path, path.parent):
        with contextlib.suppress(OSError):
            sync(place)


def close_without_writing(file: h5py.File) -> None:
    """Close `file` and leave it on disk as it is.

    HDF5 would try to write its caches again, fail again, and crash the interpreter. With its descriptor
    pointed to the null device the attempt succeeds, and the file keeps what the last flush put there.
    """
    with contextlib.suppress(*HDF5_ERRORS):
        null = os.open(os.devnull, os.O_RDWR)
        os.dup2(null, file.id.get_vfd_handle())
        os.close(null)
    with contextlib.suppress(*HDF5_ERRORS):
        file.close()


def rename_without_replacing(source: Path, target: Path) -> None:
    """Give `source` the name `target`; raises RunFileError E9004 when that cannot be or is taken."""
    try:
        try:
            os.link(source, target)
            source.unlink()
        except OSError as error:
            if error.errno not in _NO_HARD_LINKS:
                raise
            _take_name_then_replace(source, target)
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


def _take_name_then_replace(source: Path, target: Path) -> None:
    """Where there are no hard links (FAT, some network shares): replace an empty file of our own."""
    os.close(os.open(target, os.O_CREAT | os.O_EXCL))
    try:
        source.replace(target)
    except OSError:
        target.unlink(missing_ok=True)
        raise


def refuse_place(path: Path) -> None:
    """Raise RunFileError where no run file can come to be at `path`: E9001 taken, E9002 no folder. Makes nothing."""
    for existing in (path, partial_path(path)):
        if os.path.lexists(existing):
            raise already_there(existing)
    folder = path.parent
    while not os.path.lexists(folder):
        folder = folder.parent
    if not folder.is_dir():
        raise cannot_create(path, f"{folder} is not a folder")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise cannot_create(path, f"{folder} cannot be written")


def already_there(existing: Path) -> RunFileError:
    """Return the error for a run that exists."""
    return failures.run_file_exists(existing=existing)


def cannot_create(path: Path, why: str) -> RunFileError:
    """Return the error for a file that cannot be made."""
    return failures.run_file_not_created(path=path, why=why)


def reason(error: Exception) -> str:
    """Return the operating system's own words out of what h5py raised."""
    told_by_hdf5 = "errno = " in str(error)
    if isinstance(error, OSError) and error.strerror and not told_by_hdf5:
        return error.strerror
    if (number := error_number(error)) is not None:
        return os.strerror(number)
    return str(error).splitlines()[0]


def error_number(error: Exception) -> int | None:
    """Return the number of the operating system's refusal; None where HDF5 itself refused what it read."""
    if isinstance(error, OSError) and error.errno is not None:
        return error.errno
    found = re.search(r"errno = (\d+)", str(error))
    return int(found.group(1)) if found else None


RESERVE_BYTES = 128 * 1024
"""What HDF5 may add beside the rows, mostly chunk indexes: up to 8 kB in each of the ten to fifteen columns of a
table that grow together. Also enough for the last values and for closing."""

_UNKNOWN_HERE = (errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL)


def reserve(file: h5py.File, growth_bytes: int) -> None:
    """Take space for `growth_bytes` more in `file` and the reserve; raises OSError when the disk is full."""
    if not hasattr(os, "posix_fallocate"):  # macOS
        return
    try:
        os.posix_fallocate(file.id.get_vfd_handle(), 0, file.id.get_filesize() + growth_bytes + RESERVE_BYTES)
    except OSError as error:
        # A file system that cannot reserve leaves it to the write itself to find the disk full.
        if error.errno not in _UNKNOWN_HERE:
            raise


def give_back(path: Path) -> None:
    """Cut what was reserved and not used off the closed file at `path`, if it is still there."""
    with suppress(FileNotFoundError):
        end_bytes = read_superblock(path).end_bytes
        if end_bytes is not None:
            os.truncate(path, end_bytes)
