"""Text for a terminal: colour and width of a stream, tables by rich, and paragraphs."""

from __future__ import annotations

import os
import re
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from enum import StrEnum
from typing import TYPE_CHECKING, TextIO, TypeAlias

from edmctl.dataclasses import dataclass

if TYPE_CHECKING:
    from rich.console import JustifyMethod, RenderableType

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


Span: TypeAlias = "tuple[str, Ink | None]"
"""Text in one ink, None for that of the terminal."""
NARROW_COLUMNS = 60
USUAL_COLUMNS = 80
"""Width of text for files and pipes, and of an ordinary terminal."""
_LABEL = re.compile(r" *\S.*?  +(?=\S)| +")
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


def fitted(text: str, columns: int | None) -> str:
    """Return a text with its long lines wrapped at words, behind their label if they have one.

    Lines with colours are tables, which have their width already.
    """
    if columns is None:
        return text
    lines = []
    for line in text.split("\n"):
        if len(line) <= columns or "\x1b" in line:
            lines.append(line)
        else:
            label = _LABEL.match(line)
            lines += wrapped(
                line, columns, " " * (label.end() if label and label.end() < columns // 2 else 0)
            )
    return "\n".join(lines)


def labelled(label: str, text: str, cells: int, columns: int) -> str:
    """Return a text behind its label, which has `cells` (fewer on a narrow terminal), within `columns`."""
    if columns < NARROW_COLUMNS:
        cells = len(label) + 2
    return "\n".join(wrapped(f"{label:{cells}}{text}", columns, " " * cells))
