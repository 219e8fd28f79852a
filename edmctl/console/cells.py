"""Lines of painted text for a terminal: how many cells they take, and how they are cut."""

from __future__ import annotations

import unicodedata
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    from collections.abc import Sequence

    from edmctl.console.style import Ink, Style

Span: TypeAlias = "tuple[str, Ink | None]"
"""Text in one ink, None for that of the terminal."""

_ASCII = str.maketrans(
    {"µ": "u", "±": "+-", "–": "-", "−": "-", "…": "~", "·": "*", "°": " deg ", "×": "x", "→": "->", " ": " "}
)


def plain_ascii(text: str) -> str:
    """Return `text` for a terminal that shows ASCII only; what has no likeness becomes `?`."""
    return text if text.isascii() else text.translate(_ASCII).encode("ascii", "replace").decode("ascii")


def printable(text: str) -> str:
    """Return `text` without control characters: a name must not move the cursor."""
    return text if text.isprintable() else "".join(c if c.isprintable() else " " for c in text)


def cells_of(text: str) -> int:
    """Cells that `text` takes: wide characters two, combining ones none."""
    return len(text) if text.isascii() else sum(map(_cells, text))


def cut(text: str, cells: int) -> str:
    """Return as much of `text` as fits, with an ellipsis where it was cut."""
    if cells_of(text) <= cells:
        return text
    kept, used = [], 0
    for character in text:
        used += _cells(character)
        if used > cells - 1:
            break
        kept.append(character)
    return "".join(kept).rstrip() + "…" if cells > 0 else ""


def render_line(spans: Sequence[Span], cells: int, style: Style) -> str:
    """Return the spans painted, cut to `cells`."""
    parts = []
    for text, ink in spans:
        if cells <= 0:
            break
        shown = cut(text if style.unicode else plain_ascii(text), cells)
        if not style.unicode:
            shown = plain_ascii(shown)
        cells -= cells_of(shown)
        parts.append(style.paint(shown, ink) if ink else shown)
    return "".join(parts)


def _cells(character: str) -> int:
    if unicodedata.combining(character):
        return 0
    return 2 if unicodedata.east_asian_width(character) in "WF" else 1
