"""Columns out of text: CSV as loggers, spreadsheets, oscilloscopes and numpy write it.

Tabs, semicolons, commas or blanks separate the cells; decimal commas are read unless commas separate. The header is
the line that names most of the wanted columns, with or without `#`. Lines above it are ignored. A line of units
below it must agree with the names.

A column is called by its quantity and unit: t_s, u_V, y_um. Case and the two Unicode letters µ make no difference.
"""

from __future__ import annotations

import csv
import re
from array import array
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import takewhile
from pathlib import Path

import numpy as np

from edmctl.array_types import Array
from edmctl.csv_text import number_of, plain_text
from edmctl.errors import Location, RecordError
from edmctl.files import read_bytes
from edmctl.wording import plural, shortened

TIME, VOLTAGE, DISPLACEMENT = "t_s", "u_V", "y_um"
STACK, TOOL = "x_um", "z_um"
MEANINGS = {
    TIME: "time in s",
    VOLTAGE: "actuator voltage in V",
    DISPLACEMENT: "tool displacement in µm",
    STACK: "stack displacement in µm",
    TOOL: "tool displacement in µm",
}
WANTED = (TIME, VOLTAGE, DISPLACEMENT)
EXPORTED = {TIME: "time_s", VOLTAGE: "v_cmd_v", DISPLACEMENT: "z_sensor_um"}
"""The same columns in the servo table that `edmctl run export` writes."""

BLANKS = " "
SEPARATORS = ("\t", ";", ",", BLANKS)
COMMENT = "#"
MOST_PREAMBLE = 1000
"""Lines above a header; oscilloscopes write some twenty."""
LONGEST_LINE = 100_000
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+(?:[eE][+-]?\d+)?")
_UNIT = re.compile(r"[(\[]?(?:[numkµμ]?(?:s|sec|v|volts?|a|m|hz)|[-1%])[)\]]?", re.IGNORECASE)


def find_columns(names: Sequence[str], wanted: Sequence[str] = WANTED) -> dict[str, int]:
    """Return the index in `names` of each wanted column; missing ones are left out.

    A table that `edmctl run export` wrote has all of them under other names.
    """
    plain = [_plain(name) for name in names]
    exported = [EXPORTED[name] for name in wanted if name in EXPORTED]
    if len(exported) == len(wanted) and all(name in plain for name in exported):
        return {name: plain.index(other) for name, other in zip(wanted, exported, strict=True)}
    return {name: plain.index(_plain(name)) for name in wanted if _plain(name) in plain}


def columns_hint(needed: Sequence[str]) -> str:
    """Return the hint that names the needed columns and their units."""
    return f"Needed: {', '.join(f'{name} ({MEANINGS[name]})' for name in needed)}. Other columns are ignored."


@dataclass(frozen=True, slots=True)
class Table:
    """A table in a text.

    header, begin : index of the line with the names, and of the first row
    separator : of the cells of a row
    columns : index in `names` of each wanted column; missing ones are left out
    """

    name: str
    lines: Sequence[str]
    header: int
    begin: int
    names: Sequence[str]
    separator: str
    columns: dict[str, int]

    def rows(self) -> Iterator[tuple[int, list[str]]]:
        """Yield the line, from 1, and the cells of each row. Raises RecordError E3604 for more cells than names."""
        lines, separator, width = self.lines[self.begin :], self.separator, len(self.names)
        if separator == BLANKS:
            lines, separator = ["\t".join(line.split()) for line in lines], "\t"
        reader = csv.reader((f"{line}\n" for line in lines), delimiter=separator, skipinitialspace=True)
        try:
            for cells in reader:
                if len(cells) > width and (count := _filled(cells)) > width:
                    hint = "Delete the cells beyond the last column, or give them a name."
                    if self.separator == ",":
                        hint = "Write a decimal point, separate columns by semicolons, or name each column."
                    raise self._of_width(self.begin + reader.line_num, count, hint)
                if any(cells):
                    yield self.begin + reader.line_num, cells
        except csv.Error as wrong:
            hint = "Look for a quotation mark that is not closed."
            raise self.error(self.begin + reader.line_num, f": {wrong}", hint) from None

    def texts(self) -> list[tuple[int, dict[str, str]]]:
        """Return the line and the wanted cells of each row; a row may end before its last columns."""
        return [
            (line, {name: _text(cells[k]) if k < len(cells) else "" for name, k in self.columns.items()})
            for line, cells in self.rows()
        ]

    def numbers(self) -> dict[str, Array]:
        """Return the wanted columns, shape (n,) each. Raises RecordError E3604 for a cell that is no number."""
        values, commas = array("d"), self.separator != ","
        for line, cells in self.rows():
            for name, k in self.columns.items():
                number = number_of(cells[k], decimal_commas=commas) if k < len(cells) else None
                if number is None:
                    raise self._no_number(line, name, cells)
                values.append(number)
        table = np.frombuffer(values).reshape(-1, len(self.columns))
        return {name: np.ascontiguousarray(table[:, k]) for k, name in enumerate(self.columns)}

    def number_text(self, cell: str) -> str:
        """Return a cell with a decimal point instead of a comma that does not separate cells."""
        has_comma = self.separator != "," and _DECIMAL_COMMA.fullmatch(cell)
        return cell.replace(",", ".") if has_comma else cell

    def without(self, missing: Sequence[str], hint: str) -> RecordError:
        """Return the error E3603 for missing columns."""
        header = shortened(self.lines[self.header].strip().lstrip(COMMENT).strip())
        what = f": no column {' and no '.join(missing)} in {header}"
        return self.error(self.header + 1, what, hint, "E3603")

    def _no_number(self, line: int, name: str, cells: Sequence[str]) -> RecordError:
        k = self.columns[name]
        if k >= len(cells):
            more = any(map(str.strip, self.lines[line:]))
            ends = (
                "Complete or delete the row." if more else "The file ends within a row: delete its last line."
            )
            return self._of_width(line, len(cells), ends)
        found = f"{_text(cells[k])!r} is no number" if cells[k].strip() else "the cell is empty"
        hint = "Correct or delete the row; numbers are written like -12.5 or 1.25e-3."
        return self.error(line, f", column {name}: {found}", hint, cell=k)

    def _of_width(self, line: int, cells: int, hint: str) -> RecordError:
        return self.error(line, f": {plural(cells, 'cell')} under a header of {len(self.names)}", hint)

    def error(self, line: int, what: str, hint: str, code: str = "E3604", cell: int = 0) -> RecordError:
        """Return an error at a line, from 1, or at one of its cells after the first."""
        text = self.lines[line - 1]
        start, end = 0, len(text)
        if cell:
            between = rf"(?:^|(?<={self.separator}))[^{self.separator}]*"
            pattern = r"\S+" if self.separator == BLANKS else between
            start, end = [one.span() for one in re.finditer(pattern, text)][cell]
        where = Location(self.name, line, start + 1, max(1, end - start), text)
        return RecordError(f"{self.name}, line {line}{what}.", hint=hint, code=code, where=where)


def read_table(path: Path, wanted: Sequence[str]) -> Table:
    """Find the table in a file as `table_of` does. Raises RecordError E3602, also if the file cannot be read."""
    try:
        content = read_bytes(path)
    except OSError as error:
        message, hint = f"Cannot read {path}: {error.strerror}.", "Check the path and its permissions."
        raise RecordError(message, hint=hint, code="E3602") from None
    return table_of(text_of(path, content), str(path), wanted)


def table_of(text: str, name: str, wanted: Sequence[str]) -> Table:
    """Find the table in a text by the wanted columns, or by the first line of numbers.

    Raises RecordError: E3602 the text is empty or has no header, E3603 a wanted name heads two columns.
    """
    lines = text.split("\n")
    if (longest := max(map(len, lines))) > LONGEST_LINE:
        message = f"{name} has a line of {longest} characters."
        raise RecordError(message, hint="Give a row per sample.", code="E3602")
    header = _header(lines, name, wanted)
    separator, names, columns = _names(lines[header], wanted)
    lines[header + 1 :] = ["" if line.startswith(COMMENT) else line for line in lines[header + 1 :]]
    filled = (k for k in range(header + 1, len(lines)) if lines[k].strip())
    begin = next((k for k in filled if not _are_units(cells_of(lines[k], separator), columns)), len(lines))
    first = "".join(lines[begin : begin + 1]).partition(COMMENT)[0].strip()
    fitting = [one for one in SEPARATORS if len(cells_of(first, one)) == len(names)]
    if fitting and separator not in first:
        separator = fitting[0]
    table = Table(name, lines, header, begin, names, separator, columns)
    plain = [_plain(one) for one in names]
    if twice := next((one for one in columns if plain.count(_plain(one)) > 1), None):
        hint = "Keep one, or give the other another name."
        raise table.error(header + 1, f": two columns are called {twice}", hint, "E3603")
    return table


def read_delimited(path: Path, content: bytes, needed: Sequence[str] = WANTED) -> dict[str, Array]:
    """Read the needed columns, shape (n,) each.

    Raises RecordError with line and column: E3602 no table, E3603 columns, E3604 a cell or row, E3605 no rows.
    """
    table = table_of(text_of(path, content), str(path), needed)
    if missing := [name for name in needed if name not in table.columns]:
        raise table.without(missing, columns_hint(missing))
    values = replace(table, lines=[line.partition(COMMENT)[0] for line in table.lines]).numbers()
    if (rows := len(values[needed[0]])) < 2:
        message, hint = f"{path} holds {plural(rows, 'row')} of numbers.", "Give a row per sample."
        raise RecordError(message, hint=hint, code="E3605")
    return values


def _header(lines: Sequence[str], name: str, wanted: Sequence[str]) -> int:
    """Return the index of the line above the first numbers with most of the wanted names, else of the last one."""
    filled = [k for k, line in enumerate(lines) if line.strip() and not line.startswith("sep=")]
    plain = [k for k in filled if not lines[k].startswith(COMMENT)]
    above = list(takewhile(lambda k: not _is_numeric(lines[k]), filled[:MOST_PREAMBLE]))
    if not plain or not above:
        what = "has no header: its first line holds numbers" if plain else "is empty"
        what = "holds comments only" if filled and not plain else what
        raise RecordError(f"{name} {what}.", hint="Name the columns in a line above the rows.", code="E3602")
    best = max(above, key=lambda k: len(_names(lines[k], wanted)[2]))
    if _names(lines[best], wanted)[2]:
        return best
    if len(above) == len(filled):
        return plain[0]
    has_units = len(above) > 1 and all(map(_UNIT.fullmatch, _words(lines[above[-1]])))
    return above[-2] if has_units else above[-1]


def _names(line: str, wanted: Sequence[str]) -> tuple[str, list[str], dict[str, int]]:
    """Return the separator of a header, its names, and the wanted columns among them."""
    if line.lstrip().startswith(COMMENT):
        line = line.strip().lstrip(COMMENT).strip()
    tried = [(one, names := cells_of(line, one), find_columns(names, wanted)) for one in SEPARATORS]
    return max(tried, key=lambda one: len(one[2]))


def _is_numeric(line: str) -> bool:
    words = _words(line)
    return len(words) > 1 and None not in map(number_of, words)


def _words(line: str) -> list[str]:
    """Return what any separator separates, without a comment behind it."""
    return re.split(r"[\s;,]+", line.partition(COMMENT)[0].strip("\t ,;"))


def cells_of(line: str, separator: str) -> list[str]:
    """Return the cells of a line, without quotes and blanks around them; empty ones at the end are left out."""
    if separator == BLANKS:
        return line.split()
    try:
        cells = next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    except csv.Error:
        cells = line.split(separator)
    return [_text(cell) for cell in cells[: _filled(cells)]]


def _filled(cells: Sequence[str]) -> int:
    """Return the count of cells up to the last one that is not blank."""
    return max((k for k, cell in enumerate(cells, 1) if cell.strip()), default=0)


def _text(cell: str) -> str:
    return plain_text(cell.strip())


def _plain(name: str) -> str:
    return name.strip().strip("\"'").replace("µ", "u").replace("μ", "u").lower()


def _are_units(cells: Sequence[str], columns: Mapping[str, int]) -> bool:
    """Whether cells under the header repeat the units of its columns."""
    return bool(columns) and all(
        k < len(cells) and _plain(cells[k].strip("()[]")) == _plain(name.rpartition("_")[2])
        for name, k in columns.items()
    )


_OWN_TEXTS = (
    (
        b'schema = "edmctl-calibration',
        "a calibration",
        "Name it with --calibration; --from takes measured data.",
    ),
    (
        b'schema = "edmctl-drift',
        "a drift file",
        "Name it in the setup (drift.file); --from takes measured data.",
    ),
    (b'{"v":', "a ledger or journal of edmctl", "Give the run file beside it (.h5)."),
)
"""Texts that edmctl writes itself, by how they begin."""


def text_of(path: Path, content: bytes) -> str:
    """Return the text of a file, with line feeds alone. Raises RecordError E3602 for what is no table."""
    for begins, what, hint in _OWN_TEXTS:
        if content.lstrip().startswith(begins):
            raise RecordError(f"{path} is {what}, no measured record.", hint=hint, code="E3602")
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        hint = "Save it as CSV in UTF-8 or ASCII."
        raise RecordError(f"{path} is text in UTF-16.", hint=hint, code="E3602")
    if b"\0" in content[:4096]:
        hint = "Export a spreadsheet as CSV."
        raise RecordError(f"{path} is neither text nor HDF5.", hint=hint, code="E3602")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    return text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text
