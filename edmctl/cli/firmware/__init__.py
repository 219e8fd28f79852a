"""`edmctl firmware`: the core of the firmware as a library for virtual machines."""

import typer

from edmctl.cli.firmware import build

app = typer.Typer(
    help="Build the core of the firmware for virtual machines.", rich_markup_mode=None, add_completion=False
)


@app.callback()
def firmware() -> None:
    """Build the core of the firmware for virtual machines."""


app.command("build")(build.build)
