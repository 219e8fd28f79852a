"""An image as the linker left it: what is loaded where, and where its symbols are (ELF32, little-endian)."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

_SECTION = struct.Struct("<10I")
_SEGMENT = struct.Struct("<8I")
_SYMBOL = struct.Struct("<3I2BH")
_LOAD, _SYMBOLS = 1, 2


class Image:
    """Segments (address, bytes) to be flashed, and addresses of global symbols. ValueError where it is no such file."""

    def __init__(self, path: Path) -> None:
        data = path.read_bytes()
        if data[:6] != b"\x7fELF\x01\x01" or len(data) < 52:
            raise ValueError(f"{path.name} is no image for a 32-bit chip")
        segments_at, sections_at = struct.unpack_from("<2I", data, 28)
        segment_size, segments, section_size, sections = struct.unpack_from("<4H", data, 42)
        self.segments: list[tuple[int, bytes]] = []
        for i in range(segments):
            kind, at, _, load, size, *_ = _SEGMENT.unpack_from(data, segments_at + i * segment_size)
            if kind == _LOAD and size:
                self.segments.append((load, data[at : at + size]))
        rows = [_SECTION.unpack_from(data, sections_at + i * section_size) for i in range(sections)]
        self.symbols: dict[str, int] = {}
        for row in rows:
            if row[1] != _SYMBOLS:
                continue
            names = rows[row[6]][4]
            for at in range(row[4], row[4] + row[5], _SYMBOL.size):
                name, value, *_ = _SYMBOL.unpack_from(data, at)
                end = data.index(b"\0", names + name)
                if end > names + name:
                    self.symbols[data[names + name : end].decode()] = value

    def words(self, name: str, count: int) -> tuple[int, ...]:
        """Words of a constant. ValueError where the image has none of that name."""
        address = self.symbols.get(name, 0)
        for at, data in self.segments:
            if at <= address <= at + len(data) - 4 * count:
                return struct.unpack_from(f"<{count}I", data, address - at)
        raise ValueError(f"the image has no {name}")
