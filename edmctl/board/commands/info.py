"""`edmctl firmware info` and `verify`: what an image is, what runs on a board, and whether they are the same."""

import stat
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Annotated, TypeAlias

from edmctl.cli import completion
from edmctl.cli.options import NOTES, SetupOption, WaitOption, argument, command
from edmctl.cli.outcome import Outcome, tell
from edmctl.cli.signals import shell
from edmctl.files import user_path

WhatArgument = Annotated[
    str,
    argument(
        "FILE|PORT",
        "An image (ELF or BIN), or the port of a board.",
        autocompletion=completion.ports,
    ),
]
ImageArgument: TypeAlias = Annotated[Path, argument("FILE", "Image of a board: ELF or BIN.")]
BoardPortArgument: TypeAlias = Annotated[
    str,
    argument(
        "PORT",
        "Where the board is: a serial port, socket://HOST:PORT, serial:ID or auto.",
        autocompletion=completion.ports,
    ),
]


@command("firmware info", NOTES)
def info(outcome: Outcome, what: WhatArgument, setup: SetupOption = None, wait: WaitOption = 0.0) -> None:
    """Show what an image contains, or what runs on a board.

    No session is opened, so a job on the board continues.
    """
    from edmctl.board.board_firmware import board_at, image_warnings
    from edmctl.board.commands.tables import render_board, render_image
    from edmctl.board.image import read_image
    from edmctl.profile.setup import load_setup

    if _is_file(what):
        image = read_image(user_path(what))
        outcome.warn(image_warnings(image))
        outcome.result = {"image": image.as_mapping(), "board": None}
        outcome.show(lambda style: render_image(image, style))
        return
    board = board_at(what, load_setup(setup), wait, partial(tell, outcome.output), shell().environ)
    outcome.simulated = board.is_simulated
    outcome.result = {"image": None, "board": board.as_mapping()}
    outcome.text = render_board(board)


def _is_file(what: str) -> bool:
    """Return whether it is an image: an existing file, or a name with the ending of one."""
    if "://" in what:
        return False
    with suppress(OSError, ValueError):
        return not stat.S_ISCHR(user_path(what).stat().st_mode)
    return user_path(what).suffix.lower() in (".elf", ".bin")


@command("firmware verify", NOTES)
def verify(
    outcome: Outcome,
    image: ImageArgument,
    port: BoardPortArgument,
    setup: SetupOption = None,
    wait: WaitOption = 0.0,
) -> None:
    """Compare board, schema and version of an image with those of a connected board.

    No session is opened, so a job on the board continues. Bytes of the flash and --set values are not compared;
    `edmctl firmware flash` reads the flash back.
    """
    from dataclasses import asdict

    from edmctl.board.board_firmware import board_at, compared, mismatch, settings_not_compared
    from edmctl.board.image import read_image
    from edmctl.cli.render.procedure_tables import render_checks
    from edmctl.profile.setup import load_setup

    read = read_image(image)
    board = board_at(port, load_setup(setup), wait, partial(tell, outcome.output), shell().environ)
    outcome.simulated = board.is_simulated
    checks = [*compared(read, board), settings_not_compared(read, board.port)]
    outcome.result = {
        "image": read.as_mapping(),
        "board": board.as_mapping(),
        "checks": [{**asdict(check), "status": check.status.value} for check in checks],
    }
    outcome.show(lambda style: render_checks(checks, style))
    if error := mismatch(read, board, checks):
        raise error
