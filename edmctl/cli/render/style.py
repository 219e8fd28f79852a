"""How to write to a stream: whether it wants colour, can redraw, shows more than ASCII, and how wide it is."""

from __future__ import annotations

import os
from collections.abc import Mapping
from enum import StrEnum
from typing import TYPE_CHECKING, TextIO

from edmctl.dataclasses import dataclass

if TYPE_CHECKING:
    from rich.console import RenderableType

_ENDLESS = 10_000
"""Columns of a file or a pipe: nothing is wrapped or cut for it."""


class Ink(StrEnum):
    """Names that rich has for the few styles in use."""

    ERROR = "bold red"
    WARNING = "bold yellow"
    NOTE = "bold cyan"
    GUTTER = "blue"
    STRONG = "bold"
    FAINT = "dim"
    BAND = "cyan"
    SIGNAL = "cyan"
    OPEN = "bright_black"
    NORMAL = "bright_blue"
    ARC = "yellow"
    SHORT = "red"


@dataclass(frozen=True, slots=True)
class Style:
    """How to write to one stream; `columns` is the width of a terminal, None for files and pipes."""

    colour: bool
    live: bool
    unicode: bool = True
    columns: int | None = None

    def paint(self, text: str, ink: Ink) -> str:
        """Return `text` in `ink`, or unchanged if colour is off."""
        if not (self.colour and text):
            return text
        from rich.color import ColorSystem
        from rich.style import Style as RichStyle

        return RichStyle.parse(ink).render(text, color_system=ColorSystem.STANDARD)

    def render(self, *parts: RenderableType) -> str:
        """Return what rich makes of `parts` for this stream, without blanks at the ends of lines."""
        # Only what is shown to a person needs rich: it takes 30 ms to load.
        from io import StringIO

        from rich.console import Console

        console = Console(
            file=StringIO(),
            width=self.columns or _ENDLESS,
            color_system="standard" if self.colour else None,
            force_terminal=self.colour,
            no_color=not self.colour,
            legacy_windows=False,
            highlight=False,
            markup=False,
            emoji=False,
        )
        with console.capture() as written:
            for part in parts:
                console.print(part, crop=False, soft_wrap=bool(getattr(part, "no_wrap", False)))
        return "\n".join(line.rstrip() for line in written.get().splitlines())


PLAIN = Style(colour=False, live=False)


def style_of(stream: TextIO, environ: Mapping[str, str]) -> Style:
    """Return the style for a stream and the usual environment variables.

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
    return Style(
        colour=colour,
        live=terminal and not dumb,
        unicode=_shows_unicode(stream, environ),
        columns=terminal_columns() if terminal else None,
    )


def terminal_columns() -> int:
    """Return the width of the terminal, or what `COLUMNS` says; 80 if there is neither."""
    from shutil import get_terminal_size

    return get_terminal_size().columns


def _shows_unicode(stream: TextIO, environ: Mapping[str, str]) -> bool:
    """By encoding and locale: in the C locale Python writes UTF-8 to any terminal."""
    encoding = getattr(stream, "encoding", None) or "utf-8"
    if not encoding.lower().replace("-", "").startswith("utf"):
        return False
    if os.name == "nt" or environ.get("PYTHONUTF8") == "1" or environ.get("PYTHONIOENCODING"):
        return True
    # Python itself puts LC_CTYPE=C.UTF-8 into the environment of a process in the C locale (PEP 538).
    named = environ.get("LC_CTYPE", "")
    locale = environ.get("LC_ALL") or (named if named != "C.UTF-8" else "") or environ.get("LANG")
    return (locale or "C") not in ("C", "POSIX")
