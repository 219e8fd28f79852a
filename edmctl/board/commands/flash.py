"""`edmctl firmware flash`: an image onto a board, by a tool that is installed."""

import sys
from functools import partial
from typing import TYPE_CHECKING, Annotated

import typer

from edmctl import failures
from edmctl.board.commands.info import ImageArgument
from edmctl.cli import completion
from edmctl.cli.options import NOTES, SetupOption, WaitOption, command
from edmctl.cli.outcome import Outcome, Output, mutter, tell
from edmctl.cli.signals import shell

if TYPE_CHECKING:
    from edmctl.board.board_firmware import FlashReport
    from edmctl.core.boards import Board

ToolOption = Annotated[
    str | None,
    typer.Option(
        "--tool",
        metavar="pyocd|openocd",
        help="Default: the first of them that is installed.",
    ),
]
ProbeOption = Annotated[
    str | None,
    typer.Option("--probe", metavar="ID", help="Serial number of the ST-LINK."),
]
FlashPortOption = Annotated[
    str | None,
    typer.Option(
        "--port",
        metavar="PORT",
        help="Where the board is asked whether a job runs, and afterwards who it is.",
        autocompletion=completion.ports,
        show_default=False,
    ),
]
OffOption = Annotated[
    bool,
    typer.Option("--yes-high-voltage-is-off", help="Do not ask whether the high voltage is off: it is."),
]
_ANSWER = "off"


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
    from edmctl.board.board_firmware import FlashReport, FlashRequest, flash_board, image_doubts
    from edmctl.board.image import read_image
    from edmctl.board.results import settings_text
    from edmctl.link.messages import SCHEMA_HASH
    from edmctl.profile.setup import load_setup

    read = read_image(image, SCHEMA_HASH)
    outcome.warn(image_doubts(read.facts))
    settings = settings_text(read.facts.settings)
    report = FlashReport(read.facts)
    request = FlashRequest(read, tool, probe, port, wait)
    confirm = partial(_confirm, outcome.output, settings, is_said=high_voltage_is_off)
    try:
        say = partial(tell, outcome.output)
        flash_board(request, report, load_setup(setup), say, shell().environ, confirm)
    finally:
        outcome.result = report.as_mapping()
        outcome.text = _told(report)


def _confirm(output: Output, settings: str, board: "Board", *, is_said: bool) -> None:
    """Ask whether the high voltage is off. Raises PreconditionError E8124 if it is not."""
    if is_said:
        return
    remedy = (
        "Switch it off, see that its meter shows nothing, and flash again with --yes-high-voltage-is-off."
    )
    if output.json or not (sys.stdin is not None and sys.stdin.isatty() and sys.stderr.isatty()):
        raise failures.high_voltage_unconfirmed(remedy=remedy)
    mutter(
        f"While {board.title} is flashed nothing guards the machine, and its outputs float.\n"
        f"Settings of the image: {settings}.\n"
        f"Is the high voltage off, by its switch and by its meter? Type `{_ANSWER}` to flash: "
    )
    if sys.stdin.readline().strip() != _ANSWER:
        raise failures.high_voltage_on(remedy=remedy)


def _told(report: "FlashReport") -> str:
    from edmctl.board.results import settings_text

    if report.flashed is None:
        return ""
    done, image = report.flashed, report.image
    text = f"Settings of the image: {settings_text(image.settings)}.\n"
    text += f"{image.board_name}: {done.size_bytes} bytes written by {done.tool}, read back and the same; started."
    if report.after is not None:
        serial = f" ({report.after.serial})" if report.after.serial else ""
        text += f"\nThe board at {report.after.port}{serial} answers."
    return text
