"""Opens HDF5 files with the locks of their file system, and run files with the reason why one cannot be read."""

from __future__ import annotations

import ctypes
import errno
import math
import os
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from threading import get_ident

import h5py
from h5py import h5d, h5f, h5i, h5l, h5p

from edmctl import failures
from edmctl.errors import RunFileError
from edmctl.files import open_regular, refuse_locked
from edmctl.record import layout, locks
from edmctl.record.disk import HDF5_ERRORS, PARTIAL
from edmctl.record.integrity import MAGIC, Checksum, are_sound, read_superblock, verify_checksum


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


_ANOTHER = "Give a file that a run has written (.h5 or .h5.partial)."


def open_file(path: Path, *, verify: bool = True) -> h5py.File:
    """Open the run file at `path`; without `verify` its check sum is not compared, which takes reading all of it.

    Raises RunFileError: E9005 there is none or it is not a run file, E9006 a later version wrote it, E9007 it is
    damaged, E9016 another program has locked it.
    """
    refuse_unreadable(path)
    seal = _seal_of(path) if verify else None
    if seal is Checksum.BROKEN:
        raise damaged(path, "its check sum does not fit")
    if seal is not Checksum.FITS and not are_sound(path):
        raise damaged(path, "its texts cannot be read")
    try:
        file = open_unjudged(path)
    except HDF5_ERRORS as error:
        raise damaged(path, _too_short(path) or str(error).splitlines()[0]) from error
    try:
        refuse_foreign(path, file)
        if seal is Checksum.NONE:
            _check_length(path)
    except BaseException:
        file.close()
        raise
    return file


def damaged(path: Path, why: str) -> RunFileError:
    """Return the error for a file that began as a run file and cannot be read as one any more."""
    return failures.run_file_damaged(path=path, why=why)


def refuse_unreadable(path: Path) -> None:
    """Raise RunFileError: E9005 there is no file, or it is not HDF5, E9016 another program has locked it."""
    try:
        if path.exists() and not (path.is_file() or path.is_dir()):
            raise failures.not_a_file(path=path, another=_ANOTHER)
        if path.is_dir():
            raise failures.run_file_is_folder(path=path)
        with open_regular(path) as file:
            begin = file.read(len(MAGIC))
        if not begin:
            raise failures.run_file_empty(path=path, another=_ANOTHER)
        if begin != MAGIC:
            raise failures.run_file_not_hdf5(path=path, another=_ANOTHER)
        refuse_locked(path)
        _refuse_holes(path)
    except BlockingIOError as error:
        raise failures.run_file_in_use(path=path, reason=error.strerror) from None
    except FileNotFoundError as error:
        raise failures.run_file_missing(path=path, remedy=_nearest(path)) from error
    except OSError as error:
        raise _unreadable(path, error) from error


_HOLES_BYTES, _HOLES_RATIO = 1 << 26, 100
"""A file that is so much longer than what the disk stores of it; compressing file systems reach a ratio of 32."""


def _refuse_holes(path: Path) -> None:
    """Raise OSError EFBIG if almost all of a file are holes, so that reading it would not end."""
    found = path.stat()
    stored_bytes = 512 * getattr(found, "st_blocks", found.st_size)
    if found.st_size > _HOLES_BYTES + _HOLES_RATIO * stored_bytes:
        raise OSError(errno.EFBIG, f"of its {found.st_size / 1e9:.0f} GB almost nothing was written")


def _seal_of(path: Path) -> Checksum:
    try:
        return verify_checksum(path)
    except OSError as error:
        raise _unreadable(path, error) from error


def _unreadable(path: Path, error: OSError) -> RunFileError:
    return failures.run_file_unreadable(path=path, reason=error.strerror)


def open_unjudged(path: Path) -> h5py.File:
    """Open the run file at `path`, live or not, without a look at what it holds. Raises what h5py raises."""
    # A live or killed writer leaves the file marked as open; SWMR readers are made for that. They do not see that
    # a file was cut short, so all others must do without.
    marked = read_superblock(path).open_for_writing
    return open_swmr(path) if marked else open_hdf5(path)


def _too_short(path: Path) -> str:
    """What is wrong with a file that was cut off; empty where it was not."""
    end_bytes, size_bytes = read_superblock(path).end_bytes, path.stat().st_size
    if end_bytes is None or size_bytes >= end_bytes:
        return ""
    return f"it is shorter than it says, {size_bytes} of {end_bytes} bytes"


def _check_length(path: Path) -> None:
    """A closed file without a seal ends where its data end: what is behind them is what was left of a seal."""
    superblock = read_superblock(path)
    if not superblock.open_for_writing and path.stat().st_size != superblock.end_bytes:
        raise damaged(path, "its check sum is not whole")


def refuse_foreign(path: Path, file: h5py.File) -> None:
    """Raise RunFileError: E9005 it is no run file, E9006 of another version, E9007 damaged."""
    try:
        schema, maker = (str(file.attrs.get(name, "")) for name in ("schema", "edmctl_version"))
    except (*HDF5_ERRORS, KeyError) as error:
        raise damaged(path, str(error).splitlines()[0]) from error
    name, _, version = schema.partition("/")
    present_name, _, present = layout.SCHEMA.partition("/")
    if name != present_name or not version.isdigit():
        raise failures.not_a_run_file(path=path, another=_ANOTHER)
    if int(version) > int(present):
        raise failures.run_file_of_later_version(path=path, schema=schema, schema_2=layout.SCHEMA)
    if int(version) < int(present):
        raise failures.run_file_of_earlier_version(
            path=path, maker=maker, schema=schema, schema_2=layout.SCHEMA
        )


def _nearest(path: Path) -> str:
    for folder in (path.parent, path.parent / "runs"):
        for ending in (PARTIAL, f".h5{PARTIAL}"):
            partial = folder / f"{path.name}{ending}"
            if partial.exists():
                return f"The run was not finished; its rows are in {partial}."
        finished = folder / f"{path.name}.h5"
        if finished.exists():
            return f"Did you mean {finished}?"
    if not path.parent.is_dir():
        return "Check the path."
    where = "" if len(path.parts) == 1 else f" {path.parent}"
    return f"`edmctl run list{where}` tells which there are."
