"""`edmctl firmware`: build it for virtual machines and boards, look at images and boards, flash."""

from edmctl.board.commands import build, flash, info
from edmctl.cli.options import command_group

app = command_group("Build the firmware, look at it and flash it.")
app.command("build")(build.build)
app.command("info")(info.info)
app.command("verify")(info.verify)
app.command("flash")(flash.flash)
