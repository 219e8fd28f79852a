"""Parquet out of columns, through pyarrow: a row group per block, units in the metadata of each field."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.errors import PreconditionError, installing

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import pyarrow as pa

    from edmctl.report.export_tables import Block, ExportColumn
    from edmctl.report.export_text import ByteSink


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


def _field(column: ExportColumn) -> pa.Field:
    import pyarrow as pa

    kind = pa.string() if column.is_text else pa.from_numpy_dtype(column.dtype)
    return pa.field(column.name, kind, metadata={"units": column.units, "long_name": column.long_name})
