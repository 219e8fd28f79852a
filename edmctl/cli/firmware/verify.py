"""`edmctl firmware verify`: whether a board runs what an image holds."""

import sys
from functools import partial

from edmctl.cli.firmware.arguments import BoardPortArgument, ImageArgument
from edmctl.cli.options import NOTES, SetupOption, WaitOption, command
from edmctl.cli.outcome import Outcome, stream_style, tell
from edmctl.cli.signals import shell


@command("firmware verify", NOTES)
def verify(
    outcome: Outcome,
    image: ImageArgument,
    port: BoardPortArgument,
    setup: SetupOption = None,
    wait: WaitOption = 0.0,
) -> None:
    """Compare board, schema and version of an image with those of a connected board.

    The board is asked without opening a session: what runs there goes on. The line does not tell the bytes of the
    flash, nor what was --set; `edmctl firmware flash` reads the flash back.
    """
    from dataclasses import asdict

    from edmctl.console.procedure_tables import render_checks
    from edmctl.firmware.image import read_image
    from edmctl.jobs.board_firmware import board_at, compared, mismatch, settings_not_compared
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
    outcome.text = render_checks(checks, stream_style(sys.stdout))
    if error := mismatch(facts, board, checks):
        raise error
