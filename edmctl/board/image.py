"""Images of a board's firmware: the record that says what one is, and whether it is whole.

Every image holds `edm_image`. Size and check are filled in when it is built: the CRC-32 is that of all bytes of the
image, with the four of the check itself as zeros.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

from edmctl import failures
from edmctl.board.image_formats import Elf, ForeignElf, parse_hex
from edmctl.board.results import ImageFacts, Section
from edmctl.board.settings import told_settings
from edmctl.core.boards import Board, board_name, board_of
from edmctl.dataclasses import dataclass
from edmctl.errors import RecordError
from edmctl.files import read_bytes

SYMBOL = "edm_image"
MAGIC = b"EDMI"
MOST_BYTES = 16_000_000
"""Of a file; an ELF with all that a debugger asks for has less than 2 MB."""
_RECORD = struct.Struct("<4sBBHIBBBxII")
_CHECK = struct.Struct("<I")
_CHECK_AT = _RECORD.size - _CHECK.size
_SIZE_AT = _CHECK_AT - _CHECK.size


@dataclass(frozen=True, slots=True)
class Record:
    """`edm_image` as the board's C has it."""

    protocol: tuple[int, int]
    board: int
    schema_hash: int
    firmware: tuple[int, int, int]
    size: int
    crc32: int

    @classmethod
    def read(cls, data: bytes, at: int) -> Record:
        """Return the record at an offset. Raises struct.error, ValueError for none."""
        magic, proto_major, proto_minor, board, schema, major, minor, patch, size, check = (
            _RECORD.unpack_from(data, at)
        )
        if magic != MAGIC:
            raise ValueError("no record")
        return cls((proto_major, proto_minor), board, schema, (major, minor, patch), size, check)


@dataclass(frozen=True, slots=True)
class Image:
    """An image that is whole: what it is, the board that it is for, and its bytes as they stand in the flash."""

    facts: ImageFacts
    board: Board | None
    address: int
    data: bytes


def read_image(path: Path, schema_hash: int) -> Image:
    """Read an image from an ELF, HEX or BIN; `schema_hash` is that of this program.

    Raises RecordError: E3680 for what cannot be read, E3681 for no image of this firmware, E3682 for a damaged one.
    """
    try:
        content = read_bytes(path, MOST_BYTES)
    except OSError as error:
        raise failures.image_unreadable(path=path, reason=error.strerror) from error
    elf: Elf | None = None
    try:
        if content.startswith(b"\x7fELF"):
            kind, elf = "ELF", Elf(content)
            address, data = elf.image()
        elif content.startswith(b":"):
            kind, (address, data) = "HEX", parse_hex(content.decode("ascii"))
        else:
            kind, address, data = "BIN", 0, content
    except ForeignElf as error:
        raise _no_image(path, str(error)) from error
    except UnicodeDecodeError as error:
        raise _damaged(path, "it begins as Intel HEX and goes on as something else") from error
    except ValueError as error:
        raise _damaged(path, str(error)) from error
    record = _record(path, data)
    board = board_of(record.board)
    if board is not None:
        _check_place(path, board, kind, address, data)
        address = board.flash.address
    facts = ImageFacts(
        path=str(path),
        kind=kind,
        board=record.board,
        board_name=board_name(record.board),
        protocol=record.protocol,
        firmware=record.firmware,
        schema_hash=record.schema_hash,
        size_bytes=record.size,
        crc32=record.crc32,
        sections=_sections(elf, board) if elf is not None and board is not None else (),
        has_same_schema=record.schema_hash == schema_hash,
        settings=told_settings(data[: record.size]),
    )
    return Image(facts, board, address, data[: record.size])


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


def _record(path: Path, data: bytes) -> Record:
    """Return the record in an image; size and check distinguish it from other bytes."""
    reason = ""
    for at, record in _records(data):
        if not at + _RECORD.size <= record.size <= len(data):
            reason = reason or f"its record speaks of {record.size} bytes, and {len(data)} are there"
        elif (found := _crc32(data[: record.size], at)) != record.crc32:
            reason = f"its check is 0x{record.crc32:08X}, that of its bytes 0x{found:08X}"
        else:
            return record
    if reason:
        raise _damaged(path, reason)
    raise _no_image(path, "it holds no record of one")


def _no_image(path: Path, reason: str) -> RecordError:
    return failures.not_an_image(path=path, reason=reason)


def _records(data: bytes) -> Iterator[tuple[int, Record]]:
    at = data.find(MAGIC)
    while at >= 0:
        if at % 4 == 0 and at + _RECORD.size <= len(data):
            yield at, Record.read(data, at)
        at = data.find(MAGIC, at + 1)


def _crc32(data: bytes | bytearray, record_at: int) -> int:
    check_at = record_at + _CHECK_AT
    begun = zlib.crc32(bytes(_CHECK.size), zlib.crc32(data[:check_at]))
    return zlib.crc32(data[check_at + _CHECK.size :], begun)


def _check_place(path: Path, board: Board, kind: str, address: int, data: bytes) -> None:
    if kind != "BIN" and address != board.flash.address:
        raise _damaged(
            path, f"it begins at 0x{address:08X}, the flash of the board at 0x{board.flash.address:08X}"
        )
    if len(data) > board.flash.size_bytes:
        raise _damaged(path, f"its {len(data)} bytes are more than the flash of the board has")


def _damaged(path: Path, reason: str) -> RecordError:
    return failures.image_damaged(path=path, reason=reason)


def _sections(elf: Elf, board: Board) -> tuple[Section, ...]:
    """Return the sections that take memory; initial values take flash too."""
    found = []
    for section in elf.sections:
        if section.is_allocated and section.size:
            places = (section.address, elf.load_address_of(section))
            memories = tuple(dict.fromkeys(board.memory_of(place) or "elsewhere" for place in places))
            found.append(Section(section.name, section.address, section.size, memories))
    return tuple(found)
