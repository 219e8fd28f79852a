"""Builds the image of a board with zig, which the package ziglang brings, or with a GCC for ARM."""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from edmctl import failures
from edmctl.board.image import Image, read_image, seal
from edmctl.board.image_formats import hex_of
from edmctl.board.settings import flags_of, parse_settings, settings_of
from edmctl.core.boards import Board
from edmctl.core.build import complaint, files_in, run_compiler, source_folder, version_of
from edmctl.dataclasses import dataclass
from edmctl.errors import PreconditionError, RunFileError, installing

ENTRY = "reset_handler"
COMPILERS = ("zig", "gcc")
SUFFIXES = (".elf", ".bin", ".hex")
"""Of the files that a build leaves."""
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
_REMEDIES = {
    None: f"Install ziglang: {installing('ziglang')}.",
    "zig": f"Install it: {installing('ziglang')}; or say --compiler gcc.",
    "gcc": "Install it, on Debian and Ubuntu with `sudo apt install gcc-arm-none-eabi`; or say --compiler zig.",
}


@dataclass(frozen=True, slots=True)
class Toolchain:
    """A compiler for a board: its command, how each file is compiled, and what is linked last."""

    command: tuple[str, ...]
    flags: tuple[str, ...]
    libraries: tuple[str, ...]

    def linking(self, script: Path) -> tuple[str, ...]:
        """Return what an image is linked by; zig takes its entry from here alone."""
        return ("-Wl,--gc-sections", f"-Wl,-e,{ENTRY}", "-T", str(script))


@dataclass(frozen=True, slots=True)
class BoardBuild:
    """An image that was built: its files, and what by."""

    image: Image
    elf: Path
    bin: Path
    hex: Path
    compiler: str


def build_board(
    board: Board,
    output: Path,
    schema_hash: int,
    named: str | None = None,
    sources: Path | None = None,
    settings: Sequence[str] = (),
) -> BoardBuild:
    """Build the image of a board as ELF, BIN and HEX, whichever of the three `output` names.

    schema_hash : of this program. named : one of COMPILERS; without, zig where it is installed, else GCC.
    sources : folder of the firmware, if not that of this program. settings : NAME=VALUE of `settings.py`.

    Raises UsageError E2094 for a setting; PreconditionError: E8093 without that compiler, E8094 where no image comes
    of it; RunFileError E9012 where it cannot be written.
    """
    folder = sources or source_folder()
    tools = toolchain(board, named)
    said = f"{' '.join(tools.command)} ({version_of(tools.command)})"
    script = folder / board.script
    if not script.is_file():
        raise _not_built(f"the sources of {board.title} are not there ({script}).")
    known = settings_of(folder)
    flags = flags_of(parse_settings(settings, known), known)
    stem = output.with_suffix("") if output.suffix in SUFFIXES else output
    elf, binary, text = (Path(f"{stem}{suffix}") for suffix in SUFFIXES)
    try:
        stem.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix="edmctl-firmware-") as work:
            linked = Path(work) / "image.elf"
            files = map(str, sources_of(board, folder))
            compiling = [*tools.command, *tools.flags, *flags, *tools.linking(script)]
            _run([*compiling, *files, *tools.libraries, "-o", str(linked)])
            sealed = Path(work) / "sealed.elf"
            try:
                sealed.write_bytes(seal(linked.read_bytes()))
            except ValueError as error:
                raise _not_built(f"what was linked is no image: {error}.") from error
            shutil.copyfile(sealed, elf)
        image = read_image(elf, schema_hash)
        binary.write_bytes(image.data)
        text.write_text(hex_of(image.address, image.data), encoding="ascii")
    except OSError as error:
        raise _not_written(elf, error) from error
    return BoardBuild(image, elf, binary, text, said)


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
                anew = installing("--force-reinstall", "ziglang")
                raise PreconditionError(
                    broken.message, hint=f"Install it anew: {anew}; or say --compiler gcc.", code=broken.code
                ) from broken
        else:
            return Toolchain(zig, (*board.zig, *_FLAGS), ())
    if gcc is not None:
        return Toolchain((gcc,), (*board.gcc, *_FLAGS), ("-lgcc",))
    missing = {"zig": "The package ziglang is not installed", "gcc": f"{_GCC} is not installed"}
    raise failures.board_compiler_missing(
        missing=missing[named] if named else f"Neither the package ziglang nor {_GCC} is installed",
        remedy=_REMEDIES[named],
    )


def sources_of(board: Board, folder: Path) -> list[Path]:
    """Return the files that an image is made of, in the folder of the firmware."""
    return [file for part in board.folders for file in files_in(folder / part, "*.c")]


def _run(command: list[str]) -> None:
    try:
        done = run_compiler(command)
    except (OSError, subprocess.SubprocessError) as error:
        raise _not_built(f"{error}.") from error
    if done.returncode:
        raise _not_built(complaint(done))


def _not_written(elf: Path, error: OSError) -> RunFileError:
    """Return the error E9012 with its cause."""
    why = error.strerror or str(error)
    for place in reversed(elf.parents):
        if place.exists() and not place.is_dir():
            why = f"{place} is no folder"
    for file in (elf.with_suffix(suffix) for suffix in SUFFIXES):
        if file.is_dir():
            why = f"{file} is a folder"
    return failures.image_not_written(elf=elf, why=why)


def _not_built(reason: str) -> PreconditionError:
    return failures.image_not_built(reason=reason)
