"""Rows of compressed columns, unpacked side by side: what HDF5 itself reads, to the last bit."""

from __future__ import annotations

from typing import TYPE_CHECKING

import h5py
import numpy as np
import pytest

from edmctl.record import chunks
from edmctl.record.chunks import FEWEST_CHUNKS, read_rows

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

CHUNK = 64
ROWS = 10 * CHUNK + 17
PARTS = [
    (0, ROWS),
    (0, ROWS - 1),
    (1, 8 * CHUNK),
    (CHUNK, 6 * CHUNK),
    (5, 6),
    (63, 65),
    (70, 70),
    (600, ROWS),
]


@pytest.fixture
def file(tmp_path: Path) -> Iterator[h5py.File]:
    with h5py.File(tmp_path / "a.h5", "w") as opened:
        yield opened


@pytest.fixture
def unpacked(monkeypatch: pytest.MonkeyPatch) -> list[h5py.Dataset]:
    """Return the datasets that were unpacked without HDF5, so far."""
    seen: list[h5py.Dataset] = []
    inner = chunks._unpacked

    def noted(dataset: h5py.Dataset, start: int, stop: int, begins: range) -> np.ndarray:
        rows = inner(dataset, start, stop, begins)
        seen.append(dataset)
        return rows

    monkeypatch.setattr(chunks, "_unpacked", noted)
    return seen


def bits(rows: np.ndarray) -> tuple[np.dtype, bytes]:
    return rows.dtype, rows.tobytes()


def noise(dtype: str) -> np.ndarray:
    """Return rows of every bit pattern, NaN of all kinds among them."""
    return np.frombuffer(np.random.default_rng(5).bytes(ROWS * np.dtype(dtype).itemsize), dtype)


@pytest.mark.parametrize("shuffle", [True, False])
@pytest.mark.parametrize("dtype", ["u1", "i1", "<u2", "<f4", "<f8", ">f4", ">i8"])
def test_rows_are_those_that_hdf5_reads_to_the_last_bit(
    file: h5py.File, unpacked: list[h5py.Dataset], dtype: str, shuffle: bool
) -> None:
    column = file.create_dataset("c", data=noise(dtype), chunks=(CHUNK,), compression=4, shuffle=shuffle)
    for start, stop in PARTS:
        assert bits(read_rows(column, start, stop)) == bits(column[start:stop])
    many = sum(-(-stop // CHUNK) - start // CHUNK >= FEWEST_CHUNKS for start, stop in PARTS)
    assert len(unpacked) == many >= 4


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"chunks": (CHUNK,)},
        {"chunks": (CHUNK,), "shuffle": True},
        {"chunks": (CHUNK,), "compression": "lzf"},
        {"chunks": (CHUNK,), "compression": 4, "fletcher32": True},
        {"chunks": (CHUNK,), "compression": 4, "scaleoffset": 0},
    ],
)
def test_what_was_stored_otherwise_is_left_to_hdf5(
    file: h5py.File, unpacked: list[h5py.Dataset], options: dict[str, object]
) -> None:
    column = file.create_dataset("c", data=noise("<u2"), **options)
    for start, stop in PARTS:
        assert bits(read_rows(column, start, stop)) == bits(column[start:stop])
    assert not unpacked


def test_a_chunk_that_was_never_written_holds_the_fill_value(file: h5py.File) -> None:
    column = file.create_dataset("c", (ROWS,), "f4", chunks=(CHUNK,), compression=4, fillvalue=7.0)
    column[:CHUNK] = 1.0
    assert read_rows(column, 0, ROWS)[[0, CHUNK - 1, CHUNK, ROWS - 1]].tolist() == [1.0, 1.0, 7.0, 7.0]


def test_a_chunk_that_left_its_filters_out_is_read_all_the_same(file: h5py.File) -> None:
    column = file.create_dataset("c", data=noise("<f4"), chunks=(CHUNK,), compression=4, shuffle=True)
    plain = np.arange(CHUNK, dtype="<f4")
    column.id.write_direct_chunk((CHUNK,), plain.tobytes(), 0b11)
    assert read_rows(column, 0, ROWS)[CHUNK : 2 * CHUNK].tolist() == plain.tolist()


@pytest.mark.parametrize("packed", [b"no gzip at all", b""])
def test_a_damaged_chunk_is_the_error_of_hdf5(file: h5py.File, packed: bytes) -> None:
    column = file.create_dataset("c", data=noise("<f4"), chunks=(CHUNK,), compression=4, shuffle=True)
    column.id.write_direct_chunk((2 * CHUNK,), packed or b"\0")
    with pytest.raises(OSError, match=r"filter|inflate|read"):
        read_rows(column, 0, ROWS)
