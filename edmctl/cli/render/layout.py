"""Text laid out for a terminal: tables, wrapped paragraphs, and painted lines cut to a width."""

from __future__ import annotations

import re
import textwrap
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from typing import TypeAlias

from edmctl.cli.render.style import PLAIN, Ink, Style

Span: TypeAlias = "tuple[str, Ink | None]"
"""Text in one ink, None for that of the terminal."""
USUAL_COLUMNS = 80
"""Width of a terminal that nobody has made wider."""
LEAST_CELLS = 11
"""A column is cut to no less than this."""
_COMMAND = re.compile(r"`[^`]+`")
_GAP, NARROW_GAP = "   ", "  "
"""Between the columns of a table."""
_ASCII = str.maketrans(
    {"µ": "u", "±": "+-", "–": "-", "−": "-", "…": "~", "·": "*", "°": " deg ", "×": "x", "→": "->"}
)


def render_columns(
    header: Sequence[str],
    rows: Sequence[Sequence[str]],
    style: Style = PLAIN,
    align: str = "<>",
    gap: str = _GAP,
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
    form = gap.join(f"{{:{side}{w}}}" for side, w in zip(sides, width, strict=False))
    lines = [form.format(*row, *[""] * (len(header) - len(row))).rstrip() for row in (header, *rows)]
    return "\n".join([style.paint(lines[0], Ink.STRONG), *lines[1:]])


def narrowed(
    table: Mapping[str, Sequence[str]], columns: int | None, first_to_go: Iterable[str]
) -> dict[str, Sequence[str]]:
    """Return a table of columns under their names without those that a narrow terminal does without.

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
    return f"Not shown, for want of width: {', '.join(names)}." if names else ""


def render_table(
    table: Mapping[str, Sequence[str]],
    style: Style,
    *,
    left: Iterable[str] = (),
    cut_first: str = "",
) -> str:
    """Render a table of columns under their names; the first one is aligned to the left, and those of `left`.

    Where the table is wider than a terminal, its columns stand closer, or if that does not suffice, the texts under
    `cut_first` lose their middle.
    """
    shown, gap, columns = dict(table), _GAP, style.columns
    if columns is not None and (excess := width_of(shown) - columns) > 0:
        if width_of(shown, NARROW_GAP) <= columns:
            gap = NARROW_GAP
        elif cut_first:
            longest = max(LEAST_CELLS, max(map(len, shown[cut_first])) - excess)
            shown[cut_first] = [without_middle(text, longest) for text in shown[cut_first]]
    align = "<" + "".join("<" if name in left else ">" for name in list(shown)[1:])
    return render_columns(list(shown), list(zip(*shown.values(), strict=True)), style, align, gap)


def width_of(table: Mapping[str, Sequence[str]], gap: str = _GAP) -> int:
    """Return how wide a table of columns under their names is."""
    return sum(max(map(len, (name, *cells))) + len(gap) for name, cells in table.items()) - len(gap)


def without_middle(text: str, longest: int) -> str:
    """Return a text of `longest` letters at most, an ellipsis in its middle."""
    if len(text) <= longest:
        return text
    head = (longest - 1) // 2
    return f"{text[:head]}…{text[head + 1 - longest :]}"


def wrapped(text: str, columns: int, indent: str = "") -> list[str]:
    """Break a text between words, all lines but the first with an indent.

    What is wider stays whole: a word, and a command between backquotes, which somebody will copy.
    """
    # A number stays with its unit, and a share with what it is a share of.
    glued = text.replace(" % ", "\u00a0%\u00a0").replace(" µm", "\u00a0µm")
    glued = _COMMAND.sub(lambda command: command[0].replace(" ", "\u00a0"), glued)
    lines = textwrap.wrap(
        glued,
        max(columns, 20),
        subsequent_indent=indent,
        break_long_words=False,
        break_on_hyphens=False,
    )
    return [line.replace("\u00a0", " ") for line in lines]


def labelled(label: str, text: str, cells: int, columns: int) -> str:
    """Return a text behind its label, which has `cells`, within `columns`."""
    return "\n".join(wrapped(f"{label:{cells}}{text}", columns, " " * cells))


def plain_ascii(text: str) -> str:
    """Return `text` for a terminal that shows ASCII only; what has no likeness becomes `?`."""
    return text if text.isascii() else text.translate(_ASCII).encode("ascii", "replace").decode("ascii")


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
