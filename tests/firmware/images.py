"""Images of the STM32F4 board by either compiler, and what stands in them."""

from __future__ import annotations

import importlib.util
import shutil
import struct
import subprocess
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING

import pytest

from edmctl.firmware.build import source_folder

if TYPE_CHECKING:
    from pathlib import Path

COMPILERS = ("zig", "gcc")
WARNINGS = ("-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Wdouble-promotion", "-Werror")
_FLAGS = (
    "-std=c11",
    "-O2",
    "-ffreestanding",
    "-fno-builtin",
    "-ffp-contract=off",
    "-fno-math-errno",
    "-ffunction-sections",
    "-fdata-sections",
    "-fno-unwind-tables",
    "-fno-asynchronous-unwind-tables",
)
_GCC = ("-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard", "-nostdlib")
_ZIG = ("-target", "thumb-freestanding-eabihf", "-mcpu=cortex_m4+vfp4d16sp")
_SECONDS = 300


def compile_command(name: str) -> list[str]:
    """Command of a compiler with all its flags; the test is skipped where it is missing."""
    if name == "gcc":
        path = shutil.which("arm-none-eabi-gcc")
        if path is None:
            pytest.skip("no arm-none-eabi-gcc")
        return [path, *_GCC, *_FLAGS]
    if importlib.util.find_spec("ziglang") is None:
        pytest.skip("the package ziglang is not installed")
    return [sys.executable, "-m", "ziglang", "cc", *_ZIG, *_FLAGS]


def sources() -> list[Path]:
    folder = source_folder()
    return [
        path
        for part in ("core", "gen", "board", "board/stm32f4")
        for path in sorted((folder / part).glob("*.c"))
    ]


def built(name: str, folder: Path, *flags: str) -> Path:
    """Build the image and return the path of its ELF file. A warning is an error."""
    script = source_folder() / "board" / "stm32f4" / "f429.ld"
    link = [f"-Wl,-T,{script}", "-Wl,--gc-sections", "-Wl,-e,reset_handler"]
    libraries = ["-lgcc"] if name == "gcc" else []
    path = folder / f"f429-{name}.elf"
    command = [*compile_command(name), *WARNINGS, *flags, *map(str, sources()), *link, *libraries, "-o", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=_SECONDS, check=False, cwd=folder)
    assert (done.returncode, done.stderr) == (0, "")
    return path


@dataclass(frozen=True)
class Section:
    """Part of an image. loaded : it has bytes in the flash."""

    address: int
    content: bytes
    size: int
    loaded: bool


class Elf:
    """Sections and symbols of a 32-bit little-endian ELF file."""

    def __init__(self, path: Path) -> None:
        data = path.read_bytes()
        assert data[:7] == b"\x7fELF\x01\x01\x01"
        self.entry = struct.unpack_from("<I", data, 24)[0]
        at = struct.unpack_from("<I", data, 32)[0]
        size, count, names = struct.unpack_from("<HHH", data, 46)
        headers = [struct.unpack_from("<10I", data, at + size * i) for i in range(count)]
        self.sections: dict[str, Section] = {}
        self.symbols: dict[str, int] = {}

        def text(table: int, offset: int) -> str:
            begin = headers[table][4] + offset
            return data[begin : data.index(b"\0", begin)].decode()

        for name, kind, flags, address, offset, length, link, *_ in headers:
            if flags & 2:
                content = data[offset : offset + length] if kind != 8 else b""
                self.sections[text(names, name)] = Section(address, content, length, kind != 8)
            if kind == 2:
                for symbol in range(offset, offset + length, 16):
                    label, value = struct.unpack_from("<II", data, symbol)
                    if label:
                        self.symbols[text(link, label)] = value

    def words(self, address: int, count: int) -> tuple[int, ...]:
        for section in self.sections.values():
            if section.loaded and section.address <= address < section.address + section.size:
                return struct.unpack_from(f"<{count}I", section.content, address - section.address)
        raise AssertionError(f"nothing at {address:#x}")

    def bytes_in(self, begin: int, end: int, *, loaded: bool | None = None) -> int:
        """Bytes of all sections in a range of addresses."""
        return sum(
            section.size
            for section in self.sections.values()
            if begin <= section.address < end and loaded in (None, section.loaded)
        )
