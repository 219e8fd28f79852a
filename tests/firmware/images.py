"""Images of the STM32F4 board by either compiler, and what stands in them."""

from __future__ import annotations

import struct
import subprocess
from pathlib import Path

from edmctl.board.board_build import sources_of, toolchain
from edmctl.board.image import Elf, Section, seal
from edmctl.core.boards import STM32F4
from edmctl.core.build import source_folder

WARNINGS = ("-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Wdouble-promotion", "-Werror")
_SECONDS = 300


def compile_command(name: str) -> list[str]:
    """Command of a compiler with all its flags, as `edmctl firmware build` has it."""
    tools = toolchain(STM32F4, name)
    return [*tools.command, *tools.flags]


def sources() -> list[Path]:
    return sources_of(STM32F4, source_folder())


def built(name: str, folder: Path, *flags: str) -> Path:
    """Build the image and return the path of its ELF file. A warning is an error."""
    tools, script = toolchain(STM32F4, name), source_folder() / STM32F4.script
    path = folder / f"f429-{name}.elf"
    end = [*map(str, sources()), *tools.linking(script), *tools.libraries, "-o", str(path)]
    command = [*compile_command(name), *WARNINGS, *flags, *end]
    done = subprocess.run(command, capture_output=True, text=True, timeout=_SECONDS, check=False, cwd=folder)
    assert (done.returncode, done.stderr) == (0, "")
    path.write_bytes(seal(path.read_bytes()))
    return path


class BuiltElf(Elf):
    """An image with the addresses of its symbols in `at`."""

    def __init__(self, path: Path) -> None:
        super().__init__(path.read_bytes())
        self.at = {name: address for name, (address, _) in self.symbols.items()}

    def section(self, name: str) -> Section:
        return next(section for section in self.sections if section.name == name)

    def words(self, address: int, count: int) -> tuple[int, ...]:
        """Return words of the flash."""
        base, data = self.image()
        return struct.unpack_from(f"<{count}I", data, address - base)

    def bytes_in(self, begin: int, end: int, *, loaded: bool | None = None) -> int:
        """Return the bytes of all sections in a range of addresses."""
        return sum(
            s.size_bytes
            for s in self.sections
            if s.is_allocated and begin <= s.address < end and loaded in (None, s.has_bytes)
        )
