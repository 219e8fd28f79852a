"""`edmctl firmware build`: the library that `--controller firmware` uses, or the image of a board."""

import os
import shlex
from pathlib import Path
from typing import Annotated

from edmctl import failures
from edmctl.cli.options import RESULT, command, option
from edmctl.cli.outcome import Outcome

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
    from edmctl.board.board_build import COMPILERS, SUFFIXES
    from edmctl.core.boards import BOARDS, HOST
    from edmctl.core.build import REALS

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
        _build_library(outcome, real, compiler)
        return
    if real is not None:
        raise failures.real_with_board()
    place = output or Path(f"edmctl-{board}.elf")
    if place.is_dir():
        place /= f"edmctl-{board}.elf"
    if place.suffix not in ("", *SUFFIXES):
        raise failures.image_ending_unknown(place=place, suffixes=", ".join(SUFFIXES))
    _build_image(outcome, str(board), place, compiler, settings or [])


def _build_image(
    outcome: Outcome, board: str, place: Path, compiler: str | None, settings: list[str]
) -> None:
    from edmctl.board.board_build import build_board
    from edmctl.board.commands.tables import render_image
    from edmctl.core.boards import BOARDS

    made = build_board(BOARDS[board], place, compiler, settings=settings)
    files = {"elf": str(made.elf), "bin": str(made.bin)}
    outcome.result = {**made.image.as_mapping(), "files": files, "compiler": made.compiler}
    outcome.show(lambda style: render_image(made.image, style))
    outcome.text = f"\nBuilt by {made.compiler}: {', '.join(files.values())}"


def _build_library(outcome: Outcome, real: str | None, compiler: str | None) -> None:
    from dataclasses import asdict

    from edmctl.core.build import REALS, ZIG, built

    named = {None: {}, "zig": {"CC": shlex.join(ZIG)}, "gcc": {"CC": "gcc"}}[compiler]
    builds = [built(kind, {**os.environ, **named}) for kind in REALS if real in (None, kind)]
    outcome.result = {"builds": [{**asdict(made), "path": str(made.path)} for made in builds]}
    outcome.text = "\n".join(
        f"{made.real}: {made.path}, {'built now' if made.is_new else 'built before'} by {made.compiler}"
        for made in builds
    )
