"""`edmctl firmware flash`: an image onto a board, by a tool that is installed."""

import sys
from functools import partial
from typing import TYPE_CHECKING, Annotated

from edmctl import failures
from edmctl.board.commands.info import ImageArgument
from edmctl.cli import completion
from edmctl.cli.options import NOTES, SetupOption, WaitOption, command, option
from edmctl.cli.outcome import Outcome, Output, mutter, tell
from edmctl.cli.signals import shell

if TYPE_CHECKING:
    from edmctl.board.board_firmware import Flashing
    from edmctl.core.boards import Board

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
    settings = settings_text(read.settings)
    job = Flashing(read, tool, probe, port, wait)
    confirm = partial(_confirm, outcome.output, settings, is_off=high_voltage_is_off)
    try:
        flash_board(job, load_setup(setup), partial(tell, outcome.output), shell().environ, confirm)
    finally:
        outcome.result = job.as_mapping()
        outcome.text = _summary(job, settings)


def _confirm(output: Output, settings: str, board: "Board", *, is_off: bool) -> None:
    """Ask whether the high voltage is off. Raises PreconditionError E8124 if it is not."""
    if is_off:
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


def _summary(job: "Flashing", settings: str) -> str:
    if job.tool is None:
        return ""
    text = (
        f"Settings of the image: {settings}.\n"
        f"{job.image.board_name}: {len(job.image.data)} bytes written by {job.tool}, read back, the same; started."
    )
    if job.after is not None:
        serial = f" ({job.after.serial})" if job.after.serial else ""
        text += f"\nThe board at {job.after.port}{serial} answers."
    return text
