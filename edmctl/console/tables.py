"""Plain aligned tables."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

from edmctl.console.style import PLAIN, Ink, Style

if TYPE_CHECKING:
    from collections.abc import Sequence

_GAP = "   "


def render_columns(
    header: Sequence[str], rows: Sequence[Sequence[str]], style: Style = PLAIN, align: str = "<>"
) -> str:
    """Align `rows` under `header`.

    align : one `<` or `>` per column; the last one holds for all columns after it. A row may be shorter than
        the header; what is missing stays empty.
    """
    sides = align.ljust(len(header), align[-1])
    width = [
        max(len(row[column]) if column < len(row) else 0 for row in (header, *rows))
        for column in range(len(header))
    ]
    form = _GAP.join(f"{{:{side}{w}}}" for side, w in zip(sides, width, strict=False))
    lines = [form.format(*row, *[""] * (len(header) - len(row))).rstrip() for row in (header, *rows)]
    return "\n".join([style.paint(lines[0], Ink.STRONG), *lines[1:]])


def width_of(header: Sequence[str], rows: Sequence[Sequence[str]]) -> int:
    """Return how wide the table of `render_columns` would be."""
    return max(map(len, render_columns(header, rows).splitlines()))


def wrapped(text: str, columns: int, indent: str = "") -> list[str]:
    """Break a text between words, all lines but the first with an indent; a word that is wider stays whole."""
    # A number stays with its unit, and a share with what it is a share of.
    glued = text.replace(" % ", "\u00a0%\u00a0").replace(" µm", "\u00a0µm")
    lines = textwrap.wrap(
        glued,
        max(columns, 20),
        subsequent_indent=indent,
        break_long_words=False,
        break_on_hyphens=False,
    )
    return [line.replace("\u00a0", " ") for line in lines]
