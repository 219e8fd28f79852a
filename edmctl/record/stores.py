"""Rows that wait for the disk.

A store keeps what it was handed by reference and writes it in whole chunks. Where a row goes depends only on how
many were written before, so a write that was interrupted can be repeated.
"""

from __future__ import annotations

from operator import attrgetter
from typing import Any

import h5py
import numpy as np
from h5py import h5s, h5t
from numpy.typing import NDArray

from edmctl.dataclasses import dataclass
from edmctl.record.create import compound_dtype
from edmctl.record.layout import Table
from edmctl.results.telemetry import PulseTrain

CHUNKS_PER_WRITE = 4
"""A store writes when this many chunks wait: fewer and larger calls into HDF5. The flush does not wait."""
TIME_TOLERANCE_S = 2e-6
"""How far the start of a train may be from a segment's count: twice the LSB of a controller's time."""


class RowStore:
    """Rows of a table that are handed over one by one, the texts among them cut to their field."""

    def __init__(self, file: h5py.File, table: Table) -> None:
        self._table = table
        self._row_type = compound_dtype(table)
        self._fields = attrgetter(*(column.field for column in table.columns))
        item = file[table.path]
        datasets = [item] if table.is_compound else [item[column.name] for column in table.columns]
        # h5py's low-level calls with a type made once take a sixth of the time of `dataset[a:b] = values`.
        self._datasets = [(one.id, h5t.py_create(one.dtype, logical=True)) for one in datasets]
        self._waiting: list[tuple[Any, ...]] = []
        self._written = 0
        self.waiting = 0
        """Rows that wait."""
        self.limit = CHUNKS_PER_WRITE * table.chunk_rows
        """Rows from which on it is worth writing."""

    def add(self, row: object) -> None:
        """Keep a row until it is written."""
        self._waiting.append(self._fields(row))
        self.waiting += 1

    @property
    def rows(self) -> int:
        """Rows handed over so far."""
        return self._written + self.waiting

    @property
    def growth_bytes(self) -> int:
        """How much the file may grow when everything that waits is written: space is taken by whole chunks."""
        rows = self._table.chunk_rows
        chunks = -(-self.rows // rows) - -(-self._written // rows)
        return chunks * rows * self._row_type.itemsize

    def write(self, *, everything: bool) -> None:
        """Write the whole chunks that wait, or everything. Raises what HDF5 raises."""
        count = self.waiting - (0 if everything else self.rows % self._table.chunk_rows)
        if count <= 0:
            return
        values, kept = self._taken(count)
        space = h5s.create_simple((count,))
        for (dataset, kind), column in zip(self._datasets, values, strict=True):
            dataset.set_extent((self._written + count,))
            place = dataset.get_space()
            place.select_hyperslab((self._written,), (count,))
            dataset.write(space, place, column, kind)
        self._waiting = kept
        self._written += count
        self.waiting -= count

    def _taken(self, count: int) -> tuple[list[NDArray[Any]], list[tuple[Any, ...]]]:
        """The first rows that wait, as each dataset stores them, and what waits on."""
        rows, kept = self._waiting[:count], self._waiting[count:]
        if not self._table.is_compound:
            columns = zip(self._table.columns, zip(*rows, strict=True), strict=True)
            return [np.array(values, column.dtype) for column, values in columns], kept
        widths = [np.dtype(column.dtype).itemsize for column in self._table.columns]
        fitted = [
            tuple(
                fit_utf8(v or "", width) if v is None or isinstance(v, str) else v
                for v, width in zip(row, widths, strict=True)
            )
            for row in rows
        ]
        return [np.array(fitted, self._row_type)], kept


class BlockStore(RowStore):
    """Rows of a table that are handed over as blocks of arrays."""

    def add(self, row: object) -> None:
        """Keep a block until it is written."""
        arrays = self._fields(row)
        self._waiting.append(arrays)
        self.waiting += len(arrays[0])

    def _taken(self, count: int) -> tuple[list[NDArray[Any]], list[tuple[Any, ...]]]:
        arrays = [np.concatenate(parts) for parts in zip(*self._waiting, strict=True)]
        if any(array.shape != (self.waiting,) for array in arrays):
            raise TypeError("columns of a block differ in length")
        columns = zip(self._table.columns, arrays, strict=True)
        stored = [_stored(array[:count], np.dtype(column.dtype), column.step) for column, array in columns]
        # What waits on is kept as it was handed over: it is not put into steps twice.
        return stored, [tuple(array[count:] for array in arrays)] if count < self.waiting else []


def store_of(file: h5py.File, table: Table) -> RowStore:
    """Return the store of a table, however its rows are handed over."""
    return BlockStore(file, table) if table.in_blocks else RowStore(file, table)


def fit_utf8(text: str, width: int) -> bytes:
    """Return `text` as UTF-8 of at most `width` bytes, cut between characters."""
    return text.encode()[:width].decode(errors="ignore").encode()


def _stored(values: NDArray[Any], dtype: np.dtype[Any], step: float) -> NDArray[Any]:
    """Return a column as it is stored; values beyond the range of its steps become its ends."""
    if step != 1.0:
        steps = np.divide(values, step, dtype="f8")
        values = np.rint(np.clip(steps, 0, 256**dtype.itemsize - 1))
    return np.ascontiguousarray(values, dtype)


@dataclass(frozen=True, slots=True)
class Segment:
    """Pulses from row `first_row` on: pulse first_row + i begins at start_s + i × period_s."""

    first_row: int
    first_pulse: int
    start_s: float
    period_s: float

    def continues_in(self, train: PulseTrain, row: int) -> bool:
        """Whether `train`, stored from `row` on, follows the segment's pulses without a gap."""
        passed = row - self.first_row
        return (
            train.period_s == self.period_s
            and train.first_pulse == self.first_pulse + passed
            and abs(self.start_s + passed * self.period_s - train.start_s) <= TIME_TOLERANCE_S
        )
