"""Writers of tables, a block of columns at a time: CSV and JSON, and Parquet through pyarrow.

Texts have every digit that is needed to read the same number again. numpy formats a column at a time; values that
repeat, as those of a converter do, only once. Parquet gets a row group per block, and the units in its metadata.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Protocol

import numpy as np

from edmctl.errors import PreconditionError, installing
from edmctl.report.export_tables import JSON_TEXT

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    import pyarrow as pa
    from numpy.typing import NDArray

    from edmctl.report.export_tables import Block, ExportColumn

_NEEDS_QUOTES = frozenset('",\r\n')
_SAMPLE = 1024
_FLOAT_CHARACTERS = {4: "U15", 8: "U25"}
"""Longest forms: `-1.1754944e-38`, `-2.2250738585072014e-308`."""


class ByteSink(Protocol):
    """What takes bytes."""

    def write(self, data: bytes, /) -> int: ...


class TableWriter(Protocol):
    """Writes one table, block after block."""

    def write(self, block: Block) -> None:
        """Append rows: one array per column. Raises OSError."""

    def close(self) -> None:
        """Write what comes after the last row. Raises OSError."""


class CsvWriter:
    """RFC 4180 with plain line ends; a header; unknown numbers are empty."""

    def __init__(self, sink: ByteSink, columns: Sequence[ExportColumn]) -> None:
        self._sink = sink
        self._columns = columns
        sink.write((",".join(_quoted(column.name) for column in columns) + "\n").encode())

    def write(self, block: Block) -> None:
        """Append rows."""
        cells = [
            _texts(values, _quoted) if column.is_text else formatted(values, unknown="")
            for column, values in zip(self._columns, block, strict=True)
        ]
        rows = "\n".join(map(",".join, zip(*cells, strict=True)))
        self._sink.write(f"{rows}\n".encode())

    def close(self) -> None:
        """Nothing comes after the last row."""


class JsonWriter:
    """An array of objects, one a line; with `lines` the objects alone (JSON Lines). Unknown numbers are null."""

    def __init__(self, sink: ByteSink, columns: Sequence[ExportColumn], *, lines: bool) -> None:
        self._sink = sink
        self._columns = columns
        self._before, self._between, self._end = ("", "\n", "\n") if lines else ("[\n", ",\n", "\n]\n")
        self._empty = "" if lines else "[]\n"
        self._begun = False
        members = (f"{json.dumps(column.name)}: %s" for column in columns)
        self._form = "{" + ", ".join(members) + "}"

    def write(self, block: Block) -> None:
        """Append rows."""
        cells = [
            _texts(values, _json_value if column.units == JSON_TEXT else _json_text)
            if column.is_text
            else formatted(values, unknown="null", infinite="null")
            for column, values in zip(self._columns, block, strict=True)
        ]
        rows = self._between.join(map(self._form.__mod__, zip(*cells, strict=True)))
        self._sink.write(((self._between if self._begun else self._before) + rows).encode())
        self._begun = True

    def close(self) -> None:
        """Close the array, or the last line."""
        self._sink.write((self._end if self._begun else self._empty).encode())


class ParquetWriter:
    """One table. Numbers keep their type, unknown ones stay NaN; `about` becomes metadata of the file.

    Call `need_pyarrow` first.
    """

    def __init__(self, sink: ByteSink, columns: Sequence[ExportColumn], about: Mapping[str, str]) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        self._schema = pa.schema([_field(column) for column in columns], metadata=dict(about))
        self._writer = pq.ParquetWriter(sink, self._schema, compression="zstd")

    def write(self, block: Block) -> None:
        """Append rows."""
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
        raise PreconditionError(
            "Parquet needs pyarrow, which is not installed.",
            hint=f"Install it: {installing('pyarrow')}; --format csv needs nothing.",
            code="E8092",
        ) from None


def formatted(values: NDArray[np.generic], unknown: str, infinite: str | None = None) -> list[str]:
    """Return numbers as the shortest texts that are read back as the same numbers of their type."""
    if values.dtype.kind != "f":
        return list(map(str, values.tolist()))
    if _repeats(values):
        once, where = np.unique(values, return_inverse=True)
        texts: list[str] = np.array(_floats(once, unknown, infinite), object)[where].tolist()
        return texts
    return _floats(values, unknown, infinite)


def _repeats(values: NDArray[np.generic]) -> bool:
    """Whether looking for equal values saves more than it costs, by a part of them."""
    if len(values) < 4 * _SAMPLE:
        return False
    sample = values[:: len(values) // _SAMPLE]
    return len(np.unique(sample)) < len(sample) // 2


def _floats(values: NDArray[np.generic], unknown: str, infinite: str | None) -> list[str]:
    if values.dtype.itemsize == 8:
        texts: list[str] = list(map(repr, values.tolist()))
    else:
        texts = values.astype(_FLOAT_CHARACTERS[values.dtype.itemsize]).tolist()
    odd = np.flatnonzero(~np.isfinite(values))
    for place in odd.tolist():
        if texts[place] == "nan":
            texts[place] = unknown
        elif infinite is not None:
            texts[place] = infinite
    return texts


def _texts(values: NDArray[np.generic], form: Callable[[str], str]) -> list[str]:
    return list(map(form, values.tolist()))


def _quoted(text: str) -> str:
    if _NEEDS_QUOTES.isdisjoint(text):
        return text
    doubled = text.replace('"', '""')
    return f'"{doubled}"'


def _json_text(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)


def _json_value(text: str) -> str:
    """A text that is JSON as the value it stands for; as a text where it is none after all."""
    try:
        value = json.loads(text or "null", parse_constant=lambda _: None)
    except ValueError:
        return _json_text(text)
    return json.dumps(value, ensure_ascii=False)


def _field(column: ExportColumn) -> pa.Field:
    import pyarrow as pa

    kind = pa.string() if column.is_text else pa.from_numpy_dtype(column.dtype)
    return pa.field(column.name, kind, metadata={"units": column.units, "long_name": column.long_name})
