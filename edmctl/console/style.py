"""Whether a stream wants colour, and whether it can redraw."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from collections.abc import Mapping


class Ink(StrEnum):
    """SGR parameters of the few colours in use."""

    ERROR = "1;31"
    WARNING = "1;33"
    NOTE = "1;36"
    GUTTER = "34"
    STRONG = "1"
    FAINT = "2"


@dataclass(frozen=True, slots=True)
class Style:
    """How to write to one stream."""

    colour: bool
    live: bool

    def paint(self, text: str, ink: Ink) -> str:
        """Return `text` in `ink`, or unchanged where colour is off."""
        return f"\x1b[{ink.value}m{text}\x1b[0m" if self.colour and text else text


PLAIN = Style(colour=False, live=False)


def style_of(stream: TextIO, environ: Mapping[str, str]) -> Style:
    """Decide by the stream and the customary variables.

    `NO_COLOR` (any value but empty) wins over `FORCE_COLOR`; `TERM=dumb` has neither colour nor redrawing.
    """
    terminal = stream.isatty()
    dumb = environ.get("TERM", "") == "dumb"
    if environ.get("NO_COLOR"):
        colour = False
    elif environ.get("FORCE_COLOR"):
        colour = True
    else:
        colour = terminal and not dumb
    return Style(colour=colour, live=terminal and not dumb)
