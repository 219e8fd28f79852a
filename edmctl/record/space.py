"""Space on the disk, taken before HDF5 needs it.

HDF5 does not survive a disk that fills up in the middle of its writing: a failed write leaves its caches in a
state that crashes the interpreter at the next flush or close. So the file is made longer before each write by
more than that write can add, and what is left over is cut off at the end.
"""

from __future__ import annotations

import errno
import os
from contextlib import suppress
from typing import TYPE_CHECKING

from edmctl.record.superblock import read_superblock

if TYPE_CHECKING:
    from pathlib import Path

    import h5py

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
