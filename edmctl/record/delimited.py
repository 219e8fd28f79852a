"""The columns of a measured record out of a text: CSV as loggers, spreadsheets and numpy write it.

Commas, semicolons or tabs between the cells; with the latter two also decimal commas. Lines that begin with #
are comments; the header may be one, as `numpy.savetxt` writes it. The table is read at once, by numpy; only
when that fails is it gone through line by line, to say where.

A column is called by its quantity and unit: t_s, u_V, y_um. Upper and lower case and the two Unicode letters µ
make no difference; everything else does, because a wrong unit would be fitted without complaint.
"""

from __future__ import annotations

import csv
import io
import re
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from edmctl.csv_text import plain_text
from edmctl.errors import Location, RecordError
from edmctl.files import read_bytes

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

TIME, VOLTAGE, DISPLACEMENT = "t_s", "u_V", "y_um"
STACK, TOOL = "x_um", "z_um"
LONGEST_TOLD = 200


@dataclass(frozen=True, slots=True)
class _Quantity:
    """A column that is needed, what others call it, and the factor from other units."""

    meaning: str
    also_called: frozenset[str]
    factors: Mapping[str, float]


WANTED: Mapping[str, _Quantity] = {
    TIME: _Quantity(
        "time in s",
        frozenset({"t", "time", "times", "timestamp", "seconds", "elapsed"}),
        {"s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0, "h": 3600.0},
    ),
    VOLTAGE: _Quantity(
        "actuator voltage in V",
        frozenset({"u", "v", "voltage", "volt", "volts", "vin", "input", "drive"}),
        {"v": 1.0, "volt": 1.0, "volts": 1.0, "mv": 1e-3, "kv": 1e3},
    ),
    DISPLACEMENT: _Quantity(
        "tool displacement in µm",
        frozenset({"y", "z", "x", "displacement", "disp", "position", "pos", "stroke", "output", "sensor"}),
        {"um": 1.0, "micron": 1.0, "microns": 1.0, "mm": 1e3, "nm": 1e-3, "m": 1e6, "cm": 1e4},
    ),
}

LEVER: Mapping[str, _Quantity] = {
    STACK: _Quantity(
        "stack displacement in µm", frozenset({"x", "stack", "stacks"}), WANTED[DISPLACEMENT].factors
    ),
    TOOL: _Quantity(
        "tool displacement in µm", frozenset({"z", "y", "tool", "tip"}), WANTED[DISPLACEMENT].factors
    ),
}
_QUANTITIES: Mapping[str, _Quantity] = {**WANTED, **LEVER}


EXPORTED = {TIME: "time_s", VOLTAGE: "v_cmd_v", DISPLACEMENT: "z_sensor_um"}
"""The same columns in the servo table that `edmctl run export` writes."""


def find_columns(names: Sequence[str], needed: Sequence[str] = tuple(WANTED)) -> dict[str, int]:
    """Where each needed column stands among `names`; those that are not there are left out.

    A table that `edmctl run export` wrote has all of them under other names.
    """
    plain = [_plain(name) for name in names]
    exported = [EXPORTED.get(wanted) for wanted in needed]
    if all(name in plain for name in exported):
        return {wanted: plain.index(name) for wanted, name in zip(needed, exported, strict=True) if name}
    return {wanted: plain.index(_plain(wanted)) for wanted in needed if _plain(wanted) in plain}


def repeated(names: Sequence[str]) -> str | None:
    """Return a wanted column that stands there twice, if there is one."""
    plain = [_plain(name) for name in names]
    return next((wanted for wanted in _QUANTITIES if plain.count(_plain(wanted)) > 1), None)


def advice(names: Sequence[str], needed: Sequence[str] = tuple(WANTED)) -> str:
    """Say for every needed column that is missing which of `names` it may be, and how to convert it."""
    found = find_columns(names, needed)
    missing = [wanted for wanted in needed if wanted not in found]
    free = [name for k, name in enumerate(names) if k not in found.values() and name.strip()]
    said = []
    for wanted in missing:
        near = _nearest(wanted, free)
        if near is None:
            said.append(f"Name the column of the {_QUANTITIES[wanted].meaning} {wanted}.")
        else:
            free.remove(near)
            said.append(_conversion(near, wanted))
    return " ".join(said)


def shortened(text: str) -> str:
    """Return a text that a message has room for."""
    return text if len(text) <= LONGEST_TOLD else f"{text[:LONGEST_TOLD]}…"


def _plain(name: str) -> str:
    return name.strip().strip("\"'").replace("µ", "u").replace("μ", "u").lower()


def _parts(name: str) -> tuple[str, str]:
    """Quantity and unit of a name: `Displacement (mm)`, `u_mV`, `time[ms]`; the unit may be missing."""
    words = [word for word in re.split(r"[\s_()\[\]/,.-]+", _plain(name)) if word]
    if not words:
        return "", ""
    return words[0], words[-1] if len(words) > 1 else ""


def _nearest(wanted: str, names: Sequence[str]) -> str | None:
    quantity = _QUANTITIES[wanted]
    same = [name for name in names if _parts(name)[0] in quantity.also_called]
    if not same:
        same = [name for name in names if _parts(name)[1] in quantity.factors]
    return same[0] if same else None


def _conversion(name: str, wanted: str) -> str:
    factor = _QUANTITIES[wanted].factors.get(_parts(name)[1])
    if factor is None:
        return f"If {name} is the {_QUANTITIES[wanted].meaning}, rename it to {wanted}."
    if factor == 1.0:
        return f"Rename {name} to {wanted}."
    return f"Multiply {name} by {factor:.10g} and rename it to {wanted}."


@dataclass(frozen=True, slots=True)
class TextTable:
    """A table of texts as people make it: its columns, and each row by them with the number of its line."""

    names: tuple[str, ...]
    rows: tuple[tuple[int, dict[str, str]], ...]
    decimal_commas: bool
    """Whether a comma within a cell is a decimal one, because something else stands between the cells."""

    def number_text(self, cell: str) -> str:
        """Return a cell with a decimal point."""
        return cell.replace(",", ".") if self.decimal_commas and _DECIMAL_COMMA.fullmatch(cell) else cell


_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+(?:[eE][+-]?\d+)?")


def read_texts(path: Path) -> TextTable:
    """Read a table of texts; one without a header has no columns.

    Raises RecordError: E3602 for what is no text, E3603 and E3604 as `texts_of` does.
    """
    try:
        content = read_bytes(path)
    except OSError as error:
        message, hint = f"Cannot read {path}: {error.strerror}.", "Check the path and its permissions."
        raise RecordError(message, hint=hint, code="E3602") from None
    try:
        text = _text(path, content)
    except RecordError as error:
        hint = "Name a table that is saved as CSV."
        raise RecordError(error.message, hint=hint, code="E3602") from None
    return texts_of(text, str(path))


def texts_of(text: str, name: str = "table") -> TextTable:
    """Return the table of texts that a text holds; a row may end before its last columns.

    Raises RecordError with the line: E3603 a name heads two columns, E3604 a cell stands under no name.
    """
    lines = text.lstrip("\ufeff").splitlines(keepends=True)
    header = next((number for number, line in enumerate(lines) if line.strip()), len(lines))
    separator = _separator(lines[header]) if header < len(lines) else ","
    reader = csv.reader(lines[header:], delimiter=separator, skipinitialspace=True)
    try:
        return _text_table(reader, header, separator, name)
    except csv.Error as wrong:
        raise RecordError(
            f"{name}, line {header + reader.line_num}: {wrong}.",
            hint="Look for a quotation mark that is not closed.",
            code="E3604",
        ) from None


def _text_table(reader: Any, header: int, separator: str, name: str) -> TextTable:
    names = _filled(next(reader, []))
    if twice := next((one for one in names if one and names.count(one) > 1), None):
        raise RecordError(
            f"{name}, line {header + 1}: two columns are called {twice}.",
            hint="Keep one, or give the other another name.",
            code="E3603",
        )
    rows = []
    for row in reader:
        line, cells = header + reader.line_num, _filled(row)
        if len(cells) > len(names):
            raise _too_wide(name, line, len(cells), len(names), separator)
        if cells:
            padded = cells + [""] * (len(names) - len(cells))
            rows.append((line, dict(zip(names, padded, strict=True))))
    return TextTable(tuple(names), tuple(rows), separator != ",")


def _filled(row: Sequence[str]) -> list[str]:
    """Cells up to the last one with something in it."""
    cells = [plain_text(cell.strip()) for cell in row]
    while cells and not cells[-1]:
        cells.pop()
    return cells


SEPARATORS = (",", ";", "\t")
COMMENT = "#"
EXAMPLE = "t_s,u_V,y_um"


@dataclass(frozen=True, slots=True)
class _Table:
    """A text, its header, and what follows it."""

    path: Path
    names: list[str]
    separator: str
    header_line: int
    body: str
    body_line: int
    """Number of the body's first line; the header stands before it."""

    def place(self, number: int, line: str, cell: int | None = None) -> Location:
        """Location of a line, or of one of its cells."""
        cells = line.split(self.separator)
        if cell is None or cell >= len(cells):
            return Location(str(self.path), number, 1, max(1, len(line)), line)
        start = sum(len(text) + 1 for text in cells[:cell])
        return Location(str(self.path), number, start + 1, max(1, len(cells[cell])), line)


def read_delimited(path: Path, content: bytes, needed: Sequence[str] = tuple(WANTED)) -> dict[str, Array]:
    """Return the columns t_s, u_V and y_um (or those `needed`), shape (n,), of the file `path` with that `content`.

    Raises RecordError with the line: E3602 no table, E3603 columns, E3604 a cell or row, E3605 no rows.
    """
    table = _table(path, _text(path, content))
    columns = _columns(table, needed)
    decimal_commas = table.separator != "," and "," in table.body
    # Such a comma is a decimal one, or stands in a column that nobody reads.
    body = table.body.replace(",", ".") if decimal_commas else table.body
    try:
        values = _load(body, table.separator, list(columns.values()))
    except ValueError as error:
        raise (
            _first_fault(table, columns, decimal_commas=decimal_commas) or _unexplained(table, error)
        ) from None
    if body.count(table.separator) != len(values) * (len(table.names) - 1):
        # Cells too many or too few somewhere; or a separator in a comment or between quotes.
        fault = _first_fault(table, columns, decimal_commas=decimal_commas)
        if fault is not None:
            raise fault
    if len(values) < 2:
        raise RecordError(
            f"{path} holds {_count(len(values), 'row')} of numbers.",
            hint="Give a record with a row per sample under its header.",
            code="E3605",
        )
    return {name: np.ascontiguousarray(values[:, k]) for k, name in enumerate(columns)}


_OWN_TEXTS = (
    (
        b'schema = "edmctl-calibration',
        "a calibration",
        "Name it with --calibration; --from takes what was measured.",
    ),
    (
        b'schema = "edmctl-drift',
        "a drift file",
        "Name it in the setup (drift.file); --from takes what was measured.",
    ),
    (b'{"v":', "a ledger or journal of edmctl", "Give the run file beside it (.h5)."),
)
"""Texts that edmctl writes itself, by how they begin."""


def _load(body: str, separator: str, columns: list[int]) -> Array:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "loadtxt: input contained no data", UserWarning)
        return np.loadtxt(
            io.StringIO(body), delimiter=separator, usecols=columns, comments=COMMENT, quotechar='"', ndmin=2
        )


def _text(path: Path, content: bytes) -> str:
    for begins, what, hint in _OWN_TEXTS:
        if content.lstrip().startswith(begins):
            raise RecordError(f"{path} is {what}, no measured record.", hint=hint, code="E3602")
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        hint = "Save it as CSV in UTF-8 or ASCII."
        raise RecordError(f"{path} is text in UTF-16.", hint=hint, code="E3602")
    if b"\0" in content[:4096]:
        raise RecordError(
            f"{path} is neither text nor HDF5.",
            hint=f"A spreadsheet is exported as CSV, with the header {EXAMPLE}.",
            code="E3602",
        )
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    return text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text


def _table(path: Path, text: str) -> _Table:
    """Find the header: the first line that is no comment, or the last comment above the first numbers."""
    start, number, comment = 0, 1, (0, "")
    while True:
        if start >= len(text):
            what = "holds comments only" if comment[1] else "is empty"
            hint = f"Give a record with the header {EXAMPLE} and a row per sample."
            raise RecordError(f"{path} {what}.", hint=hint, code="E3602")
        end = text.find("\n", start)
        end = len(text) if end < 0 else end
        line = text[start:end]
        if line.lstrip().startswith(COMMENT):
            comment = (number, line.strip().lstrip(COMMENT).strip())
        elif line.strip():
            break
        start, number = end + 1, number + 1
    separator = _separator(line)
    if not _is_numeric(line, separator):
        return _Table(path, _cells(line, separator), separator, number, text[end + 1 :], number + 1)
    names = _cells(comment[1], _separator(comment[1]))
    if find_columns(names):
        return _Table(path, names, separator, comment[0], text[start:], number)
    raise RecordError(
        f"{path} has no header: its first line holds numbers.",
        hint=f"Put a line with the names of the columns above them: {EXAMPLE} (seconds, volts, micrometres).",
        code="E3602",
        where=Location(str(path), number, 1, max(1, len(line)), line),
    )


def _separator(line: str) -> str:
    """The separator that occurs most often; of equals the comma."""
    return max(SEPARATORS, key=line.count)


def _cells(line: str, separator: str) -> list[str]:
    try:
        cells = next(csv.reader([line], delimiter=separator), [])
    except csv.Error:
        cells = line.split(separator)
    return [cell.strip() for cell in cells]


def _is_numeric(line: str, separator: str) -> bool:
    words = [word for cell in _cells(line, separator) for word in cell.split()]
    return all(number_of(word, decimal_commas=True) is not None for word in words)


def number_of(cell: str, *, decimal_commas: bool = False) -> float | None:
    """Return a number as tables have it; None for what is none, and for what only Python takes, such as 0_2."""
    try:
        return None if "_" in cell else float(cell.replace(",", ".") if decimal_commas else cell)
    except ValueError:
        return None


def _columns(table: _Table, needed: Sequence[str]) -> dict[str, int]:
    """Where the needed columns stand. Raises RecordError E3603 with what others may be."""
    header = shortened(", ".join(table.names))
    line = table.separator.join(table.names)
    where = Location(str(table.path), table.header_line, 1, max(1, len(line)), line)
    columns = find_columns(table.names, needed)
    twice = repeated(table.names)
    if twice is not None:
        message, hint = (
            f"{table.path} has the column {twice} twice.",
            "Keep one, and give the other another name.",
        )
        raise RecordError(message, hint=hint, code="E3603", where=where)
    if len(columns) == len(needed):
        return columns
    missing = [name for name in needed if name not in columns]
    if len(table.names) == 1 and find_columns(table.names[0].split()):
        hint = f"Its columns are separated by spaces; separate them by commas: {EXAMPLE}."
    else:
        hint = advice(table.names, needed)
    raise RecordError(
        f"{table.path} has no column {' and no '.join(missing)}; its header reads {header}.",
        hint=hint,
        code="E3603",
        where=where,
    )


def _first_fault(table: _Table, columns: dict[str, int], *, decimal_commas: bool) -> RecordError | None:
    """The first row that is no row of numbers; None where all are."""
    lines = table.body.split("\n")
    while lines and not lines[-1].strip():
        lines.pop()
    for k, line in enumerate(lines):
        content = line.partition(COMMENT)[0]
        if not content.strip():
            continue
        number, cells = table.body_line + k, _cells(content, table.separator)
        if len(cells) < len(table.names) or any(cells[len(table.names) :]):
            return _ragged(table, number, line, len(cells), is_last=k == len(lines) - 1)
        for name, index in columns.items():
            if number_of(cells[index], decimal_commas=decimal_commas) is None:
                return _no_number(table, number, line, name, cells, index)
    return None


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _ragged(table: _Table, number: int, line: str, cells: int, *, is_last: bool) -> RecordError:
    where = table.place(number, line)
    if cells > len(table.names):
        return _too_wide(str(table.path), number, cells, len(table.names), table.separator, where)
    return RecordError(
        f"{table.path}, line {number}: {_count(cells, 'cell')} under a header of {len(table.names)}.",
        hint="The file ends within a row: delete its last line."
        if is_last
        else "Complete or delete the row.",
        code="E3604",
        where=where,
    )


def _too_wide(
    name: str, number: int, cells: int, columns: int, separator: str, where: Location | None = None
) -> RecordError:
    hint = "Delete the cells beyond the last column, or give them a name."
    if separator == ",":
        hint = "Write numbers with a decimal point, separate columns by semicolons, or name each column."
    return RecordError(
        f"{name}, line {number}: {_count(cells, 'cell')} under a header of {columns}.",
        hint=hint,
        code="E3604",
        where=where,
    )


def _no_number(table: _Table, number: int, line: str, name: str, cells: list[str], index: int) -> RecordError:
    found = f"{cells[index]!r} is no number" if cells[index] else "the cell is empty"
    if number == table.body_line and all(number_of(cell, decimal_commas=True) is None for cell in cells):
        hint = "Only one line of names stands above the numbers: delete this one, or begin it with #."
    else:
        hint = "Correct or delete the row; numbers are written like -12.5 or 1.25e-3."
    return RecordError(
        f"{table.path}, line {number}, column {name}: {found}.",
        hint=hint,
        code="E3604",
        where=table.place(number, line, index),
    )


def _unexplained(table: _Table, error: ValueError) -> RecordError:
    return RecordError(
        f"{table.path} cannot be read as a table of numbers: {error}.",
        hint="Write numbers like -12.5 or 1.25e-3, without quotes, separated by commas.",
        code="E3604",
    )
