"""Errors and warnings with the source line and a caret under the offending text."""

from __future__ import annotations

from collections.abc import Sequence

from edmctl.cli.render.style import PLAIN, Ink, Style
from edmctl.errors import Diagnostic, Location
from edmctl.wording import escaped, printable, shortened

MOST_COLUMNS = 300
"""Of a source line; a caret further on is not drawn."""


def render_diagnostics(diagnostics: Sequence[Diagnostic], style: Style = PLAIN) -> str:
    """Render every diagnostic, in the order given, separated by an empty line."""
    return "\n\n".join(_rendered(diagnostic, style) for diagnostic in diagnostics)


def _rendered(diagnostic: Diagnostic, style: Style) -> str:
    """One problem as it stands on stderr, without a final newline."""
    where = diagnostic.where
    kind, ink = ("warning", Ink.WARNING) if diagnostic.is_warning else ("error", Ink.ERROR)
    lines = [
        style.paint(f"{kind}[{diagnostic.code}]", ink)
        + style.paint(f": {_on_own_lines(diagnostic.message)}", Ink.STRONG)
    ]
    gutter = len(str(where.line)) if where else 1
    if where:
        lines += _source_lines(where, gutter, style, ink)
    if diagnostic.hint:
        lines.append(f"{' ' * gutter} {style.paint('= help:', Ink.NOTE)} {_on_own_lines(diagnostic.hint)}")
    return "\n".join(lines)


def _on_own_lines(text: str) -> str:
    """Return a text without control characters; further lines, such as those of a compiler, are indented."""
    return "\n  ".join(map(escaped, text.split("\n")))


def summary_line(errors: int, warnings: int) -> str:
    """Return `2 errors, 1 warning`."""
    parts = [
        f"{number} {noun}{'' if number == 1 else 's'}"
        for number, noun in ((errors, "error"), (warnings, "warning"))
        if number
    ]
    return ", ".join(parts)


def _source_lines(where: Location, gutter: int, style: Style, ink: Ink) -> list[str]:
    pad = " " * gutter
    arrow, bar = style.paint("-->", Ink.GUTTER), style.paint("|", Ink.GUTTER)
    lines = [f"{pad}{arrow} {escaped(where.file)}:{where.line}:{where.column}"]
    if where.source_line and where.column <= MOST_COLUMNS:
        number = style.paint(f"{where.line:>{gutter}}", Ink.GUTTER)
        lines.append(f"{number} {bar} {shortened(_shown(where.source_line), MOST_COLUMNS)}")
        lines.append(f"{pad} {bar} {_indent(where)}{style.paint('^' * _caret_length(where), ink)}")
    return lines


def _shown(line: str) -> str:
    """Return a source line with its tabs, and `?` for other control characters, so that the caret fits."""
    return "\t".join(map(printable, line.split("\t")))


def _indent(where: Location) -> str:
    """Repeat the tabs of the source line, so that the caret stands right at any tab width."""
    before = where.source_line[: where.column - 1].ljust(where.column - 1)
    return "".join("\t" if character == "\t" else " " for character in before)


def _caret_length(where: Location) -> int:
    rest = min(len(where.source_line), MOST_COLUMNS) - (where.column - 1)
    return max(1, min(where.length, rest))
