"""`edmctl firmware info` and `verify`: what an image is, what runs on a board, and whether they are the same."""

import stat
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from edmctl.cli import completion
from edmctl.cli.options import NOTES, SetupOption, WaitOption, command
from edmctl.cli.outcome import Outcome, tell
from edmctl.cli.signals import shell
from edmctl.files import user_path

WhatArgument = Annotated[
    str,
    typer.Argument(
        metavar="FILE|PORT",
        help="An image (ELF, BIN or HEX), or the port of a board.",
        autocompletion=completion.ports,
        show_default=False,
    ),
]
IMAGE_SUFFIXES = (".elf", ".bin", ".hex")


@command("firmware info", NOTES)
def info(outcome: Outcome, what: WhatArgument, setup: SetupOption = None, wait: WaitOption = 0.0) -> None:
    """Show what an image contains, or what runs on a board.

    No session is opened, so a job on the board continues.
    """
    from edmctl.board.board_firmware import board_at, image_doubts
    from edmctl.board.commands.tables import render_board, render_image
    from edmctl.board.image import read_image
    from edmctl.link.messages import SCHEMA_HASH
    from edmctl.profile.setup import load_setup

    if _is_file(what):
        image = read_image(user_path(what), SCHEMA_HASH)
        outcome.warn(image_doubts(image.facts))
        outcome.result = {"image": image.facts.as_mapping(), "board": None}
        outcome.show(lambda style: render_image(image.facts, style))
        return
    say = partial(tell, outcome.output)
    with board_at(what, load_setup(setup), wait, say, shell().environ) as asked:
        assert asked.board is not None
        outcome.simulated = asked.board.board == 0 if asked.board.board is not None else None
        outcome.result = {"image": None, "board": asked.board.as_mapping()}
        outcome.text = render_board(asked.board)


def _is_file(what: str) -> bool:
    """Whether an image is meant: an existing file, or a name with the ending of one."""
    if "://" in what:
        return False
    with suppress(OSError, ValueError):
        return not stat.S_ISCHR(user_path(what).stat().st_mode)
    return user_path(what).suffix.lower() in IMAGE_SUFFIXES


ImageArgument: TypeAlias = Annotated[
    Path, typer.Argument(metavar="FILE", help="Image of a board: ELF, BIN or HEX.", show_default=False)
]
BoardPortArgument: TypeAlias = Annotated[
    str,
    typer.Argument(
        metavar="PORT",
        help="Where the board is: a serial port, socket://HOST:PORT, serial:ID or auto.",
        autocompletion=completion.ports,
        show_default=False,
    ),
]


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
    from edmctl.link.messages import SCHEMA_HASH
    from edmctl.profile.setup import load_setup

    facts = read_image(image, SCHEMA_HASH).facts
    say = partial(tell, outcome.output)
    with board_at(port, load_setup(setup), wait, say, shell().environ) as asked:
        board = asked.board
    assert board is not None
    outcome.simulated = board.board == 0 if board.board is not None else None
    checks = [*compared(facts, board), settings_not_compared(facts, board)]
    outcome.result = {
        "image": facts.as_mapping(),
        "board": board.as_mapping(),
        "checks": [{**asdict(check), "status": check.status.value} for check in checks],
    }
    outcome.show(lambda style: render_checks(checks, style))
    if error := mismatch(facts, board, checks):
        raise error
