"""Columns out of text: CSV as loggers, spreadsheets, oscilloscopes and numpy write it.

Tabs, semicolons, commas or blanks separate the cells; decimal commas are read unless commas separate. The header is
the first line that names the needed columns, with or without `#`. Lines above it are ignored. A line of units below
it must agree with the names.

A column is called by its quantity and unit: t_s, u_V, y_um. Case and the two Unicode letters µ make no difference.
"""

from __future__ import annotations

import csv
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from edmctl.csv_text import plain_text
from edmctl.errors import Location, RecordError
from edmctl.files import read_bytes
from edmctl.wording import plural

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

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

SEPARATORS = ("\t", ";", ",")
BLANKS = " "
COMMENT = "#"
MOST_PREAMBLE = 1000
"""Lines above a header; oscilloscopes write some twenty."""
LONGEST_LINE = 100_000
LONGEST_SHOWN = 200
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+(?:[eE][+-]?\d+)?")


def find_columns(names: Sequence[str], needed: Sequence[str] = WANTED) -> dict[str, int]:
    """Return the index in `names` of each needed column; missing ones are left out.

    A table that `edmctl run export` wrote has all of them under other names.
    """
    plain = [_plain(name) for name in names]
    exported = [EXPORTED.get(wanted) for wanted in needed]
    if all(name in plain for name in exported):
        return {wanted: plain.index(name) for wanted, name in zip(needed, exported, strict=True) if name}
    return {wanted: plain.index(_plain(wanted)) for wanted in needed if _plain(wanted) in plain}


def columns_hint(needed: Sequence[str]) -> str:
    """Return the hint that names the needed columns and their units."""
    return f"Needed: {', '.join(f'{name} ({MEANINGS[name]})' for name in needed)}. Other columns are ignored."


def shortened(text: str) -> str:
    """Return a text that a message has room for."""
    return text if len(text) <= LONGEST_SHOWN else f"{text[:LONGEST_SHOWN]}…"


def _plain(name: str) -> str:
    return name.strip().strip("\"'").replace("µ", "u").replace("μ", "u").lower()


def cells_of(line: str, separator: str) -> list[str]:
    """Return the cells of a line, without quotes and blanks around them; empty ones at the end are left out."""
    if separator == BLANKS:
        return line.split()
    try:
        return _filled(next(csv.reader([line], delimiter=separator, skipinitialspace=True), []))
    except csv.Error:
        return _filled(line.split(separator))


def _filled(cells: Sequence[str]) -> list[str]:
    stripped = [plain_text(cell.strip()) for cell in cells]
    return stripped[: max((k for k, cell in enumerate(stripped, 1) if cell), default=0)]


def number_of(cell: str, *, decimal_commas: bool = False) -> float | None:
    """Return the number in a cell; None if it is none, or only Python reads it as one, such as 0_2."""
    try:
        return None if "_" in cell else float(cell.replace(",", ".") if decimal_commas else cell)
    except ValueError:
        return None


# --- numbers -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Header:
    index: int
    """Of its line, from 0."""
    separator: str
    names: list[str]


def read_delimited(path: Path, content: bytes, needed: Sequence[str] = WANTED) -> dict[str, Array]:
    """Read the needed columns, shape (n,) each.

    Raises RecordError with line and column: E3602 no table, E3603 columns, E3604 a cell or row, E3605 no rows.
    """
    lines = text_of(path, content).split("\n")
    if (longest := max(map(len, lines))) > LONGEST_LINE:
        message = f"{path} has a line of {longest} characters."
        raise RecordError(message, hint="Give a row per sample.", code="E3602")
    header = _header(lines, needed) or _refuse_header(path, lines, needed)
    columns = find_columns(header.names, needed)
    plain = [_plain(name) for name in header.names]
    if twice := next((name for name in needed if plain.count(_plain(name)) > 1), None):
        where = _place(path, lines, header.index)
        message, hint = f"{path} has the column {twice} twice.", "Keep one, and give the other another name."
        raise RecordError(message, hint=hint, code="E3603", where=where)
    begin = header.index + 1
    while begin < len(lines) and (
        not _cut(lines[begin]) or _are_units(cells_of(lines[begin], header.separator), columns)
    ):
        begin += 1
    width = len(header.names)
    first = _cut(lines[begin]) if begin < len(lines) else ""
    fitting = [one for one in (header.separator, *SEPARATORS, BLANKS) if len(cells_of(first, one)) == width]
    separator = fitting[0] if fitting else header.separator
    rows = lines[begin:]
    if separator != "," and any("," in row for row in rows):
        rows = [row.replace(",", ".") for row in rows]
    try:
        values = _load(rows, separator, list(columns.values()))
        if separator == BLANKS:
            cells = sum(len(row.split()) for row in rows)
        else:
            cells = sum(row.count(separator) for row in rows) + len(values)
        if cells != len(values) * width:
            _check_rows(path, lines, begin, header.names, columns, separator)
    except ValueError as error:
        _check_rows(path, lines, begin, header.names, columns, separator)
        hint = "Write numbers like -12.5 or 1.25e-3, without quotes."
        raise RecordError(f"{path} is no table of numbers: {error}.", hint=hint, code="E3604") from None
    if len(values) < 2:
        message, hint = f"{path} holds {plural(len(values), 'row')} of numbers.", "Give a row per sample."
        raise RecordError(message, hint=hint, code="E3605")
    return {name: np.ascontiguousarray(values[:, k]) for k, name in enumerate(columns)}


def _header(lines: Sequence[str], needed: Sequence[str]) -> _Header | None:
    for index, line in enumerate(lines[:MOST_PREAMBLE]):
        for separator in (*SEPARATORS, BLANKS):
            names = cells_of(line.strip().lstrip(COMMENT).strip(), separator)
            if len(find_columns(names, needed)) == len(needed):
                return _Header(index, separator, names)
    return None


def _refuse_header(path: Path, lines: Sequence[str], needed: Sequence[str]) -> _Header:
    """Raise RecordError: E3602 without a table, E3603 with the names above the first numbers."""
    told = [index for index, line in enumerate(lines) if _cut(line)][:MOST_PREAMBLE]
    above = list(takewhile(lambda index: not _is_numeric(lines[index]), told))
    hint = columns_hint(needed)
    if not told:
        message = f"{path} {'holds comments only' if any(map(str.strip, lines)) else 'is empty'}."
        raise RecordError(message, hint=hint, code="E3602")
    index = (above or told)[-1] if len(above) < len(told) else above[0]
    if not above:
        commented = [k for k in range(told[0]) if lines[k].strip()]
        if not commented:
            message = f"{path} has no header: its first line holds numbers."
            raise RecordError(message, hint=hint, code="E3602", where=_place(path, lines, told[0]))
        index = commented[-1]
    names = lines[index].strip().lstrip(COMMENT).strip()
    found = max((find_columns(cells_of(names, one), needed) for one in (*SEPARATORS, BLANKS)), key=len)
    missing = [name for name in needed if name not in found]
    raise RecordError(
        f"{path}, line {index + 1}: no column {' and no '.join(missing)} in {shortened(names)}.",
        hint=columns_hint(missing),
        code="E3603",
        where=_place(path, lines, index),
    )


def _cut(line: str) -> str:
    """Return a line without its comment."""
    return line.partition(COMMENT)[0].strip()


def _is_numeric(line: str) -> bool:
    rows = (cells_of(_cut(line), separator) for separator in (*SEPARATORS, BLANKS))
    return any(
        cells and all(number_of(cell, decimal_commas=True) is not None for cell in cells) for cells in rows
    )


def _are_units(cells: Sequence[str], columns: Mapping[str, int]) -> bool:
    """Whether cells under the header repeat the units of its columns."""
    return all(
        k < len(cells) and _plain(cells[k].strip("()[]")) == _plain(name.rpartition("_")[2])
        for name, k in columns.items()
    )


def _load(rows: Sequence[str], separator: str, columns: list[int]) -> Array:
    delimiter = None if separator == BLANKS else separator
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "loadtxt: input contained no data", UserWarning)
        return np.loadtxt(
            rows, delimiter=delimiter, usecols=columns, comments=COMMENT, quotechar='"', ndmin=2
        )


def _check_rows(
    path: Path,
    lines: Sequence[str],
    begin: int,
    names: Sequence[str],
    columns: Mapping[str, int],
    separator: str,
) -> None:
    """Raise RecordError E3604 for the first row that is not one of numbers."""
    rows = [index for index in range(begin, len(lines)) if _cut(lines[index])]
    for index in rows:
        cells, where = cells_of(_cut(lines[index]), separator), _place(path, lines, index)
        if len(cells) > len(names):
            raise _too_wide(str(path), index + 1, len(cells), len(names), separator, where)
        if len(cells) <= max(columns.values()):
            hint = "The file ends within a row: delete its last line."
            message = (
                f"{path}, line {index + 1}: {plural(len(cells), 'cell')} under a header of {len(names)}."
            )
            hint = hint if index == rows[-1] else "Complete or delete the row."
            raise RecordError(message, hint=hint, code="E3604", where=where)
        for name, k in columns.items():
            if number_of(cells[k], decimal_commas=separator != ",") is None:
                found = f"{cells[k]!r} is no number" if cells[k] else "the cell is empty"
                message = f"{path}, line {index + 1}, column {name}: {found}."
                hint = "Correct or delete the row; numbers are written like -12.5 or 1.25e-3."
                where = _place(path, lines, index, k, separator)
                raise RecordError(message, hint=hint, code="E3604", where=where)


def _place(path: Path, lines: Sequence[str], index: int, cell: int = 0, separator: str = "") -> Location:
    """Return the location of a line, or of one of its cells after the first."""
    line = lines[index]
    if not cell:
        return Location(str(path), index + 1, 1, max(1, len(line)), line)
    if separator == BLANKS:
        start, end = [one.span() for one in re.finditer(r"\S+", line)][cell]
    else:
        parts = line.split(separator)
        start = sum(len(part) + 1 for part in parts[:cell])
        end = start + len(parts[cell])
    return Location(str(path), index + 1, start + 1, max(1, end - start), line)


def _too_wide(
    name: str, number: int, cells: int, columns: int, separator: str, where: Location | None = None
) -> RecordError:
    hint = "Delete the cells beyond the last column, or give them a name."
    if separator == ",":
        hint = "Write numbers with a decimal point, separate columns by semicolons, or name each column."
    message = f"{name}, line {number}: {plural(cells, 'cell')} under a header of {columns}."
    return RecordError(message, hint=hint, code="E3604", where=where)


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


# --- texts -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class TextTable:
    """A table of texts: its columns, and each row by column with the number of its line."""

    names: tuple[str, ...]
    rows: tuple[tuple[int, dict[str, str]], ...]
    decimal_commas: bool
    """Whether a comma within a cell is a decimal one, because another character separates the cells."""

    def number_text(self, cell: str) -> str:
        """Return a cell with a decimal point."""
        return cell.replace(",", ".") if self.decimal_commas and _DECIMAL_COMMA.fullmatch(cell) else cell


def read_texts(path: Path, needed: Sequence[str] = ()) -> TextTable:
    """Read a table of texts as `texts_of` does. Raises RecordError E3602 for what is no text, E3603 and E3604."""
    try:
        content = read_bytes(path)
    except OSError as error:
        message, hint = f"Cannot read {path}: {error.strerror}.", "Check the path and its permissions."
        raise RecordError(message, hint=hint, code="E3602") from None
    return texts_of(text_of(path, content), str(path), needed)


def texts_of(text: str, name: str = "table", needed: Sequence[str] = ()) -> TextTable:
    """Return the table in a text. Its header is the first line with the needed columns, else the first with cells.

    A row may end before its last columns. Raises RecordError with the line: E3603 a name heads two columns, E3604 a
    cell has no name above it.
    """
    lines = text.lstrip("\ufeff").splitlines()
    filled = [index for index, line in enumerate(lines) if line.strip() and not line.startswith("sep=")]
    if not filled:
        return TextTable((), (), decimal_commas=False)
    with_all = (k for k in filled if any(set(needed) <= {*cells_of(lines[k], one)} for one in SEPARATORS))
    header = next(with_all, filled[0])
    separator = max((",", ";", "\t"), key=lines[header].count)
    names = cells_of(lines[header], separator)
    if twice := next((one for one in names if one and names.count(one) > 1), None):
        hint = "Keep one, or give the other another name."
        message = f"{name}, line {header + 1}: two columns are called {twice}."
        raise RecordError(message, hint=hint, code="E3603")
    rows = []
    reader = csv.reader(
        [f"{line}\n" for line in lines[header + 1 :]], delimiter=separator, skipinitialspace=True
    )
    try:
        for row in reader:
            line, cells = header + 1 + reader.line_num, _filled(row)
            if len(cells) > len(names):
                raise _too_wide(name, line, len(cells), len(names), separator)
            if cells:
                padded = cells + [""] * (len(names) - len(cells))
                rows.append((line, dict(zip(names, padded, strict=True))))
    except csv.Error as wrong:
        hint = "Look for a quotation mark that is not closed."
        message = f"{name}, line {header + 1 + reader.line_num}: {wrong}."
        raise RecordError(message, hint=hint, code="E3604") from None
    return TextTable(tuple(names), tuple(rows), separator != ",")
