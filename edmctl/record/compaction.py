"""Writes a run file anew: compressed, with nothing but its rows, and sealed.

While a run goes on nothing is compressed, because SWMR never reuses the space of a compressed chunk that
grows. So at the end everything is copied: groups, attributes, hard links and dimension scales as they are, rows
in large chunks through the filters shuffle and gzip, which every HDF5 library has. The new file is in the oldest
format that can hold it.
"""

from __future__ import annotations

import os
import zlib
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING

import h5py
import numpy as np

from .seal import seal

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from numpy.typing import NDArray

CHUNK_ROWS = 1 << 16
LEVEL = 4
"""Of gzip: level 9 takes ten times as long and saves 3 % of the pulses."""
SMALLEST_BYTES = 2048
"""Smaller datasets are not worth a chunk."""
_WORKERS = min(4, os.cpu_count() or 1)
_IN_FLIGHT = 4 * _WORKERS
_SCALE_ATTRIBUTES = (b"CLASS", b"NAME", b"DIMENSION_LIST", b"REFERENCE_LIST")
"""Made anew by HDF5's own calls, because they hold addresses."""


def compact(
    source: h5py.File,
    target: Path,
    rows: Mapping[str, int] | None = None,
    values: Mapping[str, bytes | int] | None = None,
) -> None:
    """Copy `source` into the new file `target`, which is safe on the disk when the call returns.

    `rows` tells for paths of datasets how many of their rows are copied; of the others, all are. `values` are put in
    the place of those of the source. Raises what h5py raises; then there is no `target`.
    """
    try:
        with h5py.File(target, "x", libver=("earliest", "v110")) as file:
            _Copy(source, file, rows or {}).run()
            for path, value in (values or {}).items():
                file[path][()] = value
        seal(target)
        _sync(target)
    except BaseException as error:
        if not isinstance(error, FileExistsError):
            target.unlink(missing_ok=True)
        raise


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


class _Copy:
    """One copy under way."""

    def __init__(self, source: h5py.File, target: h5py.File, rows: Mapping[str, int]) -> None:
        self._source = source
        self._target = target
        self._rows = {_address(source[path]): count for path, count in rows.items()}
        self._copied: dict[int, str] = {}
        """Path of each object in the target, by its address in the source."""

    def run(self) -> None:
        _copy_attributes(self._source, self._target)
        with ThreadPoolExecutor(_WORKERS) as pool:
            self._copy_members(self._source, pool)
        self._make_scales()

    def _copy_members(self, group: h5py.Group, pool: ThreadPoolExecutor) -> None:
        for name in group:
            self._copy_object(group[name], f"{group.name.rstrip('/')}/{name}", pool)

    def _copy_object(self, item: h5py.Group | h5py.Dataset, path: str, pool: ThreadPoolExecutor) -> None:
        address = _address(item)
        if address in self._copied:
            self._target[path] = self._target[self._copied[address]]
        elif isinstance(item, h5py.Group):
            self._copied[address] = path
            _copy_attributes(item, self._target.create_group(path))
            self._copy_members(item, pool)
        else:
            dataset = _copy_dataset(item, self._target, path, self._rows.get(address), pool)
            _copy_attributes(item, dataset)
            self._copied[address] = path

    def _make_scales(self) -> None:
        """Attach each dimension to its scale, as in the source."""
        originals = {path: self._source[path] for path in self._copied.values()}
        scales = {path: item for path, item in originals.items() if _is_scale(item)}
        for path, item in scales.items():
            self._target[path].make_scale(h5py.h5ds.get_scale_name(item.id).decode())
        for path, item in originals.items():
            if isinstance(item, h5py.Dataset) and path not in scales:
                for number, dimension in enumerate(item.dims):
                    for scale in dimension.values():
                        there = self._copied.get(_address(scale))
                        if there is not None:
                            self._target[path].dims[number].attach_scale(self._target[there])


def _address(item: h5py.Group | h5py.Dataset) -> int:
    """Where the object is in its file: the same for all its names."""
    address: int = h5py.h5o.get_info(item.id).addr
    return address


def _is_scale(item: h5py.Group | h5py.Dataset) -> bool:
    return isinstance(item, h5py.Dataset) and h5py.h5ds.is_scale(item.id)


def _copy_attributes(source: h5py.Group | h5py.Dataset, target: h5py.Group | h5py.Dataset) -> None:
    for number in range(h5py.h5a.get_num_attrs(source.id)):
        attribute = h5py.h5a.open(source.id, index=number)
        if attribute.name in _SCALE_ATTRIBUTES:
            continue
        value = np.empty(attribute.shape, attribute.dtype)
        attribute.read(value)
        h5py.h5a.create(target.id, attribute.name, attribute.get_type(), attribute.get_space()).write(value)


def _copy_dataset(
    source: h5py.Dataset, file: h5py.File, path: str, rows: int | None, pool: ThreadPoolExecutor
) -> h5py.Dataset:
    shape = source.shape if rows is None or not source.shape else (rows, *source.shape[1:])
    kind = source.id.get_type()
    layout = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    size = source.dtype.itemsize
    filtered = len(shape) == 1 and not source.dtype.hasobject and shape[0] * size > SMALLEST_BYTES
    chunk_rows = min(shape[0], CHUNK_ROWS) if filtered else 0
    if filtered:
        layout.set_chunk((chunk_rows,))
        if size > 1:
            layout.set_shuffle()
        layout.set_deflate(LEVEL)
    space = h5py.h5s.create_simple(shape) if shape else h5py.h5s.create(h5py.h5s.SCALAR)
    made = h5py.h5d.create(file.id, path.encode(), kind, space, layout)
    if filtered:
        for first, chunk in _compressed(source, shape[0], chunk_rows, pool):
            made.write_direct_chunk((first,), chunk)
    elif 0 not in shape:
        values = np.empty(source.shape, source.dtype)
        source.id.read(h5py.h5s.ALL, h5py.h5s.ALL, values)
        made.write(h5py.h5s.ALL, h5py.h5s.ALL, np.ascontiguousarray(values[: shape[0]] if shape else values))
    return file[path]


def _compressed(
    source: h5py.Dataset, rows: int, chunk_rows: int, pool: ThreadPoolExecutor
) -> Iterator[tuple[int, bytes]]:
    """Yield the first row and the filtered bytes of each chunk; threads compress while the next ones are read."""
    waiting: deque[tuple[int, Future[bytes]]] = deque()
    for first in range(0, rows, chunk_rows):
        values = source[first : min(first + chunk_rows, rows)]
        waiting.append((first, pool.submit(_filtered, values, chunk_rows)))
        if len(waiting) >= _IN_FLIGHT:
            start, chunk = waiting.popleft()
            yield start, chunk.result()
    for start, chunk in waiting:
        yield start, chunk.result()


def _filtered(values: NDArray[np.generic], chunk_rows: int) -> bytes:
    """What HDF5's filters shuffle and gzip make of a chunk; a last one that is not full is filled with zeros."""
    size = values.dtype.itemsize
    planes = np.zeros((size, chunk_rows), np.uint8)
    planes[:, : len(values)] = values.view(np.uint8).reshape(len(values), size).T
    return zlib.compress(planes.data, LEVEL)
