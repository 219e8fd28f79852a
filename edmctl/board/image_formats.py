"""File formats of images: ELF (32 bits, little endian: sections, load addresses, symbols) and Intel HEX.

`struct` reads both in a page; a library would be another package to install.
"""

from __future__ import annotations

import struct

from edmctl.dataclasses import dataclass

_HEADER = struct.Struct("<16sHHIIIIIHHHHHH")
_SECTION, _SEGMENT, _SYMBOL = struct.Struct("<10I"), struct.Struct("<8I"), struct.Struct("<IIIBBH")
_MAGIC, _CLASS_32, _LITTLE_ENDIAN = b"\x7fELF", 1, 1
_SYMTAB, _NOBITS, _ALLOCATED, _LOADED = 2, 8, 2, 1
ARM = 40
ERASED = 0xFF
_DATA, _END, _SEGMENT_BASE, _UPPER_BASE = 0, 1, 2, 4
_LINE_BYTES = 16
_FARTHEST = 1 << 26


@dataclass(frozen=True, slots=True)
class ElfSection:
    """A section: where it is when the program runs, and how much the file holds of it."""

    name: str
    kind: int
    address: int
    offset: int
    size: int
    link: int
    is_allocated: bool


@dataclass(frozen=True, slots=True)
class ElfSegment:
    """Bytes of the file that go to an address, of those in flash `load_address`."""

    offset: int
    address: int
    load_address: int
    size: int


class ForeignElf(ValueError):
    """An ELF of another kind of machine."""


class Elf:
    """An ELF file in memory. Raises ValueError for a damaged one, ForeignElf for one of another machine."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        try:
            self._read()
        except (struct.error, IndexError) as error:
            raise ValueError("it is cut off, or its tables point beyond its end") from error
        except UnicodeDecodeError as error:
            raise ValueError("the names in it cannot be read") from error

    def _read(self) -> None:
        fields = _HEADER.unpack_from(self.data)
        identity, machine, segments_at, sections_at = fields[0], fields[2], fields[5], fields[6]
        segment_size, segments, section_size, sections, names = fields[9:14]
        if identity[:6] != _MAGIC + bytes((_CLASS_32, _LITTLE_ENDIAN)) or machine != ARM:
            raise ForeignElf("it is no program for a 32-bit ARM")
        headers = [_SECTION.unpack_from(self.data, sections_at + n * section_size) for n in range(sections)]
        texts = headers[names]
        self.sections = [
            ElfSection(self._text(texts[4] + h[0]), h[1], h[3], h[4], h[5], h[6], bool(h[2] & _ALLOCATED))
            for h in headers
        ]
        programs = [_SEGMENT.unpack_from(self.data, segments_at + n * segment_size) for n in range(segments)]
        self.segments = [ElfSegment(p[1], p[2], p[3], p[4]) for p in programs if p[0] == _LOADED and p[4]]
        if any(s.offset + s.size > len(self.data) for s in self.segments):
            raise ValueError("it is cut off")
        self.symbols = self._symbols()

    def _symbols(self) -> dict[str, tuple[int, int]]:
        """Return address and size of each symbol by its name."""
        found: dict[str, tuple[int, int]] = {}
        for table in (s for s in self.sections if s.kind == _SYMTAB):
            texts = self.sections[table.link].offset
            for at in range(table.offset, table.offset + table.size, _SYMBOL.size):
                name, address, size, *_ = _SYMBOL.unpack_from(self.data, at)
                if name:
                    found[self._text(texts + name)] = (address, size)
        return found

    def _text(self, at: int) -> str:
        end = self.data.find(b"\0", at)
        if end < 0:
            raise ValueError("it is cut off")
        return self.data[at:end].decode()

    def load_address_of(self, section: ElfSection) -> int:
        """Where the bytes of a section lie before the program runs: its own address, or that of initial values."""
        for segment in self.segments:
            if section.kind != _NOBITS and 0 <= section.offset - segment.offset < segment.size:
                return segment.load_address + section.offset - segment.offset
        return section.address

    def image(self) -> tuple[int, bytes]:
        """Return the lowest load address, and all that is loaded from there on, with gaps as erased flash."""
        if not self.segments:
            raise ValueError("nothing of it is loaded")
        base = min(s.load_address for s in self.segments)
        end = max(s.load_address + s.size for s in self.segments)
        if end - base > 1 << 26:
            raise ValueError("what is loaded of it lies too far apart")
        image = bytearray([ERASED]) * (end - base)
        for s in self.segments:
            image[s.load_address - base : s.load_address - base + s.size] = self.data[
                s.offset : s.offset + s.size
            ]
        return base, bytes(image)

    def offset_of(self, load_address: int) -> int:
        """Where in the file the byte of a load address is."""
        for s in self.segments:
            if 0 <= load_address - s.load_address < s.size:
                return s.offset + load_address - s.load_address
        raise ValueError(f"nothing of it is loaded to 0x{load_address:08X}")


def hex_of(address: int, data: bytes) -> str:
    """Return data at an address as Intel HEX."""
    lines, upper = [], -1
    for at in range(0, len(data), _LINE_BYTES):
        place = address + at
        if place >> 16 != upper:
            upper = place >> 16
            lines.append(_line(0, _UPPER_BASE, upper.to_bytes(2, "big")))
        lines.append(_line(place & 0xFFFF, _DATA, data[at : at + _LINE_BYTES]))
    return "\n".join([*lines, _line(0, _END, b"")]) + "\n"


def parse_hex(text: str) -> tuple[int, bytes]:
    """Return the lowest address and the data from there on, with gaps as erased flash. Raises ValueError."""
    pieces: dict[int, bytes] = {}
    upper, is_ended = 0, False
    for number, line in enumerate(text.split(), 1):
        record = _bytes_of(line)
        if len(record) < 5 or len(record) != record[0] + 5 or sum(record) & 0xFF:
            raise ValueError(f"line {number} is damaged")
        place, kind, content = int.from_bytes(record[1:3], "big"), record[3], record[4:-1]
        if kind == _DATA:
            pieces[upper + place] = content
        elif kind in (_SEGMENT_BASE, _UPPER_BASE):
            upper = int.from_bytes(content, "big") << (4 if kind == _SEGMENT_BASE else 16)
        elif kind == _END:
            is_ended = True
    if not pieces or not is_ended:
        raise ValueError("it is cut off")
    base, end = min(pieces), max(at + len(piece) for at, piece in pieces.items())
    if end - base > _FARTHEST:
        raise ValueError("its data lie too far apart")
    data = bytearray([ERASED]) * (end - base)
    for at, piece in pieces.items():
        data[at - base : at - base + len(piece)] = piece
    return base, bytes(data)


def _bytes_of(line: str) -> bytes:
    """Return the bytes of a line; none if it is not Intel HEX."""
    try:
        return bytes.fromhex(line[1:]) if line.startswith(":") else b""
    except ValueError:
        return b""


def _line(address: int, kind: int, content: bytes) -> str:
    record = bytes((len(content), address >> 8, address & 0xFF, kind)) + content
    return f":{record.hex().upper()}{-sum(record) & 0xFF:02X}"
