"""The seal of a finished run file: its length and check sum, in a line behind the end of the HDF5 data.

HDF5 does not see what stands behind its end-of-file address. The check sum finds every change before the library
meets it: HDF5 itself has none over rows and texts, and does not survive every damage.
"""

from __future__ import annotations

import re
import zlib
from enum import Enum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path
    from typing import BinaryIO

_FORM = "\nedmctl-seal length {length:020d} crc32 {crc:08x}\n"
_SEAL = re.compile(rb"\nedmctl-seal length (\d{20}) crc32 ([0-9a-f]{8})\n")
SEAL_BYTES = len(_FORM.format(length=0, crc=0))
_AT_ONCE = 1 << 20


class Seal(Enum):
    """What a file's seal says."""

    NONE = "none"
    WHOLE = "whole"
    BROKEN = "broken"


def seal(path: Path) -> None:
    """Put the seal behind the end of the closed file at `path`."""
    with path.open("r+b") as file:
        length, crc = _sum(file, None)
        file.write(_FORM.format(length=length, crc=crc).encode())


def look_at_seal(path: Path) -> Seal:
    """Compare the file at `path` with its seal. Raises OSError."""
    with path.open("rb") as file:
        length = file.seek(0, 2) - SEAL_BYTES
        if length < 0:
            return Seal.NONE
        file.seek(length)
        found = _SEAL.fullmatch(file.read(SEAL_BYTES))
        if found is None:
            return Seal.NONE
        if int(found[1]) != length:
            return Seal.BROKEN
        file.seek(0)
        _, crc = _sum(file, length)
    return Seal.WHOLE if crc == int(found[2], 16) else Seal.BROKEN


def _sum(file: BinaryIO, length: int | None) -> tuple[int, int]:
    """Length and CRC-32 of the next `length` bytes, or of all."""
    crc = done = 0
    while block := file.read(_AT_ONCE if length is None else min(_AT_ONCE, length - done)):
        crc = zlib.crc32(block, crc)
        done += len(block)
    return done, crc
