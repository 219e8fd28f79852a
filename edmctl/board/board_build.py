"""Builds the image of a board with zig, which the package ziglang brings, or with a GCC for ARM."""

from __future__ import annotations

import importlib.util
import shutil
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from edmctl import failures
from edmctl.board.image import Image, read_image, seal
from edmctl.board.settings import flags_of, parse_settings, settings_of
from edmctl.core.boards import Board
from edmctl.core.build import CompilerFailed, files_in, run_compiler, source_folder, version_of
from edmctl.dataclasses import dataclass
from edmctl.errors import PreconditionError, installing

ENTRY = "reset_handler"
COMPILERS = ("zig", "gcc")
SUFFIXES = (".elf", ".bin")
"""Files that a build writes."""
_GCC = "arm-none-eabi-gcc"
_FLAGS = (
    "-std=c11",
    "-O2",
    "-g",
    "-ffreestanding",
    "-fno-builtin",
    "-ffp-contract=off",
    "-fno-math-errno",
    "-ffunction-sections",
    "-fdata-sections",
    "-fno-unwind-tables",
    "-fno-asynchronous-unwind-tables",
)


@dataclass(frozen=True, slots=True)
class Toolchain:
    """A compiler for a board: its command, flags of each file, and what is linked last."""

    command: tuple[str, ...]
    flags: tuple[str, ...]
    libraries: tuple[str, ...]

    def linking(self, script: Path) -> tuple[str, ...]:
        """Return the flags of linking; zig takes its entry only from here."""
        return ("-Wl,--gc-sections", f"-Wl,-e,{ENTRY}", "-T", str(script))


@dataclass(frozen=True, slots=True)
class BoardBuild:
    """An image that was built, its files, and the compiler with its version."""

    image: Image
    elf: Path
    bin: Path
    compiler: str


def build_board(
    board: Board,
    output: Path,
    compiler: str | None = None,
    sources: Path | None = None,
    settings: Sequence[str] = (),
) -> BoardBuild:
    """Build the image of a board as ELF and BIN, whichever of the two `output` names.

    compiler : one of COMPILERS; by default zig if it is installed, else GCC.
    sources : folder of the firmware, if not that of this program. settings : NAME=VALUE of `settings.py`.

    Raises UsageError E2094 for a setting; PreconditionError: E8093 without that compiler, E8094 if the build fails;
    RunFileError E9012 if a file cannot be written.
    """
    folder, tools = sources or source_folder(), toolchain(board, compiler)
    version = f"{' '.join(tools.command)} ({version_of(tools.command)})"
    script = folder / board.script
    if not script.is_file():
        raise failures.image_not_built(reason=f"the sources of {board.title} are missing ({script}).")
    known = settings_of(folder)
    flags = flags_of(parse_settings(settings, known), known)
    stem = output.with_suffix("") if output.suffix in SUFFIXES else output
    elf, binary = (Path(f"{stem}{suffix}") for suffix in SUFFIXES)
    try:
        stem.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix="edmctl-firmware-") as work:
            linked = Path(work) / "image.elf"
            files = map(str, sources_of(board, folder))
            compiling = [*tools.command, *tools.flags, *flags, *tools.linking(script)]
            try:
                run_compiler([*compiling, *files, *tools.libraries, "-o", str(linked)])
                sealed = seal(linked.read_bytes())
            except CompilerFailed as error:
                raise failures.image_not_built(reason=error) from error
            except ValueError as error:
                raise failures.image_not_built(reason=f"what was linked is not an image: {error}.") from error
        elf.write_bytes(sealed)
        image = read_image(elf)
        binary.write_bytes(image.data)
    except OSError as error:
        what, remedy = error.filename or elf, "Name a file in a folder that can be written with --output."
        raise failures.output_not_written(what=what, why=error.strerror, remedy=remedy) from error
    return BoardBuild(image, elf, binary, version)


def toolchain(board: Board, named: str | None) -> Toolchain:
    """Return a compiler of COMPILERS for a board, without a name the first that is installed.

    A broken zig is passed over for an installed GCC unless it was named. Raises PreconditionError E8093.
    """
    gcc = shutil.which(_GCC) if named in (None, "gcc") else None
    if named in (None, "zig") and importlib.util.find_spec("ziglang") is not None:
        zig = (sys.executable, "-m", "ziglang", "cc")
        try:
            version_of(zig)
        except PreconditionError as broken:
            if gcc is None:
                again = installing("--force-reinstall", "ziglang")
                raise failures.zig_does_not_run(problem=broken.message, install=again) from broken
        else:
            return Toolchain(zig, (*board.zig, *_FLAGS), ())
    if gcc is not None:
        return Toolchain((gcc,), (*board.gcc, *_FLAGS), ("-lgcc",))
    names = {"zig": "the package ziglang", "gcc": _GCC}
    missing = names[named] if named else " and ".join(names.values())
    raise failures.board_compiler_missing(missing=missing, install=installing("ziglang"))


def sources_of(board: Board, folder: Path) -> list[Path]:
    """Return the files of an image in the folder of the firmware."""
    return [file for part in board.folders for file in files_in(folder / part, "*.c")]
