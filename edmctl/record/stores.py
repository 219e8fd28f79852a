"""Rows waiting for the disk.

A store keeps what it was handed by reference and writes it in whole chunks. Where a row goes depends only
on how many were written before, so a write that was interrupted can be repeated.
"""

from __future__ import annotations

from operator import attrgetter
from typing import TYPE_CHECKING, Protocol

import h5py
import numpy as np

from edmctl.record.create import compound_dtype

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from edmctl.record.layout import Table

CHUNKS_PER_WRITE = 4
"""A store writes when this many chunks wait: fewer and larger calls into HDF5. The flush does not wait."""


class Store(Protocol):
    """Pending rows of one table."""

    waiting: int
    """Rows that wait."""
    limit: int
    """Rows from which on it is worth writing."""

    @property
    def growth_bytes(self) -> int:
        """How much the file may grow when everything that waits is written."""
        ...

    def write(self, *, everything: bool) -> None:
        """Write the whole chunks that wait, or everything. Raises what HDF5 raises."""
        ...


class BlockStore:
    """Columns handed over as blocks of arrays."""

    def __init__(self, file: h5py.File, table: Table) -> None:
        group = file[table.path]
        self._datasets = [group[column.name] for column in table.columns]
        self._dtypes = [np.dtype(column.dtype) for column in table.columns]
        self._steps = [column.step for column in table.columns]
        self._fields = attrgetter(*(column.field for column in table.columns))
        self._table = table
        self._chunk_rows = table.chunk_rows
        self._blocks: list[tuple[NDArray[np.generic], ...]] = []
        self._written = 0
        self.waiting = 0
        self.limit = CHUNKS_PER_WRITE * table.chunk_rows

    def add(self, block: object) -> None:
        arrays = self._fields(block)
        self._blocks.append(arrays)
        self.waiting += len(arrays[0])

    @property
    def rows(self) -> int:
        """Rows handed over so far."""
        return self._written + self.waiting

    @property
    def growth_bytes(self) -> int:
        return _growth_bytes(self._table, self._written, self.waiting)

    def write(self, *, everything: bool) -> None:
        torn = 0 if everything else self.rows % self._chunk_rows
        count = self.waiting - torn
        if count <= 0:
            return
        columns = [np.concatenate(parts) for parts in zip(*self._blocks, strict=True)]
        if any(column.shape != (self.waiting,) for column in columns):
            raise TypeError("columns of a block differ in length")
        for dataset, column, dtype, step in zip(
            self._datasets, columns, self._dtypes, self._steps, strict=True
        ):
            _put(dataset, self._written, _stored([column[:count]], dtype, step))
        # What waits on is kept as it was handed over: it is not put into steps twice.
        self._blocks = [tuple(column[count:] for column in columns)] if count < self.waiting else []
        self._written += count
        self.waiting -= count


class RowStore:
    """Columns handed over row by row."""

    def __init__(self, file: h5py.File, table: Table) -> None:
        group = file[table.path]
        self._datasets = [group[column.name] for column in table.columns]
        self._dtypes = [np.dtype(column.dtype) for column in table.columns]
        self._fields = attrgetter(*(column.field for column in table.columns))
        self._table = table
        self._chunk_rows = table.chunk_rows
        self._rows: list[tuple[object, ...]] = []
        self._written = 0
        self.waiting = 0
        self.limit = CHUNKS_PER_WRITE * table.chunk_rows

    def add(self, row: object) -> None:
        self._rows.append(self._fields(row))
        self.waiting += 1

    @property
    def growth_bytes(self) -> int:
        return _growth_bytes(self._table, self._written, self.waiting)

    def write(self, *, everything: bool) -> None:
        torn = 0 if everything else (self._written + self.waiting) % self._chunk_rows
        count = self.waiting - torn
        if count <= 0:
            return
        values = zip(*self._rows[:count], strict=True)
        for dataset, column, dtype in zip(self._datasets, values, self._dtypes, strict=True):
            _put(dataset, self._written, np.array(column, dtype))
        del self._rows[:count]
        self._written += count
        self.waiting -= count


class CompoundStore:
    """Rows of a compound table; texts are cut to their field without breaking a character."""

    def __init__(self, file: h5py.File, table: Table) -> None:
        self._table = table
        self._dataset = file[table.path]
        self._dtype = compound_dtype(table)
        self._fields = attrgetter(*(column.field for column in table.columns))
        self._widths = [np.dtype(column.dtype).itemsize for column in table.columns]
        self._rows: list[tuple[object, ...]] = []
        self._written = 0
        self.waiting = 0
        self.limit = CHUNKS_PER_WRITE * table.chunk_rows

    def add(self, row: object) -> None:
        values = zip(self._fields(row), self._widths, strict=True)
        self._rows.append(tuple(fit_utf8(v, width) if isinstance(v, str) else v for v, width in values))
        self.waiting += 1

    @property
    def growth_bytes(self) -> int:
        return _growth_bytes(self._table, self._written, self.waiting)

    def write(self, *, everything: bool) -> None:
        """Write what waits; the few rows of such a table are not worth holding back."""
        if not self._rows:
            return
        _put(self._dataset, self._written, np.array(self._rows, self._dtype))
        self._rows = []
        self._written += self.waiting
        self.waiting = 0


def _growth_bytes(table: Table, written: int, waiting: int) -> int:
    """Size of the chunks that `waiting` rows begin: space is taken by whole chunks."""
    rows = table.chunk_rows
    chunks = -(-(written + waiting) // rows) - -(-written // rows)
    return chunks * rows * compound_dtype(table).itemsize


def fit_utf8(text: str, width: int) -> bytes:
    """Return `text` as UTF-8 of at most `width` bytes, cut between characters."""
    return text.encode()[:width].decode(errors="ignore").encode()


def _stored(
    parts: Sequence[NDArray[np.generic]], dtype: np.dtype[np.generic], step: float
) -> NDArray[np.generic]:
    """Join the parts of a column as they are stored; values beyond the type's range become its ends."""
    if step == 1.0:
        return np.concatenate(parts, dtype=dtype, casting="unsafe")
    steps = np.concatenate(parts, dtype="f8") / step
    return np.rint(np.clip(steps, 0, 256**dtype.itemsize - 1)).astype(dtype)


def _put(dataset: h5py.Dataset, first_row: int, values: NDArray[np.generic]) -> None:
    # The low-level calls take a third of the time of `dataset[a:b] = values`.
    dataset.id.set_extent((first_row + len(values),))
    target = dataset.id.get_space()
    target.select_hyperslab((first_row,), (len(values),))
    dataset.id.write(h5py.h5s.create_simple((len(values),)), target, values)
