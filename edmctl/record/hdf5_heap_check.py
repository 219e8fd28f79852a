"""Looks at an HDF5 file's global heaps, where texts of variable length are, before HDF5 does.

They have no check sums, and the library does not come back from one whose objects have no length.
"""

from __future__ import annotations

import mmap
import struct
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

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
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
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
