"""Images of a board's firmware, in ELF (32 bits, little endian) or as bytes: what one is, whether it is whole.

Every image contains the record `edm_image`. Size and check are filled in when it is built: the CRC-32 is that of all
bytes of the image, with the four of the check itself as zeros.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from edmctl import failures
from edmctl.board.settings import settings_in
from edmctl.core.boards import Board, board_name, board_of
from edmctl.dataclasses import dataclass
from edmctl.files import read_bytes
from edmctl.link.messages import SCHEMA_HASH
from edmctl.wording import dotted

SYMBOL = "edm_image"
MAGIC = b"EDMI"
MOST_BYTES = 16_000_000
"""Of a file; an ELF with all debugging information has less than 2 MB."""
_RECORD = struct.Struct("<4sBBHIBBBxII")
_CHECK = struct.Struct("<I")
_CHECK_AT = _RECORD.size - _CHECK.size
_SIZE_AT = _CHECK_AT - _CHECK.size

_HEADER = struct.Struct("<16sHHIIIIIHHHHHH")
_SECTION, _SEGMENT, _SYMBOL = struct.Struct("<10I"), struct.Struct("<8I"), struct.Struct("<IIIBBH")
_ARM_ELF = b"\x7fELF\x01\x01"
"""Beginning of an ELF of 32 bits, little endian."""
_ARM, _SYMTAB, _NOBITS, _ALLOCATED, _LOADED = 40, 2, 8, 2, 1
_ERASED = b"\xff"
_FARTHEST = 1 << 26
_CUT_OFF = "it is cut off, or its tables point beyond its end"


@dataclass(frozen=True, slots=True)
class Section:
    """A section of an ELF; `load_address` is that of its initial values, else its own address."""

    name: str
    address: int
    load_address: int
    size_bytes: int
    is_allocated: bool
    has_bytes: bool


class ForeignElf(ValueError):
    """An ELF of another kind of machine."""


class Elf:
    """An ELF in memory. Raises ValueError if damaged, ForeignElf if not for ARM.

    segments : offset, load address and size of what is loaded. symbols : address and size by name.
    """

    def __init__(self, data: bytes) -> None:
        self.data = data
        try:
            fields = _HEADER.unpack_from(data)
            if not fields[0].startswith(_ARM_ELF) or fields[2] != _ARM:
                raise ForeignElf("it is not a program for a 32-bit ARM")
            self.entry = fields[4]
            self._read(*fields[5:7], *fields[9:14])
        except (struct.error, IndexError, UnicodeDecodeError) as error:
            raise ValueError(_CUT_OFF) from error

    def _read(
        self,
        segments_at: int,
        sections_at: int,
        segment_size: int,
        segments: int,
        section_size: int,
        *rest: int,
    ) -> None:
        sections, names = rest
        programs = [_SEGMENT.unpack_from(self.data, segments_at + n * segment_size) for n in range(segments)]
        self.segments: list[tuple[int, int, int]] = [
            (p[1], p[3], p[4]) for p in programs if p[0] == _LOADED and p[4]
        ]
        if any(at + size > len(self.data) for at, _, size in self.segments):
            raise ValueError(_CUT_OFF)
        headers = [_SECTION.unpack_from(self.data, sections_at + n * section_size) for n in range(sections)]
        self.sections: list[Section] = []
        self.symbols: dict[str, tuple[int, int]] = {}
        for name, kind, flags, address, offset, size, link, *_ in headers:
            load_address = address
            for begin, loaded_to, length in self.segments:
                if kind != _NOBITS and 0 <= offset - begin < length:
                    load_address = loaded_to + offset - begin
            text = self._text(headers[names][4] + name)
            is_allocated = bool(flags & _ALLOCATED)
            self.sections.append(Section(text, address, load_address, size, is_allocated, kind != _NOBITS))
            for at in range(offset, offset + size, _SYMBOL.size) if kind == _SYMTAB else ():
                label, symbol_address, symbol_size, *_ = _SYMBOL.unpack_from(self.data, at)
                if label:
                    self.symbols[self._text(headers[link][4] + label)] = symbol_address, symbol_size

    def _text(self, at: int) -> str:
        end = self.data.find(b"\0", at)
        if end < 0:
            raise ValueError(_CUT_OFF)
        return self.data[at:end].decode()

    def image(self) -> tuple[int, bytes]:
        """Return the lowest load address, and all bytes loaded from there on, with gaps as erased flash."""
        if not self.segments:
            raise ValueError("nothing of it is loaded")
        base = min(address for _, address, _ in self.segments)
        end = max(address + size for _, address, size in self.segments)
        if end - base > _FARTHEST:
            raise ValueError("its parts are loaded too far apart")
        image = bytearray(_ERASED * (end - base))
        for at, address, size in self.segments:
            image[address - base : address - base + size] = self.data[at : at + size]
        return base, bytes(image)

    def offset_of(self, load_address: int) -> int:
        """Return where in the file the byte of a load address is."""
        for at, address, size in self.segments:
            if 0 <= load_address - address < size:
                return at + load_address - address
        raise ValueError(f"nothing of it is loaded to {hexadecimal(load_address)}")


@dataclass(frozen=True, slots=True)
class Record:
    """`edm_image` as the board's C has it."""

    protocol: tuple[int, int]
    board: int
    schema_hash: int
    firmware: tuple[int, int, int]
    size_bytes: int
    crc32: int

    @classmethod
    def read(cls, data: bytes, at: int) -> Record:
        """Return the record at an offset. Raises struct.error, ValueError."""
        magic, proto_major, proto_minor, board, schema, major, minor, patch, size, check = (
            _RECORD.unpack_from(data, at)
        )
        if magic != MAGIC:
            raise ValueError("no record")
        return cls((proto_major, proto_minor), board, schema, (major, minor, patch), size, check)


@dataclass(frozen=True, slots=True)
class Image:
    """An image that is whole.

    board : None for one that this program does not know. data : the bytes as they are in the flash.
    sections : those that take memory, of an ELF; other files have none. settings : of the machine's owner, by their
    names in the sources, as far as they differ from the sources.
    """

    path: Path
    kind: str
    record: Record
    board: Board | None
    data: bytes
    sections: tuple[Section, ...]
    settings: Mapping[str, float]

    @property
    def board_name(self) -> str:
        return board_name(self.record.board)

    @property
    def has_same_schema(self) -> bool:
        return self.record.schema_hash == SCHEMA_HASH

    def used_bytes(self) -> dict[str, int]:
        """Return the bytes of each memory that sections take: initial values take flash too."""
        used: dict[str, int] = {}
        for section in self.sections:
            for place in {section.address, section.load_address}:
                memory = (self.board and self.board.memory_of(place)) or "elsewhere"
                used[memory] = used.get(memory, 0) + section.size_bytes
        return used

    def as_mapping(self) -> dict[str, Any]:
        return {
            "file": str(self.path),
            "kind": self.kind,
            "board": self.record.board,
            "board_name": self.board_name,
            "protocol": dotted(self.record.protocol),
            "firmware": dotted(self.record.firmware),
            "schema": hexadecimal(self.record.schema_hash),
            "has_same_schema": self.has_same_schema,
            "size_bytes": self.record.size_bytes,
            "crc32": hexadecimal(self.record.crc32),
            "settings": self.settings,
            "used_bytes": self.used_bytes(),
        }


def hexadecimal(number: int) -> str:
    return f"0x{number:08X}"


def read_image(path: Path) -> Image:
    """Read an image from an ELF or BIN.

    Raises RecordError: E3680 if it cannot be read, E3681 for no image of this firmware, E3682 for a damaged one.
    """
    try:
        content = read_bytes(path, MOST_BYTES)
    except OSError as error:
        raise failures.image_unreadable(path=path, reason=error.strerror) from error
    sections: list[Section] = []
    address: int | None = None
    data = content
    try:
        if content.startswith(b"\x7fELF"):
            elf = Elf(content)
            sections = [section for section in elf.sections if section.is_allocated and section.size_bytes]
            address, data = elf.image()
        record = _find_record(data)
    except ForeignElf as error:
        raise failures.not_an_image(path=path, reason=error) from error
    except ValueError as error:
        raise failures.image_damaged(path=path, reason=error) from error
    if record is None:
        raise failures.not_an_image(path=path, reason="it contains no record of one")
    board = board_of(record.board)
    if board is not None and address not in (None, board.flash.address):
        reason = (
            f"it is loaded to {hexadecimal(address or 0)}, the flash is at {hexadecimal(board.flash.address)}"
        )
        raise failures.image_damaged(path=path, reason=reason)
    if board is not None and len(data) > board.flash.size_bytes:
        reason = f"its {len(data)} bytes are more than the flash of the board has"
        raise failures.image_damaged(path=path, reason=reason)
    data = data[: record.size_bytes]
    kind = "BIN" if address is None else "ELF"
    return Image(path, kind, record, board, data, tuple(sections), settings_in(data))


def seal(elf_data: bytes) -> bytes:
    """Return an ELF as it was linked with size and check of its image filled in. Raises ValueError."""
    elf = Elf(elf_data)
    base, data = elf.image()
    if SYMBOL not in elf.symbols:
        raise ValueError(f"it has no symbol {SYMBOL}")
    place = elf.symbols[SYMBOL][0]
    Record.read(data, place - base)
    offset = elf.offset_of(place)
    sealed, image = bytearray(elf_data), bytearray(data)
    _CHECK.pack_into(image, place - base + _SIZE_AT, len(image))
    check = _crc32(image, place - base)
    _CHECK.pack_into(sealed, offset + _SIZE_AT, len(image))
    _CHECK.pack_into(sealed, offset + _CHECK_AT, check)
    return bytes(sealed)


def _find_record(data: bytes) -> Record | None:
    """Return the record of an image, which size and check distinguish from other bytes; None without one.

    Raises ValueError if there are records, and none fits.
    """
    reason = ""
    for at, record in _records(data):
        if not at + _RECORD.size <= record.size_bytes <= len(data):
            reason = reason or f"its record has {record.size_bytes} bytes, the file {len(data)}"
        elif (check := _crc32(data[: record.size_bytes], at)) != record.crc32:
            reason = f"its check is {hexadecimal(record.crc32)}, that of its bytes {hexadecimal(check)}"
        else:
            return record
    if reason:
        raise ValueError(reason)
    return None


def _records(data: bytes) -> Iterator[tuple[int, Record]]:
    at = data.find(MAGIC)
    while at >= 0:
        if at % 4 == 0 and at + _RECORD.size <= len(data):
            yield at, Record.read(data, at)
        at = data.find(MAGIC, at + 1)


def _crc32(data: bytes | bytearray, record_at: int) -> int:
    check_at = record_at + _CHECK_AT
    crc = zlib.crc32(bytes(_CHECK.size), zlib.crc32(data[:check_at]))
    return zlib.crc32(data[check_at + _CHECK.size :], crc)
