"""Arguments that the commands of `edmctl firmware` share."""

from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from edmctl.cli import completion

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
