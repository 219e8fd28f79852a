"""Opens HDF5 files: those on the disk with locks where their file system knows any, new ones in memory."""

from __future__ import annotations

import ctypes
from functools import cache
from threading import get_ident
from typing import TYPE_CHECKING

import h5py
from h5py import h5f, h5p

from edmctl.record import locks

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


def open_hdf5(path: Path, mode: str = "r", **how: object) -> h5py.File:
    """Open the file at `path`; `how` is handed on to h5py. Raises what h5py raises.

    A call of h5py alone would fail on network disks without a lock service.
    """
    return h5py.File(path, mode, locking=locks.of_hdf5(path), **how)


def image_of(fill: Callable[[h5py.File], None], **how: object) -> bytes:
    """Return the bytes of a new file that `fill` has filled; `how` is handed on to h5py.

    It is built in memory, because HDF5 does not survive a disk that fills up while it creates objects.
    """
    name = f"image {get_ident()}"  # HDF5 goes by names, in memory as well: other threads have theirs open
    with h5py.File(name, "w", driver="core", backing_store=False, **how) as file:
        fill(file)
        file.flush()
        image: bytes = file.id.get_file_image()
    return image


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
