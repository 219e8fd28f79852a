"""The tables of a run file as rows for other programs: named with their units, block by block."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from edmctl.record import layout
from edmctl.report.numbers import numbers_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from numpy.typing import NDArray

    from edmctl.record.layout import Column, Table
    from edmctl.record.reader import RunFile

    Block = list[NDArray[np.generic]]

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
_ENDINGS = {
    "%": "pct",
    "L/min": "lpm",
    "degC": "c",
    "mm3/min": "mm3_min",
    "um/s": "um_s",
}


@dataclass(frozen=True, slots=True)
class ExportColumn:
    """A column as other programs see it: its unit is part of the name. `units` of a text are empty or JSON."""

    name: str
    dtype: np.dtype[np.generic]
    units: str
    long_name: str

    @property
    def is_text(self) -> bool:
        return self.dtype.kind == "O"


_TRUTH = [
    ExportColumn(
        "truth_depth_um", np.dtype("f8"), "um", "depth on the virtual machine; NaN where nobody knows"
    ),
    ExportColumn(
        "truth_wear_um", np.dtype("f8"), "um", "wear on the virtual machine; NaN where nobody knows"
    ),
]
"""Beside the results of simulated runs."""


class ExportTable:
    """One table of an open run file. What a live writer adds meanwhile is not seen.

    code_names : names of the events by their codes, which become a column of their own
    """

    def __init__(self, run: RunFile, name: str, code_names: Mapping[int, str]) -> None:
        self._run = run
        self._table = TABLES[name]
        self._code_names = code_names
        self.name = name
        self.rows = (
            len(run.table(self._table.path)) if self._table.is_compound else run.rows(self._table.path)
        )
        self.columns = _columns(self._table)
        self._has_truth = self._table is layout.RESULTS and run.is_simulated
        if self._has_truth:
            self.columns += _TRUTH

    def blocks(self) -> Iterator[Block]:
        """Yield the rows, a large number at a time: one array per column, texts as `str`."""
        if self._table.is_compound:
            yield from self._compound_blocks()
            return
        names = [column.name for column in self._table.columns]
        for start in range(0, self.rows, BLOCK_ROWS):
            stop = min(start + BLOCK_ROWS, self.rows)
            block: Block = [self._run.column(self._table.path, name, start, stop) for name in names]
            if self._table is layout.PULSES:
                block.insert(0, self._run.pulse_times_s(start, stop))
            yield block

    def _compound_blocks(self) -> Iterator[Block]:
        rows = self._run.table(self._table.path)[: self.rows]
        if not len(rows):
            return
        block = [_values(rows, column) for column in self._table.columns]
        if self._table is layout.EVENTS:
            codes = rows["code"].tolist()
            block.insert(3, np.array([self._code_names.get(code, str(code)) for code in codes], object))
        if self._has_truth:
            sites = numbers_of(self._run).sites[: len(rows)]
            block += [np.array([getattr(site, column.name) for site in sites]) for column in _TRUTH]
        yield block


def _columns(table: Table) -> list[ExportColumn]:
    columns = [
        ExportColumn(named(column), _dtype(column), column.units.rpartition(" ")[2], column.long_name)
        for column in table.columns
    ]
    if table is layout.PULSES:
        columns.insert(0, ExportColumn("time_s", np.dtype("f8"), "s", "time since start"))
    if table is layout.EVENTS:
        columns.insert(3, ExportColumn("name", np.dtype("O"), "", "name of the code"))
        columns[-1] = ExportColumn("args", np.dtype("O"), JSON_TEXT, columns[-1].long_name)
    return columns


def named(column: Column) -> str:
    """Return a column's name with its unit: `z_sensor_um`."""
    units = column.units.rpartition(" ")[2]
    if units in (layout.PURE, layout.TEXT):
        return column.name
    ending = _ENDINGS.get(units, units.lower())
    return column.name if column.name.endswith(f"_{ending}") else f"{column.name}_{ending}"


def _dtype(column: Column) -> np.dtype[np.generic]:
    if column.dtype.startswith("S"):
        return np.dtype("O")
    return np.dtype("f4") if column.step != 1.0 else np.dtype(column.dtype)


def _values(rows: NDArray[np.void], column: Column) -> NDArray[np.generic]:
    """One field of a compound table; unknown in files of a version that had none such."""
    kind = _dtype(column)
    if column.name not in (rows.dtype.names or ()):
        empty: NDArray[np.generic] = np.zeros(len(rows), kind)
        if kind.kind == "O":
            empty[:] = ""
        elif kind.kind == "f":
            empty[:] = np.nan
        return empty
    values: NDArray[np.generic] = rows[column.name]
    if kind.kind == "O":
        return np.array([text.decode(errors="replace") for text in values.tolist()], object)
    return values
