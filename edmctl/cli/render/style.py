"""How to write to a stream: whether it wants colour, can redraw, shows more than ASCII, and how wide it is."""

from __future__ import annotations

import os
from collections.abc import Mapping
from enum import StrEnum
from typing import TextIO

from edmctl.dataclasses import dataclass


class Ink(StrEnum):
    """SGR parameters of the few colours in use."""

    ERROR = "1;31"
    WARNING = "1;33"
    NOTE = "1;36"
    GUTTER = "34"
    STRONG = "1"
    FAINT = "2"
    BAND = "36"
    SIGNAL = "36"
    OPEN = "90"
    NORMAL = "94"
    ARC = "33"
    SHORT = "31"


@dataclass(frozen=True, slots=True)
class Style:
    """How to write to one stream; `columns` is the width of a terminal, None for files and pipes."""

    colour: bool
    live: bool
    unicode: bool = True
    columns: int | None = None

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
    return Style(
        colour=colour,
        live=terminal and not dumb,
        unicode=_shows_unicode(stream, environ),
        columns=_columns() if terminal else None,
    )


def _columns() -> int:
    """Return the width of the terminal, or what `COLUMNS` says."""
    from shutil import get_terminal_size

    return get_terminal_size().columns


def _shows_unicode(stream: TextIO, environ: Mapping[str, str]) -> bool:
    """By the encoding of the stream and the locale: in the C locale Python writes UTF-8 to any terminal."""
    encoding = getattr(stream, "encoding", None) or "utf-8"
    if not encoding.lower().replace("-", "").startswith("utf"):
        return False
    if os.name == "nt" or environ.get("PYTHONUTF8") == "1" or environ.get("PYTHONIOENCODING"):
        return True
    # Python itself puts LC_CTYPE=C.UTF-8 into the environment of a process in the C locale (PEP 538).
    named = environ.get("LC_CTYPE", "")
    locale = environ.get("LC_ALL") or (named if named != "C.UTF-8" else "") or environ.get("LANG")
    return (locale or "C") not in ("C", "POSIX")
