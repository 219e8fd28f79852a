"""How often HDF5 reads a piece of metadata again whose check sum does not fit, in a file that may be written.

It waits twice as long each time, and without a limit tries a hundred times: on a damaged file of a killed writer it
would not come back. h5py has no call for the limit, so HDF5's own is used.
"""

from __future__ import annotations

import ctypes
from functools import cache
from typing import TYPE_CHECKING

import h5py
from h5py import h5f, h5p

from edmctl.record import locks

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

ATTEMPTS = 24
"""They take 2^24 ns = 17 ms together; a writer is done with a piece in a fraction of that."""


def open_swmr(path: Path) -> h5py.File:
    """Open the file at `path` for reading while another process may write it. Raises OSError."""
    plist = h5p.create(h5p.FILE_ACCESS)
    plist.set_libver_bounds(h5f.LIBVER_EARLIEST, h5f.LIBVER_LATEST)
    limit = _limit()
    if limit is not None:
        limit(plist.id, ATTEMPTS)
    if not locks.are_known(path.parent):
        plist.set_file_locking(False, True)
    flags = h5f.ACC_RDONLY | h5f.ACC_SWMR_READ
    return h5py.File(h5f.open(str(path).encode(), flags, plist))


@cache
def _limit() -> Callable[[int, int], int] | None:
    """HDF5's call that sets the limit; None where it cannot be found."""
    try:
        call = ctypes.CDLL(h5p.__file__).H5Pset_metadata_read_attempts
    except (OSError, AttributeError):
        return None
    call.argtypes = (ctypes.c_int64, ctypes.c_uint)
    call.restype = ctypes.c_int
    limit: Callable[[int, int], int] = call
    return limit
