"""The tables of a run file as rows for other programs, block by block: CSV and JSON, and Parquet through pyarrow.

Columns are named with their units. Texts have every digit that is needed to read the same number again; a column is
formatted at a time. Parquet gets a row group per block, and the units in its metadata.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from edmctl import failures
from edmctl.csv_text import row_lines, text_cell
from edmctl.dataclasses import dataclass
from edmctl.errors import installing
from edmctl.record import layout
from edmctl.record.layout import Column
from edmctl.record.reader import RunFile, sites_of
from edmctl.results.declared import ending_of, quantities
from edmctl.results.job import SiteTruth

Block: TypeAlias = list[NDArray[np.generic]]

TABLES = {
    "servo": layout.SERVO,
    "slow": layout.SLOW,
    "pulses": layout.PULSES,
    "blocks": layout.PULSE_BLOCKS,
    "segments": layout.SEGMENTS,
    "events": layout.EVENTS,
    "touches": layout.TOUCHES,
    "results": layout.RESULTS,
    "black-box": layout.BLACK_BOX,
    "waveforms": layout.WAVEFORMS,
    "link": layout.LINK,
}
"""Every table under the name that people use."""
BLOCK_ROWS = 1 << 16
"""Rows that are in memory at a time, as text a hundred bytes a cell; a row group of Parquet."""
JSON_TEXT = "JSON"
"""Unit of a text that is a JSON value itself."""


@dataclass(frozen=True, slots=True)
class ExportColumn:
    """A column of an exported table: its unit is part of the name. `units` of a text are empty or JSON."""

    name: str
    dtype: np.dtype[np.generic]
    units: str
    long_name: str

    @property
    def is_text(self) -> bool:
        return self.dtype.kind == "O"


_TRUTH = quantities(SiteTruth)
"""Beside the results of simulated runs."""


class ExportTable:
    """One table of an open run file. Rows that a live writer adds meanwhile are left out.

    code_names : names of the events by their codes, which become a column of their own
    """

    def __init__(self, run: RunFile, name: str, code_names: Mapping[int, str]) -> None:
        self._run, self._table, self._code_names = run, TABLES[name], code_names
        self.name = name
        self.rows = run.rows(self._table.path)
        self.columns = [
            ExportColumn(named(column), _dtype(column), column.units.rpartition(" ")[2], column.long_name)
            for column in self._table.columns
        ]
        if self._table is layout.PULSES:
            self.columns.insert(0, ExportColumn("time_s", np.dtype("f8"), "s", "time since start"))
        if self._table is layout.EVENTS:
            self.columns.insert(3, ExportColumn("name", np.dtype("O"), "", "name of the code"))
            self.columns[-1] = ExportColumn("args", np.dtype("O"), JSON_TEXT, self.columns[-1].long_name)
        self._has_truth = self._table is layout.RESULTS and run.is_simulated
        for name_of_truth, one in _TRUTH.items() if self._has_truth else ():
            about = f"{one.title} on the virtual machine; NaN if unknown"
            kind = np.dtype(one.dtype)
            self.columns.append(ExportColumn(f"truth_{name_of_truth}", kind, one.units, about))

    def blocks(self) -> Iterator[Block]:
        """Yield the rows, a large number at a time: one array per column, texts as `str`."""
        path, columns = self._table.path, self._table.columns
        if not self._table.is_compound:
            for start in range(0, self.rows, BLOCK_ROWS):
                stop = min(start + BLOCK_ROWS, self.rows)
                block: Block = [self._run.column(path, column.name, start, stop) for column in columns]
                if self._table is layout.PULSES:
                    block.insert(0, self._run.pulse_times_s(start, stop))
                yield block
        elif len(rows := self._run.table(path)[: self.rows]):
            block = [_values(rows, column) for column in columns]
            if self._table is layout.EVENTS:
                names = [self._code_names.get(code, str(code)) for code in rows["code"].tolist()]
                block.insert(3, np.array(names, object))
            if self._has_truth:
                sites = sites_of(self._run)[: len(rows)]
                block += [np.array([getattr(site.truth, name) for site in sites]) for name in _TRUTH]
            yield block


def named(column: Column) -> str:
    """Return a column's name with its unit: `z_sensor_um`."""
    ending = ending_of(column.units.rpartition(" ")[2])
    return column.name if column.name.endswith(ending) else f"{column.name}{ending}"


def _dtype(column: Column) -> np.dtype[np.generic]:
    if column.dtype.startswith("S"):
        return np.dtype("O")
    return np.dtype("f4") if column.step != 1.0 else np.dtype(column.dtype)


def _values(rows: NDArray[np.void], column: Column) -> NDArray[np.generic]:
    """Return one field of a compound table; NaN, 0 or empty if the file has no such column."""
    kind = _dtype(column)
    if column.name not in (rows.dtype.names or ()):
        return np.full(len(rows), {"O": "", "f": np.nan}.get(kind.kind, 0), kind)
    values: NDArray[np.generic] = rows[column.name]
    if kind.kind == "O":
        return np.array([text.decode(errors="replace") for text in values.tolist()], object)
    return values


_SINGLE = "U15"
"""Text of a number of single precision; its longest is `-1.1754944e-38`."""


class ByteSink(Protocol):
    def write(self, data: bytes, /) -> int: ...


class TableWriter(Protocol):
    """Writes one table, block after block: one array per column. Raises OSError."""

    def write(self, block: Block) -> None: ...

    def close(self) -> None: ...


class CsvWriter:
    """CSV with a header; unknown numbers are empty."""

    def __init__(self, sink: ByteSink, columns: Sequence[ExportColumn]) -> None:
        self._sink, self._columns = sink, columns
        sink.write(row_lines([text_cell(column.name)] for column in columns).encode())

    def write(self, block: Block) -> None:
        cells = [
            list(map(text_cell, values.tolist())) if column.is_text else formatted(values, unknown="")
            for column, values in zip(self._columns, block, strict=True)
        ]
        self._sink.write(row_lines(cells).encode())

    def close(self) -> None:
        """Nothing follows the last row."""


class JsonWriter:
    """An array of objects, one a line; with `lines` the objects alone (JSON Lines). Unknown numbers are null."""

    def __init__(self, sink: ByteSink, columns: Sequence[ExportColumn], *, lines: bool) -> None:
        self._sink, self._columns = sink, columns
        self._before, self._between, self._end = ("", "\n", "\n") if lines else ("[\n", ",\n", "\n]\n")
        self._empty = "" if lines else "[]\n"
        self._has_rows = False
        members = (f"{json.dumps(column.name)}: %s" for column in columns)
        self._form = "{" + ", ".join(members) + "}"

    def write(self, block: Block) -> None:
        cells = [
            list(map(_json_value if column.units == JSON_TEXT else _json_text, values.tolist()))
            if column.is_text
            else formatted(values, unknown="null", infinite="null")
            for column, values in zip(self._columns, block, strict=True)
        ]
        rows = self._between.join(map(self._form.__mod__, zip(*cells, strict=True)))
        self._sink.write(((self._between if self._has_rows else self._before) + rows).encode())
        self._has_rows = True

    def close(self) -> None:
        self._sink.write((self._end if self._has_rows else self._empty).encode())


class ParquetWriter:
    """One table; call `need_pyarrow` first. Unknown numbers stay NaN; `about` becomes metadata of the file."""

    def __init__(self, sink: ByteSink, columns: Sequence[ExportColumn], about: Mapping[str, str]) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        columns_of_parquet = []
        for column in columns:
            kind = pa.string() if column.is_text else pa.from_numpy_dtype(column.dtype)
            metadata = {"units": column.units, "long_name": column.long_name}
            columns_of_parquet.append(pa.field(column.name, kind, metadata=metadata))
        self._schema = pa.schema(columns_of_parquet, metadata=dict(about))
        self._writer = pq.ParquetWriter(sink, self._schema, compression="zstd")

    def write(self, block: Block) -> None:
        import pyarrow as pa

        arrays = [pa.array(values, field.type) for values, field in zip(block, self._schema, strict=True)]
        self._writer.write_table(pa.Table.from_arrays(arrays, schema=self._schema))

    def close(self) -> None:
        """Write the footer."""
        self._writer.close()


def need_pyarrow() -> None:
    """Raise PreconditionError E8092 where pyarrow is not installed."""
    try:
        import pyarrow.parquet  # noqa: F401
    except ImportError:
        raise failures.pyarrow_missing(install=installing("pyarrow")) from None


def formatted(values: NDArray[np.generic], unknown: str, infinite: str | None = None) -> list[str]:
    """Return numbers as the shortest texts that are read back as the same numbers of their type."""
    if values.dtype.kind != "f":
        return list(map(str, values.tolist()))
    is_double = values.dtype.itemsize == 8
    texts: list[str] = list(map(repr, values.tolist())) if is_double else values.astype(_SINGLE).tolist()
    for place in np.flatnonzero(~np.isfinite(values)).tolist():
        if texts[place] == "nan":
            texts[place] = unknown
        elif infinite is not None:
            texts[place] = infinite
    return texts


def _json_text(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)


def _json_value(text: str) -> str:
    """Return a text that is JSON as its value, another text as a JSON string."""
    try:
        value = json.loads(text or "null", parse_constant=lambda _: None)
    except ValueError:
        return _json_text(text)
    return json.dumps(value, ensure_ascii=False)
