"""CSV as all tables are written: RFC 4180 with plain line ends, and no text that a spreadsheet would compute."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence

_FORMULA = re.compile(r"'*(?![-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?\Z)[=+\-@\t\r]")
"""What a spreadsheet computes, behind any apostrophes. A number stays a number."""
_NEEDS_QUOTES = frozenset('",\r\n')


def text_cell(text: str) -> str:
    """Return a text as a cell. An apostrophe marks a text that begins like a formula; `plain_text` removes it."""
    if _FORMULA.match(text):
        text = f"'{text}"
    if _NEEDS_QUOTES.isdisjoint(text):
        return text
    doubled = text.replace('"', '""')
    return f'"{doubled}"'


def plain_text(cell: str) -> str:
    """Return the text that `text_cell` wrote, without quotes already."""
    return cell[1:] if cell.startswith("'") and _FORMULA.match(cell) else cell


def number_of(cell: str, *, decimal_commas: bool = False) -> float | None:
    """Return the number in a cell; None if it is none, or only Python reads it as one, such as 0_2."""
    try:
        return None if "_" in cell else float(cell.replace(",", ".") if decimal_commas else cell)
    except ValueError:
        return None


def header_line(names: Iterable[str]) -> str:
    """Return the first line of a table."""
    return ",".join(map(text_cell, names)) + "\n"


def row_lines(columns: Iterable[Iterable[str]]) -> str:
    """Return the lines of some rows from their cells by column."""
    return "".join(f"{','.join(cells)}\n" for cells in zip(*columns, strict=True))


def table_text(rows: Sequence[Mapping[str, object]]) -> str:
    """Return a table with the columns of all rows, in the order of their appearance; None and NaN are empty."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    return header_line(names) + row_lines([_cell(row.get(name)) for row in rows] for name in names)


def _cell(value: object) -> str:
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    return text_cell(str(value))
