"""Images of a board as they stand in a file, put together without the code that reads them."""

from __future__ import annotations

import struct
import zlib

from edmctl.link.messages import PROTO_MAJOR, PROTO_MINOR, SCHEMA_HASH

STM32F4 = 0x0429
RECORD_AT = 0x200
FLASH_AT = 0x0800_0000


def image_bytes(
    *,
    board: int = STM32F4,
    protocol: tuple[int, int] = (PROTO_MAJOR, PROTO_MINOR),
    schema_hash: int = SCHEMA_HASH,
    firmware: tuple[int, int, int] = (1, 0, 0),
    size: int = 4099,
    settings: str = "",
) -> bytes:
    """Return an image: vectors, code of some kind, the record and its check."""
    content = bytearray((7 * n + n // 251) & 0xFF for n in range(size))
    head = struct.pack("<4sBBHI3sx", b"EDMI", *protocol, board, schema_hash, bytes(firmware))
    content[RECORD_AT : RECORD_AT + len(head) + 8] = head + struct.pack("<II", size, 0)
    if settings:
        told = f"EDMS{settings}\0".encode()
        content[0x300 : 0x300 + len(told)] = told
    check = zlib.crc32(content)
    content[RECORD_AT + len(head) + 4 : RECORD_AT + len(head) + 8] = struct.pack("<I", check)
    return bytes(content)
