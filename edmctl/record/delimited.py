"""Read columns of text files: CSV as loggers, spreadsheets, oscilloscopes and NumPy write it.

Tabs, semicolons, commas or blanks separate the cells. Numbers may have a decimal comma unless commas separate. The
header names most of the wanted columns, with or without `#`; lines above it are ignored, and a line of their units
may follow. Case and the two Unicode letters µ make no difference.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Sequence
from itertools import takewhile
from pathlib import Path

import numpy as np

from edmctl import failures
from edmctl.array_types import Array
from edmctl.csv_text import cells_of, number_of, plain_text, span_of
from edmctl.errors import Location, RecordError
from edmctl.files import read_bytes
from edmctl.wording import code_point, plural, shortened

EXPORTED = {"t_s": "time_s", "u_V": "v_cmd_v", "y_um": "z_sensor_um"}
"""Names of columns in the servo table that `edmctl run export` writes."""
SEPARATORS = ("\t", ";", ",", None)
"""None: blanks."""
MOST_PREAMBLE = 1000
"""Lines that are searched for a header."""
LONGEST_LINE = 100_000
_UNIT = re.compile(r"[(\[]?(?:[numkµμ]?(?:s|sec|v|volts?|a|m|hz)|[-1%])[)\]]?", re.IGNORECASE)


def find_columns(names: Sequence[str], wanted: Sequence[str]) -> dict[str, int]:
    """Return the index in `names` of each wanted column, also under its exported name; missing ones are left out."""
    plain = [_plain(name) for name in names]
    aliases = {name: (_plain(name), EXPORTED.get(name)) for name in wanted}
    return {name: plain.index(alias) for name in wanted for alias in aliases[name] if alias in plain}


def read_table(path: Path, wanted: Sequence[str]) -> Table:
    """Return the table in a file. Raises RecordError as `Table`, and E3602 if the file cannot be read."""
    try:
        return Table(text_of(read_bytes(path), str(path)), str(path), wanted)
    except OSError as error:
        raise failures.table_unreadable(path=path, reason=error.strerror) from None


def text_of(content: bytes, name: str) -> str:
    """Return the text of a file with line feeds alone. Raises RecordError E3602 for a file that is no table."""
    if b"\0" in content[:4096]:
        raise failures.table_malformed(name=name)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _plain(name: str) -> str:
    return name.strip().strip("\"'").replace("µ", "u").replace("μ", "u").lower()


def _words(line: str) -> list[str]:
    """Return what any separator separates before a comment."""
    return re.split(r"[\s;,]+", line.partition("#")[0].strip("\t ,;"))


def _is_blank(line: str) -> bool:
    return not line.strip() or line.lstrip().startswith("#")


class Table:
    """A table in a text; `columns` has indices of wanted ones. Raises RecordError: E3602 no header, E3603 twice."""

    def __init__(self, text: str, name: str, wanted: Sequence[str]) -> None:
        self.name, self.lines = name, text.split("\n")
        self.header = self._find_header(wanted)
        self.separator, names, self.columns = self._split(self.header, wanted)
        self.width, self.begin = len(names), self.header + 1
        while self.begin < len(self.lines) and self._is_no_row(self.lines[self.begin]):
            self.begin += 1
        first_row = "".join(self.lines[self.begin : self.begin + 1]).partition("#")[0].strip()
        if (self.separator or " ") not in first_row:
            fitting = (one for one in SEPARATORS if len(cells_of(first_row, one)) == self.width)
            self.separator = next(fitting, self.separator)
        names = list(map(_plain, names))
        for column in self.columns:
            if names.count(_plain(column)) > 1:
                hint = "Keep one, or give the other another name."
                raise self._error(self.header + 1, f": two columns are called {column}", hint, "E3603")

    def _find_header(self, wanted: Sequence[str]) -> int:
        """Return the line with most of the wanted names, or with none the line above the first numbers."""
        lines = self.lines
        filled = [k for k, line in enumerate(lines[:MOST_PREAMBLE]) if line.strip() and line[:4] != "sep="]
        data = [k for k in filled if not _is_blank(lines[k])]
        above = list(takewhile(lambda k: not _is_numeric(lines[k]), filled))
        problem = "" if above else "has no header: its first line holds numbers"
        if not data:
            problem = "is empty or holds comments only"
        if (longest := max(map(len, lines))) > LONGEST_LINE:
            problem = f"has a line of {longest} characters"
        if problem:
            raise failures.table_without_columns(name=self.name, problem=problem)
        nearest = above[-1]
        if above == filled:
            nearest = data[0]
        elif len(above) > 1 and all(map(_UNIT.fullmatch, _words(lines[nearest]))):
            nearest = above[-2]
        return max((nearest, *above), key=lambda k: len(self._split(k, wanted)[2]))

    def _split(self, line: int, wanted: Sequence[str]) -> tuple[str | None, list[str], dict[str, int]]:
        """Return the separator of a header, its names, and the wanted columns among them."""
        text = self.lines[line].strip(" ").lstrip("# ")
        tried = [(one, names := cells_of(text, one), find_columns(names, wanted)) for one in SEPARATORS]
        return max(tried, key=lambda one: len(one[2]))

    def _is_no_row(self, line: str) -> bool:
        """Return whether a line is blank, or repeats the unit of each wanted column."""
        cells = dict(enumerate(_plain(cell.strip("()[]")) for cell in cells_of(line, self.separator)))
        units = {k: _plain(name.rpartition("_")[2]) for name, k in self.columns.items()}
        return _is_blank(line) or (bool(units) and units.items() <= cells.items())

    def numbers(self) -> dict[str, Array]:
        """Return the wanted columns, shape (n,) each. Raises RecordError E3604 at the first wrong cell or row."""
        try:
            values = self._plain_numbers()
        except ValueError:
            rows = [
                [self._number(line, name, text) for name, text in cells.items()]
                for line, cells in self.rows(numeric=True)
            ]
            values = np.array(rows, dtype=np.float64).reshape(-1, len(self.columns))
        return {name: np.ascontiguousarray(values[:, k]) for k, name in enumerate(self.columns)}

    def _plain_numbers(self) -> Array:
        """Return the wanted columns, shape (n, wanted), by NumPy. Raises ValueError if the table has oddities."""
        separator = self.separator
        lines = [line for line in self.lines[self.begin :] if line.strip()]
        if separator != ",":
            lines = [line.replace(",", ".") for line in lines]
        if not lines or any(line.rstrip(separator).count(separator or " ") >= self.width for line in lines):
            raise ValueError("no rows, or more cells than columns")
        return np.loadtxt(lines, delimiter=separator, usecols=list(self.columns.values()), ndmin=2)

    def rows(self, *, numeric: bool = False) -> Iterator[tuple[int, dict[str, str]]]:
        """Yield line, from 1, and wanted cells of each row; numeric ones are complete. Raises RecordError E3604."""
        lines = (
            line.partition("#")[0] if numeric or _is_blank(line) else line
            for line in self.lines[self.begin :]
        )
        if self.separator is None:
            lines = ("\t".join(line.split()) for line in lines)
        ended = (f"{line}\n" for line in lines)
        reader = csv.reader(ended, delimiter=self.separator or "\t", skipinitialspace=True)
        least = max(self.columns.values()) + 1 if numeric else 0
        try:
            for cells in reader:
                count = max((k for k, cell in enumerate(cells, 1) if cell.strip()), default=0)
                line = self.begin + reader.line_num
                if count > self.width or (count and len(cells) < least):
                    raise self._wrong_width(line, count)
                cells += [""] * (self.width - len(cells))
                if count:
                    yield line, {name: self._cell(cells[k]) for name, k in self.columns.items()}
        except csv.Error as wrong:
            hint = "Look for a quotation mark that is not closed."
            raise self._error(self.begin + reader.line_num, f": {wrong}", hint) from None

    def _cell(self, cell: str) -> str:
        text = cell.strip()
        if self.separator != "," and "," in text and number_of(text, decimal_commas=True) is not None:
            return text.replace(",", ".")
        return plain_text(text)

    def _number(self, line: int, column: str, text: str) -> float:
        if (number := number_of(text)) is not None:
            return number
        problem = f"{shortened(text)!r} is no number" if text else "the cell is empty"
        strange = next(
            (f"{code_point(one)} is not part of a number. " for one in text if not one.isascii()), ""
        )
        hint = f"{strange}Correct or delete the row; numbers are written like -12.5 or 1.25e-3."
        raise self._error(line, f", column {column}: {problem}", hint, cell=self.columns[column])

    def _wrong_width(self, line: int, cells: int) -> RecordError:
        hint = "Complete or delete the row."
        if cells > self.width and self.separator == ",":
            hint = "Write a decimal point, separate columns by semicolons, or name each column."
        elif cells > self.width:
            hint = "Delete the cells beyond the last column, or give them a name."
        elif not any(map(str.strip, self.lines[line:])):
            hint = "The file ends within a row: delete its last line."
        return self._error(line, f": {plural(cells, 'cell')} under a header of {self.width}", hint)

    def without(self, missing: Sequence[str], hint: str) -> RecordError:
        """Return the error E3603 for missing columns."""
        header = shortened(self.lines[self.header].strip().lstrip("# "))
        what = f": no column {' and no '.join(missing)} in {header}"
        return self._error(self.header + 1, what, hint, "E3603")

    def _error(self, line: int, what: str, hint: str, code: str = "E3604", cell: int = 0) -> RecordError:
        """Return an error at a line, from 1, or at one of its cells after the first."""
        text = self.lines[line - 1]
        start, length = span_of(text, self.separator, cell) if cell else (0, len(text))
        where = Location(self.name, line, start + 1, max(1, length), text)
        return RecordError(f"{self.name}, line {line}{what}.", hint=hint, code=code, where=where)


def _is_numeric(line: str) -> bool:
    words = _words(line)
    return len(words) > 1 and None not in map(number_of, words)
