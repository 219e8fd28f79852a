"""`edmctl firmware`: build it for virtual machines and boards, inspect images and boards, flash."""

import os
import shlex
import stat
import sys
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

from edmctl import failures
from edmctl.cli import completion
from edmctl.cli.options import (
    NOTES,
    RESULT,
    SetupOption,
    WaitOption,
    argument,
    command,
    command_group,
    option,
)
from edmctl.cli.outcome import Outcome, Output, mutter, tell
from edmctl.cli.signals import shell
from edmctl.files import user_path
from edmctl.wording import dotted

if TYPE_CHECKING:
    from edmctl.board.board_firmware import BoardFacts
    from edmctl.board.image import Image
    from edmctl.core.boards import Board

BoardOption = Annotated[
    str | None,
    option(
        "--board host|stm32f4",
        "What to build for: this computer's virtual machines, or a board. Default: host.",
    ),
]
CompilerOption = Annotated[
    str | None,
    option(
        "--compiler zig|gcc",
        "Default: zig (the package ziglang), else arm-none-eabi-gcc; of the host CC, the system's, or zig.",
    ),
]
OutputOption = Annotated[
    Path | None, option("--output -o FILE|FOLDER", "ELF, with BIN beside it. Default: edmctl-BOARD.elf.")
]
RealOption = Annotated[
    str | None, option("--real double|float", "Arithmetic of the library of the host. Default: both.")
]
SetOption = Annotated[
    list[str] | None,
    option("--set NAME=VALUE", "Of a board: a range, step or limit of your machine. May be repeated."),
]
WhatArgument = Annotated[
    str,
    argument("FILE|PORT", "An image (ELF or BIN), or the port of a board.", autocompletion=completion.ports),
]
ImageArgument: TypeAlias = Annotated[Path, argument("FILE", "Image of a board: ELF or BIN.")]
ToolOption = Annotated[
    str | None, option("--tool pyocd|openocd", "Default: the first of them that is installed.")
]
ProbeOption = Annotated[str | None, option("--probe ID", "Serial number of the ST-LINK.")]
FlashPortOption = Annotated[
    str | None,
    option(
        "--port PORT",
        "Where the board is asked whether a job runs, and afterwards who it is.",
        autocompletion=completion.ports,
        show_default=False,
    ),
]
OffOption = Annotated[
    bool, option("--yes-high-voltage-is-off", "Do not ask whether the high voltage is off: it is.")
]
_ANSWER = "off"

app = command_group("Build the firmware, look at it and flash it.")


@app.command()
@command("firmware build", RESULT)
def build(
    outcome: Outcome,
    board: BoardOption = None,
    compiler: CompilerOption = None,
    output: OutputOption = None,
    real: RealOption = None,
    settings: SetOption = None,
) -> None:
    """Build the image of a board, or the firmware's core as a library for virtual machines.

    The image is written as ELF and BIN, with its size and a check inside. The package ziglang includes all that is
    needed. --set gives the ranges of your circuits, as in --set gap_full_v=331.2; the image states them.

    The library is built if it is missing, with the C compiler in CC, the system's, or that of the package ziglang.
    It is kept in the user's cache folder or in EDMCTL_FIRMWARE_CACHE. Jobs build by themselves what they need.
    """
    from dataclasses import asdict

    from edmctl.board.board_build import COMPILERS, SUFFIXES, build_board
    from edmctl.core.boards import BOARDS, HOST
    from edmctl.core.build import REALS, ZIG, built

    if board not in (None, HOST, *BOARDS):
        raise failures.board_unknown(board=board, boards=", ".join((HOST, *BOARDS)))
    if compiler not in (None, *COMPILERS):
        raise failures.compiler_unknown(compiler=compiler, compilers=" or ".join(COMPILERS))
    if real is not None and real not in REALS:
        raise failures.arithmetic_unknown(real=real, reals=" or ".join(REALS))
    if board in (None, HOST):
        if output is not None:
            raise failures.output_without_board()
        if settings:
            raise failures.setting_without_board()
        named = {None: {}, "zig": {"CC": shlex.join(ZIG)}, "gcc": {"CC": "gcc"}}[compiler]
        builds = [built(kind, {**os.environ, **named}) for kind in REALS if real in (None, kind)]
        outcome.result = {"builds": [{**asdict(library), "path": str(library.path)} for library in builds]}
        outcome.text = "\n".join(
            f"{library.real}: {library.path}, {'built now' if library.is_new else 'built before'} by "
            f"{library.compiler}"
            for library in builds
        )
        return
    if real is not None:
        raise failures.real_with_board()
    place = output or Path(f"edmctl-{board}.elf")
    if place.is_dir():
        place /= f"edmctl-{board}.elf"
    if place.suffix not in ("", *SUFFIXES):
        raise failures.image_ending_unknown(place=place, suffixes=", ".join(SUFFIXES))
    made = build_board(BOARDS[str(board)], place, compiler, settings=settings or [])
    files = {"elf": str(made.elf), "bin": str(made.bin)}
    outcome.result = {**made.image.as_mapping(), "files": files, "compiler": made.compiler}
    outcome.text = f"{render_image(made.image)}\n\nBuilt by {made.compiler}: {', '.join(files.values())}"


@app.command()
@command("firmware info", NOTES)
def info(outcome: Outcome, what: WhatArgument, setup: SetupOption = None, wait: WaitOption = 0.0) -> None:
    """Show what an image contains, or what runs on a board.

    No session is opened, so a job on the board continues.
    """
    from edmctl.board.board_firmware import board_at, image_warnings
    from edmctl.board.image import read_image
    from edmctl.profile.setup import load_setup

    if _is_file(what):
        image = read_image(user_path(what))
        outcome.warn(image_warnings(image))
        outcome.result = {"image": image.as_mapping(), "board": None}
        outcome.text = render_image(image)
        return
    board = board_at(what, load_setup(setup), wait, partial(tell, outcome.output), shell().environ)
    outcome.simulated = None if board.board is None else board.board == 0
    outcome.result = {"image": None, "board": board.as_mapping()}
    outcome.text = render_board(board)


def _is_file(what: str) -> bool:
    """Return whether it is an image: an existing file, or a name with the ending of one."""
    if "://" in what:
        return False
    with suppress(OSError, ValueError):
        return not stat.S_ISCHR(user_path(what).stat().st_mode)
    return user_path(what).suffix.lower() in (".elf", ".bin")


@app.command()
@command("firmware flash", NOTES)
def flash(
    outcome: Outcome,
    image: ImageArgument,
    tool: ToolOption = None,
    probe: ProbeOption = None,
    port: FlashPortOption = None,
    high_voltage_is_off: OffOption = False,
    setup: SetupOption = None,
    wait: WaitOption = 0.0,
) -> None:
    """Flash a board, read it back, and start it.

    The high voltage has to be off: a board that is flashed guards nothing. With --port a job that runs there is
    refused, the port is held meanwhile, and the board is asked afterwards who it is.
    """
    from edmctl.board.board_firmware import Flashing, flash_board, image_warnings
    from edmctl.board.image import read_image
    from edmctl.board.settings import settings_text
    from edmctl.profile.setup import load_setup

    read = read_image(image)
    outcome.warn(image_warnings(read))
    settings = f"Settings of the image: {settings_text(read.settings)}.\n"
    job = Flashing(read, tool, probe, port, wait)
    confirm = partial(_confirm, outcome.output, settings, is_off=high_voltage_is_off)
    try:
        flash_board(job, load_setup(setup), partial(tell, outcome.output), shell().environ, confirm)
    finally:
        outcome.result = job.as_mapping()
        if job.tool is not None:
            size = len(read.data)
            outcome.text = (
                f"{settings}{read.board_name}: {size} bytes written by {job.tool}, read back; started."
            )
        if job.after is not None:
            serial = f" ({job.after.serial})" if job.after.serial else ""
            outcome.text += f"\nThe board at {job.after.port}{serial} answers."


def _confirm(output: Output, settings: str, board: "Board", *, is_off: bool) -> None:
    """Ask whether the high voltage is off. Raises PreconditionError E8124 if it is not."""
    if is_off:
        return
    if output.json or not (sys.stdin is not None and sys.stdin.isatty() and sys.stderr.isatty()):
        raise failures.high_voltage_unconfirmed()
    mutter(
        f"While {board.title} is flashed nothing guards the machine, and its outputs float.\n{settings}"
        f"Is the high voltage off, by its switch and by its meter? Type `{_ANSWER}` to flash: "
    )
    if sys.stdin.readline().strip() != _ANSWER:
        raise failures.high_voltage_on()


def render_image(image: "Image") -> str:
    """Render what an image is, and of an ELF the memory that it takes."""
    from edmctl.board.image import hexadecimal
    from edmctl.board.settings import settings_text

    record, used = image.record, image.used_bytes()
    rows = [
        ("image", f"{image.path} ({image.kind}), whole"),
        ("board", f"{image.board_name} (board {record.board})"),
        ("firmware", dotted(record.firmware)),
        ("protocol", dotted(record.protocol)),
        ("schema", _schema(record.schema_hash, is_same=image.has_same_schema)),
        ("size", f"{record.size_bytes} bytes"),
        ("CRC-32", hexadecimal(record.crc32)),
        ("settings", settings_text(image.settings)),
    ]
    if used:
        rows.append(("memory", ", ".join(f"{memory} {size} bytes" for memory, size in used.items())))
    return _pairs(rows)


def render_board(board: "BoardFacts") -> str:
    """Render what a controller reports."""
    unknown = "not reported"
    rows = [
        ("port", board.port),
        ("controller", board.serial or unknown),
        ("board", unknown if board.board is None else f"{board.board_name} (board {board.board})"),
        ("firmware", dotted(board.firmware) if board.firmware else unknown),
        ("protocol", dotted(board.protocol)),
        ("schema", _schema(board.schema, is_same=board.has_same_schema)),
    ]
    if board.differing:
        rows.append(("differing", ", ".join(board.differing)))
    if board.state is not None:
        fault = f", fault {board.fault} is latched" if board.fault else ""
        rows.append(("state", f"{board.state}{fault}"))
    if board.boot_count is not None:
        rows.append(("boots", str(board.boot_count)))
    return _pairs(rows)


def _schema(number: int, *, is_same: bool) -> str:
    from edmctl.board.image import hexadecimal

    return f"{hexadecimal(number)}, {'that' if is_same else 'not that'} of this edmctl"


def _pairs(rows: list[tuple[str, str]]) -> str:
    width = max(len(name) for name, _ in rows)
    return "\n".join(f"{name:{width}}  {text}" for name, text in rows)
