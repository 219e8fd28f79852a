"""What the bytes of an HDF5 file say, looked at before the library opens it.

The superblock tells the length of the data and whether a writer has closed them (HDF5 file format specification,
II.A). A finished run file has its length and check sum in a line behind the end of the HDF5 data, which HDF5 does
not see: HDF5 has no check sum over rows and texts, and does not survive every damage. Global heaps, where texts of
variable length are, have none either, and the library does not come back from one whose objects have no length.
"""

from __future__ import annotations

import mmap
import re
import struct
import zlib
from enum import Enum
from pathlib import Path
from typing import BinaryIO

from edmctl.dataclasses import dataclass
from edmctl.files import open_regular

MAGIC = b"\x89HDF\r\n\x1a\n"
_VERSION, _FLAGS = 8, 11
_END_ADDRESS = {0: 40, 1: 44, 2: 28, 3: 28}
"""Offset of the end-of-file address, by version, where addresses have eight bytes."""
_READ_BYTES = 64


@dataclass(frozen=True, slots=True)
class Superblock:
    """The length of the data, None where it is not given, and whether a writer has not closed the file."""

    end_bytes: int | None
    open_for_writing: bool


def read_superblock(path: Path) -> Superblock:
    """Read the superblock at the beginning of the file. Raises OSError."""
    with open_regular(path) as file:
        head = file.read(_READ_BYTES)
    version = head[_VERSION] if len(head) > _FLAGS else -1
    offset = _END_ADDRESS.get(version, _READ_BYTES)
    end_bytes = struct.unpack_from("<Q", head, offset)[0] if offset + 8 <= len(head) else None
    return Superblock(end_bytes, version == 3 and head[_FLAGS] != 0)


_FORM = "\nedmctl-seal length {length:020d} crc32 {crc:08x}\n"
_SEAL = re.compile(rb"\nedmctl-seal length (\d{20}) crc32 ([0-9a-f]{8})\n")
SEAL_BYTES = len(_FORM.format(length=0, crc=0))
_AT_ONCE = 1 << 20


class Checksum(Enum):
    """Whether a file has a check sum behind its data, and whether that fits."""

    NONE = "none"
    FITS = "fits"
    BROKEN = "broken"


def append_checksum(path: Path) -> None:
    """Append length and check sum to the closed file at `path`."""
    with path.open("r+b") as file:
        length, crc = _sum(file, None)
        file.write(_FORM.format(length=length, crc=crc).encode())


def verify_checksum(path: Path) -> Checksum:
    """Compare the file at `path` with its check sum. Raises OSError."""
    with open_regular(path) as file:
        length = file.seek(0, 2) - SEAL_BYTES
        if length < 0:
            return Checksum.NONE
        file.seek(length)
        found = _SEAL.fullmatch(file.read(SEAL_BYTES))
        if found is None:
            return Checksum.NONE
        if int(found[1]) != length:
            return Checksum.BROKEN
        file.seek(0)
        _, crc = _sum(file, length)
    return Checksum.FITS if crc == int(found[2], 16) else Checksum.BROKEN


def is_whole(path: Path) -> bool:
    """Return whether `path` is a file with a check sum that fits."""
    try:
        return verify_checksum(path) is Checksum.FITS
    except OSError:
        return False


_MARK = slice(20, 24)
"""Bytes of a superblock of version 0 or 1 that HDF5 sets while a program has the file open for writing."""


def _sum(file: BinaryIO, length: int | None) -> tuple[int, int]:
    """Return length and CRC-32 of the first `length` bytes, or of all, as if no program had marked the file."""
    crc = done = 0
    while block := file.read(_AT_ONCE if length is None else min(_AT_ONCE, length - done)):
        if done == 0 and block[_VERSION : _VERSION + 1] in (b"\0", b"\1"):
            block = block[: _MARK.start] + bytes(4) + block[_MARK.stop :]
        crc = zlib.crc32(block, crc)
        done += len(block)
    return done, crc


_BEGIN = b"GCOL\x01\x00\x00\x00"
"""Signature, version and reserved bytes (HDF5 file format specification, III.E)."""
_HEADER = struct.Struct("<8sQ")
_OBJECT = struct.Struct("<HHIQ")


def are_sound(path: Path) -> bool:
    """Whether each heap of the file at `path` can be gone through to its end. Raises OSError."""
    return not _breaks(path)


def end_at_breaks(path: Path) -> None:
    """Have each heap of the file at `path` end where it cannot be gone through: what is behind is lost, not endless.

    Writes to the file. Raises OSError.
    """
    breaks = _breaks(path)
    with path.open("r+b") as file:
        for place, end in breaks:
            file.seek(place)
            file.write(_OBJECT.pack(0, 0, 0, end - place))


def _breaks(path: Path) -> list[tuple[int, int]]:
    """Where heaps break, and where they would have ended."""
    if path.stat().st_size == 0:
        return []
    found = []
    with open_regular(path) as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        begin = content.find(_BEGIN)
        while begin >= 0:
            place, end = _go_through(content, begin)
            if place != end:
                found.append((place, end))
            begin = content.find(_BEGIN, begin + _HEADER.size)
    return found


def _go_through(content: mmap.mmap, begin: int) -> tuple[int, int]:
    """How far the heap at `begin` can be gone through, and where it ends: the same of one that is sound."""
    if begin + _HEADER.size > len(content):
        return begin, len(content)
    _, size = _HEADER.unpack_from(content, begin)
    end = begin + size
    place = begin + _HEADER.size
    while place + _OBJECT.size <= min(end, len(content)):
        index, _, _, length = _OBJECT.unpack_from(content, place)
        if index == 0:  # the free space behind the last object, its own header counted
            return (end, end) if length == end - place else (place, end)
        following = place + _OBJECT.size + (length + 7) // 8 * 8
        if following > end:
            return place, end
        place = following
    # Too little for another header may be left over.
    return (end, end) if 0 <= end - place < _OBJECT.size and end <= len(content) else (place, end)
