"""Images in files: what they are is read of each kind, and one that is not whole is told."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from edmctl.board.image import read_image
from edmctl.board.image_formats import hex_of, parse_hex
from edmctl.errors import RecordError
from edmctl.link.messages import SCHEMA_HASH
from tests.firmware.image_bytes import FLASH_AT, RECORD_AT, image_bytes

if TYPE_CHECKING:
    from pathlib import Path


def refused(path: Path) -> str:
    with pytest.raises(RecordError) as caught:
        read_image(path, SCHEMA_HASH)
    return caught.value.code


def test_a_binary_tells_what_it_is(tmp_path: Path) -> None:
    file = tmp_path / "image.bin"
    file.write_bytes(image_bytes(firmware=(1, 2, 3), protocol=(1, 4), schema_hash=7))
    image = read_image(file, SCHEMA_HASH)
    facts = image.facts
    assert (facts.kind, facts.board_name, facts.firmware, facts.protocol) == (
        "BIN",
        "NUCLEO-F429ZI",
        (1, 2, 3),
        (1, 4),
    )
    assert (facts.size_bytes, facts.schema_hash, facts.has_same_schema) == (4099, 7, False)
    assert image.address == FLASH_AT


def test_hex_is_the_same_image(tmp_path: Path) -> None:
    data = image_bytes(size=70_000)  # beyond 64 KB a line of its own tells the upper half of the address
    file = tmp_path / "image.hex"
    file.write_text(hex_of(FLASH_AT, data))
    assert read_image(file, SCHEMA_HASH).data == data


def test_a_known_line_of_intel_hex() -> None:
    known = ":10010000214601360121470136007EFE09D2190140\n:00000001FF\n"
    address, data = parse_hex(known)
    assert (address, len(data), data[0]) == (0x100, 16, 0x21)
    assert hex_of(address, data).splitlines()[1:] == known.splitlines()


@pytest.mark.parametrize(
    "at", [0, 5, RECORD_AT - 1, RECORD_AT + 8, RECORD_AT + 12, RECORD_AT + 16, RECORD_AT + 21, 4098]
)
def test_every_changed_bit_is_damage(tmp_path: Path, at: int) -> None:
    data = bytearray(image_bytes())
    for bit in range(8):
        data[at] ^= 1 << bit
        file = tmp_path / "image.bin"
        file.write_bytes(data)
        assert refused(file) == "E3682"
        data[at] ^= 1 << bit


def test_an_image_that_is_cut_off_is_damage(tmp_path: Path) -> None:
    file = tmp_path / "image.bin"
    file.write_bytes(image_bytes()[:-1])
    assert refused(file) == "E3682"


def test_bytes_behind_the_image_are_not_its_own(tmp_path: Path) -> None:
    file = tmp_path / "flash.bin"
    file.write_bytes(image_bytes() + b"\xff" * 1000)
    assert read_image(file, SCHEMA_HASH).data == image_bytes()


def test_bytes_that_look_like_a_record_are_passed_over(tmp_path: Path) -> None:
    import struct
    import zlib

    data = bytearray(image_bytes())
    data[0x100:0x104] = b"EDMI"
    data[RECORD_AT + 20 : RECORD_AT + 24] = bytes(4)
    data[RECORD_AT + 20 : RECORD_AT + 24] = struct.pack("<I", zlib.crc32(data))
    file = tmp_path / "image.bin"
    file.write_bytes(data)
    assert read_image(file, SCHEMA_HASH).facts.board == 0x0429


def test_what_is_no_image_of_this_firmware(tmp_path: Path) -> None:
    file = tmp_path / "other.bin"
    file.write_bytes(bytes(range(256)) * 20)
    assert refused(file) == "E3681"
    assert refused(tmp_path / "none.bin") == "E3680"
    assert refused(tmp_path) == "E3680"
    file.write_bytes(b"\x7fELF" + bytes(10))
    assert refused(file) == "E3682"
    file.write_text(":10010000214601360121470136007EFE09D2190141\n:00000001FF\n")
    assert refused(file) == "E3682"
    file.write_text(hex_of(0x0800_4000, image_bytes()))
    assert refused(file) == "E3682"


ELF_OF_A_PC = b"\x7fELF\x02\x01\x01" + bytes(9) + b"\x03\x00\x3e\x00" + bytes(200)
ELF_OF_ARM = b"\x7fELF\x01\x01\x01" + bytes(9) + b"\x02\x00\x28\x00" + b"\xff" * 32
HEX = hex_of(FLASH_AT, image_bytes())


@pytest.mark.parametrize(
    ("content", "code", "told"),
    [
        (ELF_OF_A_PC, "E3681", "is no image of this firmware: it is no program for a 32-bit ARM."),
        (ELF_OF_ARM[:30], "E3682", "is damaged: it is cut off"),
        (ELF_OF_ARM, "E3682", "is damaged: it is cut off, or its tables point beyond its end."),
        (HEX.replace("4", "x", 1).encode(), "E3682", "is damaged: line 1 is damaged."),
        (HEX.replace("0", "é", 9).encode(), "E3682", "goes on as something else."),
        (HEX[:-20].encode(), "E3682", "is damaged: line"),
    ],
)
def test_damage_is_told_in_plain_words(content: bytes, code: str, told: str, tmp_path: Path) -> None:
    file = tmp_path / "image"
    file.write_bytes(content)
    with pytest.raises(RecordError) as caught:
        read_image(file, SCHEMA_HASH)
    assert caught.value.code == code
    assert told in caught.value.message
    for word in ("unpack", "fromhex", "codec", "buffer", "index"):
        assert word not in caught.value.message
