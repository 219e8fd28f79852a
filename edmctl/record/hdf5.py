"""Opens HDF5 files: those on the disk with locks where their file system knows any, new ones in memory."""

from __future__ import annotations

import ctypes
import math
import os
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from threading import get_ident

import h5py
from h5py import h5d, h5f, h5i, h5l, h5p

from edmctl.record import locks


def open_hdf5(path: Path, mode: str = "r", **how: object) -> h5py.File:
    """Open the file at `path`; h5py gets `how`. Raises what h5py raises, and ValueError for a link to another file.

    A call of h5py alone would fail on network disks without a lock service.
    """
    return _without_links(h5py.File(path, mode, locking=locks.of_hdf5(path), **how))


def _without_links(file: h5py.File) -> h5py.File:
    """Return a file that has no link to another one, which could be a pipe. Raises ValueError."""
    found = None
    with suppress(RuntimeError, KeyError, ValueError):  # of a damaged file, whose reader reports it
        found = file.id.links.visit(
            lambda name, info: name if info.type == h5l.TYPE_EXTERNAL else None, info=True
        )
    if found is not None:
        file.close()
        raise ValueError(f"{found.decode(errors='replace')} is a link to another file")
    return file


INFLATED = 1100
"""Rows take at least this part of their size in the file: gzip makes no more of a byte."""
_SMALL_BYTES = 1 << 24


def refuse_endless(dataset: h5d.DatasetID) -> None:
    """Raise ValueError if a dataset claims more rows than its allocated chunks can hold, or lies in another file."""
    properties = dataset.get_create_plist()
    if properties.get_layout() == h5d.VIRTUAL or properties.get_external_count():
        raise ValueError("its rows are in another file")
    claimed = math.prod(dataset.shape or (0,)) * dataset.dtype.itemsize
    if claimed > _SMALL_BYTES + INFLATED * dataset.get_storage_size():
        name = h5i.get_name(dataset).decode(errors="replace")
        raise ValueError(f"{name} claims {dataset.shape[0]} rows and does not contain them")


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
    return _without_links(h5py.File(h5f.open(os.fsencode(path), flags, plist)))


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
