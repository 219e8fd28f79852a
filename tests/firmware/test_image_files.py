"""Images in files: each kind is read, and one that is not whole is refused."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import pytest

from edmctl.board.image import read_image
from edmctl.errors import RecordError
from tests.firmware.image_bytes import RECORD_AT, image_bytes


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "image.bin"


def refused(file: Path) -> str:
    with pytest.raises(RecordError) as caught:
        read_image(file)
    return caught.value.code


def test_a_binary_is_read(file: Path) -> None:
    file.write_bytes(image_bytes(firmware=(1, 2, 3), protocol=(1, 4), schema_hash=7))
    image = read_image(file)
    record = image.record
    assert (image.kind, image.board_name, image.has_same_schema) == ("BIN", "NUCLEO-F429ZI", False)
    assert (record.firmware, record.protocol, record.schema_hash) == ((1, 2, 3), (1, 4), 7)
    assert record.size_bytes == len(image.data) == 4099


@pytest.mark.parametrize(
    "at", [0, 5, RECORD_AT - 1, RECORD_AT + 8, RECORD_AT + 12, RECORD_AT + 16, RECORD_AT + 21, 4098]
)
def test_every_changed_bit_is_damage(file: Path, at: int) -> None:
    data = bytearray(image_bytes())
    for bit in range(8):
        data[at] ^= 1 << bit
        file.write_bytes(data)
        assert refused(file) == "E3682"
        data[at] ^= 1 << bit


def test_bytes_behind_the_image_are_not_its_own(file: Path) -> None:
    file.write_bytes(image_bytes() + b"\xff" * 1000)
    assert read_image(file).data == image_bytes()


def test_bytes_that_look_like_a_record_are_passed_over(file: Path) -> None:
    data = bytearray(image_bytes())
    data[0x100:0x104] = b"EDMI"
    data[RECORD_AT + 20 : RECORD_AT + 24] = bytes(4)
    data[RECORD_AT + 20 : RECORD_AT + 24] = struct.pack("<I", zlib.crc32(data))
    file.write_bytes(data)
    assert read_image(file).record.board == 0x0429


ELF_OF_A_PC = b"\x7fELF\x02\x01\x01" + bytes(9) + b"\x03\x00\x3e\x00" + bytes(200)
ELF_OF_ARM = b"\x7fELF\x01\x01\x01" + bytes(9) + b"\x02\x00\x28\x00" + b"\xff" * 32


@pytest.mark.parametrize(
    ("content", "code", "message"),
    [
        (bytes(range(256)) * 20, "E3681", "it contains no record of one."),
        (b":10010000214601360121470136007EFE09D2190140\n", "E3681", "it contains no record of one."),
        (ELF_OF_A_PC, "E3681", "is no image of this firmware: it is not a program for a 32-bit ARM."),
        (image_bytes()[:-1], "E3682", "its record has 4099 bytes, the file 4098"),
        (b"\x7fELF" + bytes(10), "E3682", "is damaged: it is cut off"),
        (ELF_OF_ARM[:30], "E3682", "is damaged: it is cut off"),
        (ELF_OF_ARM, "E3682", "is damaged: it is cut off, or its tables point beyond its end."),
    ],
)
def test_damage_is_described_in_plain_words(content: bytes, code: str, message: str, file: Path) -> None:
    file.write_bytes(content)
    with pytest.raises(RecordError) as caught:
        read_image(file)
    assert caught.value.code == code
    assert message in caught.value.message
    assert not any(word in caught.value.message for word in ("unpack", "codec", "buffer", "index"))


def test_what_cannot_be_read_is_refused(tmp_path: Path) -> None:
    assert refused(tmp_path / "none.bin") == refused(tmp_path) == "E3680"
