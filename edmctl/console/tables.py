"""Plain aligned tables."""

from __future__ import annotations

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
