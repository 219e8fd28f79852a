"""What the first bytes of an HDF5 file say (HDF5 file format specification, II.A), read without the library."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

MAGIC = b"\x89HDF\r\n\x1a\n"
_VERSION, _FLAGS = 8, 11
_END_ADDRESS = {0: 40, 1: 44, 2: 28, 3: 28}
"""Offset of the end-of-file address, by version, where addresses have eight bytes."""
_READ_BYTES = 64


@dataclass(frozen=True, slots=True)
class Superblock:
    """`end_bytes` is the length of the data, None where it is not told; `open_for_writing` that nobody closed it."""

    end_bytes: int | None
    open_for_writing: bool


def read_superblock(path: Path) -> Superblock:
    """Read the superblock at the beginning of the file. Raises OSError."""
    with path.open("rb") as file:
        head = file.read(_READ_BYTES)
    version = head[_VERSION] if len(head) > _FLAGS else -1
    offset = _END_ADDRESS.get(version, _READ_BYTES)
    end_bytes = struct.unpack_from("<Q", head, offset)[0] if offset + 8 <= len(head) else None
    return Superblock(end_bytes, version == 3 and head[_FLAGS] != 0)
