"""Text laid out for a terminal: tables by rich, wrapped paragraphs, and painted lines cut to a width."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, TypeAlias

from edmctl.cli.render.style import PLAIN, Ink, Style

if TYPE_CHECKING:
    from rich.console import JustifyMethod

Span: TypeAlias = "tuple[str, Ink | None]"
"""Text in one ink, None for that of the terminal."""
NARROW_COLUMNS = 60
USUAL_COLUMNS = 80
"""Width of text for files and pipes, and of an ordinary terminal."""
_COMMAND = re.compile(r"`[^`]+`")
GAP = 3
"""Blanks between the columns of a table."""


def render_columns(
    header: Sequence[str],
    rows: Sequence[Sequence[str | Span]],
    style: Style = PLAIN,
    align: str = "<>",
    fold: str | None = None,
) -> str:
    """Align `rows` under `header`.

    align : one `<` or `>` per column; the last one is used for all columns after it. A row may be shorter than
        the header; what is missing stays empty.
    fold : the column that is folded if the terminal is too narrow; None for all.
    """
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, padding=(0, GAP, 0, 0), pad_edge=False, header_style=Ink.STRONG)
    for name, side in zip(header, align.ljust(len(header), align[-1]), strict=False):
        justify: JustifyMethod = "left" if side == "<" else "right"
        table.add_column(Text(name), justify=justify, no_wrap=fold not in (name, None), overflow="fold")
    for row in rows:
        cells = (cell if isinstance(cell, tuple) else (cell, None) for cell in row)
        table.add_row(*(Text(text, style=ink or "") for text, ink in cells))
    return style.render(table)


def narrowed(
    table: Mapping[str, Sequence[str]], columns: int | None, first_to_go: Iterable[str]
) -> dict[str, Sequence[str]]:
    """Return a table of columns under their names without those that do not fit a narrow terminal.

    columns : width of the terminal; columns are left out in this order until the table fits. None: all are shown.
    """
    shown = dict(table)
    for name in first_to_go:
        if columns is None or width_of(shown) <= columns:
            break
        shown.pop(name, None)
    return shown


def not_shown(table: Iterable[str], shown: Iterable[str]) -> str:
    """Return the note on columns that were left out; empty without any."""
    names = [name.partition(",")[0].removesuffix(" µm") for name in table if name not in set(shown)]
    return f"Hidden columns (terminal too narrow): {', '.join(names)}." if names else ""


def render_table(
    table: Mapping[str, Sequence[str]],
    style: Style,
    *,
    left: Iterable[str] = (),
    cut_first: str | None = None,
) -> str:
    """Render a table of columns under their names; the first one is aligned to the left, and those of `left`.

    If the table is wider than the terminal, the texts under `cut_first` are folded.
    """
    align = "<" + "".join("<" if name in left else ">" for name in list(table)[1:])
    return render_columns(list(table), list(zip(*table.values(), strict=True)), style, align, cut_first)


def width_of(table: Mapping[str, Sequence[str]]) -> int:
    """Return how wide a table of columns under their names is."""
    return sum(max(map(len, (name, *cells))) + GAP for name, cells in table.items()) - GAP


def wrapped(text: str, columns: int | None, indent: str = "") -> list[str]:
    """Break a text between words, all lines but the first with an indent; without `columns` it is one line.

    A word that is wider stays whole, and so does a command between backquotes, so that it can be copied.
    """
    if columns is None:
        return [text]
    # A number stays with its unit, and a share with what it is a share of.
    glued = text.replace(" % ", "\u00a0%\u00a0").replace(" µm", "\u00a0µm")
    glued = _COMMAND.sub(lambda command: command[0].replace(" ", "\u00a0"), glued)
    filler = textwrap.TextWrapper(max(columns, 20), break_long_words=False, break_on_hyphens=False)
    filler.subsequent_indent = indent
    return [line.replace("\u00a0", " ") for line in filler.wrap(glued)]


def labelled(label: str, text: str, cells: int, columns: int) -> str:
    """Return a text behind its label, which has `cells` (fewer on a narrow terminal), within `columns`."""
    if columns < NARROW_COLUMNS:
        cells = len(label) + 2
    return "\n".join(wrapped(f"{label:{cells}}{text}", columns, " " * cells))
