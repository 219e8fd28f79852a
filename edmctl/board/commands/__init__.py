"""`edmctl firmware`: build it for virtual machines and boards, inspect images and boards, flash."""

from edmctl.board.commands import build, flash, info
from edmctl.cli.options import command_group

app = command_group("Build the firmware, look at it and flash it.")
for function in (build.build, info.info, info.verify, flash.flash):
    app.command(function.__name__)(function)
