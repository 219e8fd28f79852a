"""Errors and warnings with the source line and a caret under the offending text."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from edmctl.cli.render.terminal import PLAIN, Ink, Style, wrapped
from edmctl.errors import Diagnostic, Location
from edmctl.wording import escaped, plural, printable, shortened

if TYPE_CHECKING:
    from rich.text import Text

MOST_COLUMNS = 300
"""Of a source line in a file or a pipe; a caret further on is not drawn."""


def render_diagnostics(diagnostics: Sequence[Diagnostic], style: Style = PLAIN) -> str:
    """Render every diagnostic, in the order given, separated by an empty line; several with their number."""
    blocks = [style.render(*_lines(diagnostic, style.columns)) for diagnostic in diagnostics]
    if len(diagnostics) > 1:
        warnings = sum(one.is_warning for one in diagnostics)
        counts = ((len(diagnostics) - warnings, "error"), (warnings, "warning"))
        blocks.append(", ".join(plural(number, noun) for number, noun in counts if number))
    return "\n\n".join(blocks)


def _lines(diagnostic: Diagnostic, columns: int | None) -> Iterator[Text]:
    where = diagnostic.where
    kind, ink = ("warning", Ink.WARNING) if diagnostic.is_warning else ("error", Ink.ERROR)
    gutter = " " * (len(str(where.line)) if where else 1)
    yield from _labelled(f"{kind}[{diagnostic.code}]", ink, f": {diagnostic.message}", Ink.STRONG, columns)
    if where:
        yield _line((f"{gutter}-->", Ink.GUTTER), (f" {escaped(where.file)}:{where.line}:{where.column}", ""))
        yield from _source_lines(where, gutter, ink, columns)
    if diagnostic.hint:
        yield from _labelled(f"{gutter} = help:", Ink.NOTE, f" {diagnostic.hint}", "", columns)


def _line(*spans: tuple[str, str]) -> Text:
    from rich.text import Text

    return Text.assemble(*spans, no_wrap=True, overflow="ignore")


def _labelled(label: str, ink: Ink, text: str, text_ink: str, columns: int | None) -> Iterator[Text]:
    """Text behind a label, without control characters; further lines, such as those of a compiler, are indented."""
    first, *others = map(escaped, text.split("\n"))
    begin, *rest = wrapped(label + first, columns, "  ")
    yield _line((label, ink), (begin.removeprefix(label), text_ink))
    for line in (*rest, *(line for other in others for line in wrapped(f"  {other}", columns, "  "))):
        yield _line((line, text_ink))


def _source_lines(where: Location, gutter: str, ink: Ink, columns: int | None) -> Iterator[Text]:
    """The source line, as much of it about the caret as fits, and the caret below."""
    line, before = where.source_line, where.column - 1
    most = MOST_COLUMNS if columns is None else max(20, columns - len(gutter) - 3)
    left_out = 0
    if columns is not None and len(line) > most:
        left_out = min(max(0, before - most // 3), len(line) - most)
        line, before = line[left_out:], before - left_out
    if not where.source_line or before >= most:
        return
    text = shortened("\t".join(map(printable, line.split("\t"))), most)
    if left_out:
        text = f"…{text[1:]}"
    # The tabs of the source line are repeated, so that the caret is right at any tab width.
    indent = "".join("\t" if character == "\t" else " " for character in line[:before].ljust(before))
    length = max(1, min(where.length, len(text) - before))
    yield _line((f"{where.line} |", Ink.GUTTER), (f" {text}", ""))
    yield _line((f"{gutter} |", Ink.GUTTER), (f" {indent}", ""), ("^" * length, ink))
