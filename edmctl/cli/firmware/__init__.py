"""`edmctl firmware`: build it for virtual machines and boards, look at images and boards, flash."""

import typer

from edmctl.cli.firmware import build, flash, info, verify

app = typer.Typer(
    help="Build the firmware, look at it and flash it.", rich_markup_mode=None, add_completion=False
)


@app.callback()
def firmware() -> None:
    """Build the firmware, look at it and flash it."""


app.command("build")(build.build)
app.command("info")(info.info)
app.command("verify")(verify.verify)
app.command("flash")(flash.flash)
