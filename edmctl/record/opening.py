"""Opens HDF5 files: with the locks of their file system, and only after a look at their bytes.

HDF5 has no check sum over rows and texts, and does not survive every damage. A finished run file therefore has its
length and check sum in a line behind the HDF5 data. The superblock states the length of the data and whether they
were closed (HDF5 file format specification, II.A). Global heaps, where texts of variable length are, have to be
sound: the library does not return from one whose objects have no length.
"""

from __future__ import annotations

import ctypes
import errno
import math
import mmap
import os
import re
import struct
import zlib
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from threading import get_ident
from typing import Any, BinaryIO

import h5py
import numpy as np
from h5py import h5d, h5f, h5i, h5l, h5p, h5s
from numpy.typing import NDArray

from edmctl import failures
from edmctl.files import open_regular, refuse_locked
from edmctl.record import disk, layout
from edmctl.record.disk import HDF5_ERRORS, PARTIAL

MAGIC = b"\x89HDF\r\n\x1a\n"
_VERSION, _FLAGS = 8, 11
_END_ADDRESS = {0: 40, 1: 44, 2: 28, 3: 28}
"""Offset of the end-of-file address, by version, where addresses have eight bytes."""
_MARK = slice(20, 24)
"""Bytes of a superblock of version 0 or 1 that HDF5 sets while a program has the file open for writing."""
_READ_BYTES = 64

_FORM = "\nedmctl-seal length {length:020d} crc32 {crc:08x}\n"
_SEAL = re.compile(rb"\nedmctl-seal length (\d{20}) crc32 ([0-9a-f]{8})\n")
SEAL_BYTES = len(_FORM.format(length=0, crc=0))
_BLOCK_BYTES = 1 << 20

_HEAP = b"GCOL\x01\x00\x00\x00"
"""Signature, version and reserved bytes (HDF5 file format specification, III.E)."""
_HEADER = struct.Struct("<8sQ")
_OBJECT = struct.Struct("<HHIQ")

INFLATED = 1100
"""Rows take at least this part of their size in the file: gzip compresses a byte no further."""
_SMALL_BYTES = 1 << 24
_HOLES_BYTES, _HOLES_RATIO = 1 << 26, 100
"""A file that is so much longer than what the disk stores of it; compressing file systems reach a ratio of 32."""
ATTEMPTS = 24
"""They take 2^24 ns = 17 ms together; a writer is done with a piece in a fraction of that."""


def read_superblock(path: Path) -> tuple[int | None, bool]:
    """Return the length of the data, if it is given, and whether a writer has not closed them. Raises OSError."""
    with open_regular(path) as file:
        head = file.read(_READ_BYTES)
    version = head[_VERSION] if len(head) > _FLAGS else -1
    offset = _END_ADDRESS.get(version, _READ_BYTES)
    end_bytes = struct.unpack_from("<Q", head, offset)[0] if offset + 8 <= len(head) else None
    return end_bytes, version == 3 and head[_FLAGS] != 0


def append_checksum(path: Path) -> None:
    """Append length and check sum to the closed file at `path`."""
    with path.open("r+b") as file:
        length = path.stat().st_size
        file.write(_FORM.format(length=length, crc=_crc32(file, length)).encode())


def verify_checksum(path: Path) -> bool | None:
    """Return whether the check sum behind the data of a file fits; None if it has none. Raises OSError."""
    with open_regular(path) as file:
        length = file.seek(0, 2) - SEAL_BYTES
        file.seek(max(0, length))
        seal = _SEAL.fullmatch(file.read(SEAL_BYTES))
        if seal is None:
            return None
        file.seek(0)
        return int(seal[1]) == length and _crc32(file, length) == int(seal[2], 16)


def _crc32(file: BinaryIO, length: int) -> int:
    """Return the CRC-32 of the first `length` bytes, as if no program had marked the file."""
    crc = done = 0
    while block := file.read(min(_BLOCK_BYTES, length - done)):
        if done == 0 and block[_VERSION : _VERSION + 1] in (b"\0", b"\1"):
            block = block[: _MARK.start] + bytes(4) + block[_MARK.stop :]
        crc = zlib.crc32(block, crc)
        done += len(block)
    return crc


def is_whole(path: Path) -> bool:
    """Return whether `path` is a file with a check sum that fits."""
    with suppress(OSError):
        return verify_checksum(path) is True
    return False


def heap_breaks(path: Path) -> list[tuple[int, int]]:
    """Return where the objects of a global heap break off, and where that heap would have ended. Raises OSError."""
    breaks = []
    if path.stat().st_size:
        with open_regular(path) as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            begin = content.find(_HEAP)
            while begin >= 0:
                place, end = _last_object(content, begin)
                if place != end:
                    breaks.append((place, end))
                begin = content.find(_HEAP, begin + _HEADER.size)
    return breaks


def end_at_breaks(path: Path) -> None:
    """Let each broken heap of the file at `path` end at its break: its further texts are lost. Raises OSError."""
    breaks = heap_breaks(path)
    with path.open("r+b") as file:
        for place, end in breaks:
            file.seek(place)
            file.write(_OBJECT.pack(0, 0, 0, end - place))


def _last_object(content: mmap.mmap, begin: int) -> tuple[int, int]:
    """Return how far the objects of the heap at `begin` are sound, and its end: equal if all are."""
    place = begin + _HEADER.size
    if place > len(content):
        return begin, len(content)
    end = begin + _HEADER.unpack_from(content, begin)[1]
    while place + _OBJECT.size <= min(end, len(content)):
        index, _, _, length = _OBJECT.unpack_from(content, place)
        if index == 0:  # the free space behind the last object, its own header counted
            return (end, end) if length == end - place else (place, end)
        following = place + _OBJECT.size + (length + 7) // 8 * 8
        if following > end:
            return place, end
        place = following
    # Too little for another header may remain.
    return (end, end) if 0 <= end - place < _OBJECT.size and end <= len(content) else (place, end)


def open_hdf5(path: Path, mode: str = "r", **how: object) -> h5py.File:
    """Open an HDF5 file with the locks of its disk. Raises what h5py raises, ValueError for external links."""
    return _without_links(h5py.File(path, mode, locking=disk.hdf5_locking(path), **how))


def open_swmr(path: Path) -> h5py.File:
    """Open the file at `path` for reading while another process may write it. Raises OSError."""
    plist = h5p.create(h5p.FILE_ACCESS)
    plist.set_libver_bounds(h5f.LIBVER_EARLIEST, h5f.LIBVER_LATEST)
    if (limit := _limit_of_attempts()) is not None:
        limit(plist.id, ATTEMPTS)
    if not disk.locks_are_known(path.parent):
        plist.set_file_locking(False, True)
    flags = h5f.ACC_RDONLY | h5f.ACC_SWMR_READ
    return _without_links(h5py.File(h5f.open(os.fsencode(path), flags, plist)))


@cache
def _limit_of_attempts() -> Callable[[int, int], int] | None:
    """Return HDF5's call that limits how often metadata are read again; None where it cannot be found."""
    try:
        call = ctypes.CDLL(h5p.__file__).H5Pset_metadata_read_attempts
    except (OSError, AttributeError):
        return None
    call.argtypes, call.restype = (ctypes.c_int64, ctypes.c_uint), ctypes.c_int
    limit: Callable[[int, int], int] = call
    return limit


def _without_links(file: h5py.File) -> h5py.File:
    """Return a file that has no link to another one, which could be a pipe. Raises ValueError."""
    link = None
    with suppress(RuntimeError, KeyError, ValueError):  # of a damaged file, whose reader reports it
        link = file.id.links.visit(
            lambda name, info: name if info.type == h5l.TYPE_EXTERNAL else None, info=True
        )
    if link is not None:
        file.close()
        raise ValueError(f"{link.decode(errors='replace')} is a link to another file")
    return file


def refuse_endless(dataset: h5d.DatasetID) -> None:
    """Raise ValueError if a dataset claims more rows than its allocated chunks can hold, or lies in another file."""
    properties = dataset.get_create_plist()
    if properties.get_layout() == h5d.VIRTUAL or properties.get_external_count():
        raise ValueError("its rows are in another file")
    claimed = math.prod(dataset.shape or (0,)) * dataset.dtype.itemsize
    if claimed > _SMALL_BYTES + INFLATED * dataset.get_storage_size():
        name = h5i.get_name(dataset).decode(errors="replace")
        raise ValueError(f"{name} claims {dataset.shape[0]} rows and does not contain them")


def open_dataset(file: h5py.File, path: str) -> h5d.DatasetID | None:
    """Return a dataset that is not endless; None where an older file has none. Raises what h5py raises."""
    # Low-level calls take a quarter of the time: `run list` reads twenty values of every file.
    try:
        dataset = h5d.open(file.id, path.encode())
    except KeyError:
        if path in file:
            raise
        return None
    refuse_endless(dataset)
    return dataset


def read_value(file: h5py.File, path: str) -> NDArray[Any] | None:
    """Return the whole content of a dataset, as `open_dataset`."""
    dataset = open_dataset(file, path)
    if dataset is None:
        return None
    value = np.empty(dataset.shape, dataset.dtype)
    if value.size:
        dataset.read(h5s.ALL, h5s.ALL, value)
    return value


def plain(value: Any) -> Any:
    """Return a number of NumPy as one of Python, anything else as it is."""
    return value.item() if isinstance(value, np.generic) else value


def image_of(fill: Callable[[h5py.File], None], **how: object) -> bytes:
    """Return the bytes of a file that `fill` fills in memory: HDF5 does not survive a disk that fills up."""
    # HDF5 distinguishes files by name, in memory as well: other threads have theirs open.
    name = f"image {get_ident()}"
    with h5py.File(name, "w", driver="core", backing_store=False, **how) as file:
        fill(file)
        file.flush()
        image: bytes = file.id.get_file_image()
    return image


def open_file(path: Path, *, verify: bool = True) -> h5py.File:
    """Open a run file; `verify` compares its check sum. Raises RunFileError E9005, E9006, E9007, E9016."""
    refuse_unreadable(path)
    try:
        fits = verify_checksum(path) if verify else None
        problem = "its check sum does not fit" if fits is False else ""
        if fits is None and heap_breaks(path):
            problem = "its texts cannot be read"
        if problem:
            raise failures.run_file_damaged(path=path, why=problem)
        (end_bytes, is_open), size_bytes = read_superblock(path), path.stat().st_size
    except OSError as error:
        raise failures.run_file_unreadable(path=path, reason=error.strerror) from error
    try:
        file = open_unjudged(path)
    except HDF5_ERRORS as error:
        why = str(error).splitlines()[0]
        if end_bytes is not None and size_bytes < end_bytes:
            why = f"it is shorter than it says, {size_bytes} of {end_bytes} bytes"
        raise failures.run_file_damaged(path=path, why=why) from error
    try:
        refuse_foreign(path, file)
        if "entry" not in file:
            raise failures.run_file_damaged(path=path, why="it has no group /entry")
        # Behind the data of a closed file there is nothing but its seal.
        if verify and fits is None and not is_open and size_bytes != end_bytes:
            raise failures.run_file_damaged(path=path, why="its check sum is not whole")
    except BaseException:
        file.close()
        raise
    return file


def open_unjudged(path: Path) -> h5py.File:
    """Open the run file at `path`, live or not, without a look at what it holds. Raises what h5py raises."""
    # A live or killed writer leaves the file marked as open; SWMR readers are made for that. They do not see that
    # a file was cut short, so all others must do without.
    return open_swmr(path) if read_superblock(path)[1] else open_hdf5(path)


def refuse_unreadable(path: Path) -> None:
    """Raise RunFileError: E9005 there is no file, or it is not HDF5, E9016 another program has locked it."""
    try:
        if path.is_dir():
            raise failures.run_file_is_folder(path=path)
        if path.exists() and not path.is_file():
            raise failures.not_a_run_file(path=path, what="is no file")
        with open_regular(path) as file:
            begin = file.read(len(MAGIC))
        if not begin:
            raise failures.not_a_run_file(path=path, what="is empty")
        if begin != MAGIC:
            raise failures.not_a_run_file(path=path, what="is not an HDF5 file")
        refuse_locked(path)
        # Reading a file that is nearly all holes would not end.
        size_bytes, blocks = path.stat().st_size, getattr(path.stat(), "st_blocks", math.inf)
        if size_bytes > _HOLES_BYTES + _HOLES_RATIO * 512 * blocks:
            raise OSError(errno.EFBIG, f"of its {size_bytes / 1e9:.0f} GB almost nothing was written")
    except BlockingIOError as error:
        raise failures.run_file_in_use(path=path, reason=error.strerror) from None
    except FileNotFoundError as error:
        raise failures.run_file_missing(path=path, remedy=_nearest(path)) from error
    except OSError as error:
        raise failures.run_file_unreadable(path=path, reason=error.strerror) from error


def refuse_foreign(path: Path, file: h5py.File) -> None:
    """Raise RunFileError: E9005 it is no run file, E9006 of another version, E9007 damaged."""
    try:
        schema, maker = (str(file.attrs.get(name, "")) for name in ("schema", "edmctl_version"))
    except (*HDF5_ERRORS, KeyError) as error:
        raise failures.run_file_damaged(path=path, why=str(error).splitlines()[0]) from error
    name, _, version = schema.partition("/")
    own_name, _, own = layout.SCHEMA.partition("/")
    if name != own_name or not version.isdigit():
        raise failures.not_a_run_file(path=path, what="is an HDF5 file, but not a run file of edmctl")
    if int(version) > int(own):
        raise failures.run_file_of_later_version(path=path, schema=schema, own_schema=layout.SCHEMA)
    if int(version) < int(own):
        raise failures.run_file_of_earlier_version(
            path=path, maker=maker, schema=schema, own_schema=layout.SCHEMA
        )


def _nearest(path: Path) -> str:
    """Return the remedy for a run file that is not there."""
    for folder in (path.parent, path.parent / "runs"):
        for ending in (PARTIAL, f".h5{PARTIAL}"):
            if (partial := folder / f"{path.name}{ending}").exists():
                return f"The run was not finished; its rows are in {partial}."
        if (finished := folder / f"{path.name}.h5").exists():
            return f"Did you mean {finished}?"
    if not path.parent.is_dir():
        return "Check the path."
    folder_named = "" if len(path.parts) == 1 else f" {path.parent}"
    return f"`edmctl run list{folder_named}` lists the runs."
