"""Write tables as CSV, and split lines of CSV.

Tables follow RFC 4180 with plain line ends. A spreadsheet computes no text of them.
"""

from __future__ import annotations

import csv
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


def cells_of(line: str, separator: str | None = ",", *, strict: bool = False) -> list[str]:
    """Return the cells of a line without quotes and blanks around them; empty ones at the end are left out.

    A separator of None splits at blanks. Raises csv.Error for a wrong quotation mark if `strict`.
    """
    if separator is None:
        return line.split()
    found = csv.reader([line], delimiter=separator, skipinitialspace=True, strict=strict)
    cells = [plain_text(cell.strip()) for cell in next(found, [])]
    while cells and not cells[-1]:
        cells.pop()
    return cells


def span_of(line: str, separator: str | None, cell: int) -> tuple[int, int]:
    """Return begin and length of a cell in its line; of the whole line if that has no such cell."""
    between = rf'(?:^|(?<={separator}))(?: *"[^"]*")?[^{separator}]*'
    found = list(re.finditer(r"\S+" if separator is None else between, line))
    if cell >= len(found):
        return 0, len(line)
    text = found[cell][0]
    return found[cell].start() + len(text) - len(text.lstrip()), len(text.strip())


def number_of(cell: str, *, decimal_commas: bool = False) -> float | None:
    """Return the number in a cell; None if it is none, or only Python reads it as one, such as 0_2."""
    try:
        return None if "_" in cell else float(cell.replace(",", ".") if decimal_commas else cell)
    except ValueError:
        return None


def row_lines(columns: Iterable[Iterable[str]]) -> str:
    """Return the lines of some rows from their cells by column."""
    return "".join(f"{','.join(cells)}\n" for cells in zip(*columns, strict=True))


def table_text(rows: Sequence[Mapping[str, object]]) -> str:
    """Return a table with the columns of all rows, in the order of their appearance; None and NaN are empty."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    return row_lines([text_cell(name), *(_cell(row.get(name)) for row in rows)] for name in names)


def _cell(value: object) -> str:
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    return text_cell(str(value))
