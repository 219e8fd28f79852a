"""Opens HDF5 files: those on the disk with locks where their file system knows any, new ones in memory."""

from __future__ import annotations

from threading import get_ident
from typing import TYPE_CHECKING

import h5py

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
