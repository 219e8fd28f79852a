"""Writes a run file anew: compressed, with nothing but its rows, and sealed; so a complete one gets its name.

During a run nothing is compressed, because SWMR never reuses the space of a compressed chunk that grows. At the end
groups, attributes, links and dimension scales are copied as they are, and rows in large chunks through the filters
shuffle and gzip, which every HDF5 library has. The new file is in the oldest format that can hold it.
"""

from __future__ import annotations

import os
import zlib
from collections import deque
from collections.abc import Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import h5py
import numpy as np
from h5py import h5a, h5d, h5ds, h5g, h5o, h5p, h5s
from numpy.typing import NDArray

from edmctl.errors import RunFileError
from edmctl.files import sync
from edmctl.record.disk import HDF5_ERRORS, cannot_name, rename_without_replacing
from edmctl.record.integrity import append_checksum
from edmctl.record.opening import open_hdf5, refuse_endless

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

    `rows` gives for paths of datasets how many of their rows are copied; of the others, all are. `values` are put in
    the place of those of the source. Raises what h5py raises; then there is no `target`.
    """
    try:
        with open_hdf5(target, "x", libver=("earliest", "v110")) as file:
            _Copy(source, file, rows or {}).run()
            for path, value in (values or {}).items():
                file[path][()] = value
        append_checksum(target)
        sync(target)
    except BaseException as error:
        if not isinstance(error, FileExistsError):
            target.unlink(missing_ok=True)
        raise


class _Copy:
    """One copy under way, by h5py's low-level calls, which take half the time."""

    def __init__(self, source: h5py.File, target: h5py.File, rows: Mapping[str, int]) -> None:
        self._source = source.id
        self._target = target.id
        self._rows = {_address(source[path].id): count for path, count in rows.items()}
        self._copied: dict[int, h5g.GroupID | h5d.DatasetID] = {}
        """The copy of each object, by its address in the source."""
        self._scales: list[h5d.DatasetID] = []
        self._scaled: list[h5d.DatasetID] = []

    def run(self) -> None:
        root, made = h5o.open(self._source, b"/"), h5o.open(self._target, b"/")
        _copy_attributes(root, made)
        with ThreadPoolExecutor(_WORKERS) as pool:
            self._copy_members(root, made, pool)
        self._make_scales()

    def _copy_members(self, group: h5g.GroupID, target: h5g.GroupID, pool: ThreadPoolExecutor) -> None:
        # By name: h5py's views hold its lock between two items. A thread of the pool that collects garbage as it
        # starts would wait for that lock, and this one for the thread.
        for name in list(group):
            item = h5o.open(group, name)
            address = _address(item)
            if address in self._copied:
                h5o.link(self._copied[address], target, name)
            elif not _holds_rows(item):
                h5o.copy(group, name, target, name)
                self._copied[address] = h5o.open(target, name)
            elif isinstance(item, h5g.GroupID):
                self._copied[address] = made = h5g.create(target, name)
                _copy_attributes(item, made)
                self._copy_members(item, made, pool)
            else:
                self._copied[address] = made = _copy_rows(item, target, name, self._rows.get(address), pool)
                _copy_attributes(item, made)
                if h5ds.is_scale(item):
                    self._scales.append(item)
                elif h5a.exists(item, b"DIMENSION_LIST"):
                    self._scaled.append(item)

    def _make_scales(self) -> None:
        """Attach each dimension to its scale, as in the source."""
        for item in self._scales:
            h5ds.set_scale(self._copied[_address(item)], h5ds.get_scale_name(item))
        for item in self._scaled:
            for dimension in range(item.rank):
                scales: list[h5d.DatasetID] = []
                if h5ds.get_num_scales(item, dimension):
                    h5ds.iterate(item, dimension, scales.append)
                for scale in scales:
                    h5ds.attach_scale(self._copied[_address(item)], self._copied[_address(scale)], dimension)


def _address(item: h5g.GroupID | h5d.DatasetID) -> int:
    """Where the object is in its file: the same for all its names."""
    address: int = h5o.get_info(item).addr
    return address


def _holds_rows(item: h5g.GroupID | h5d.DatasetID) -> bool:
    """Whether it is, or has in it, a dataset whose rows are written anew or that belongs to a scale."""
    if isinstance(item, h5g.GroupID):
        return any(_holds_rows(h5o.open(item, name)) for name in list(item))
    refuse_endless(item)
    if h5ds.is_scale(item) or h5a.exists(item, b"DIMENSION_LIST"):
        return True
    return item.get_create_plist().get_layout() == h5d.CHUNKED and 0 not in item.shape


def _copy_attributes(source: h5g.GroupID | h5d.DatasetID, target: h5g.GroupID | h5d.DatasetID) -> None:
    for number in range(h5a.get_num_attrs(source)):
        attribute = h5a.open(source, index=number)
        if attribute.name in _SCALE_ATTRIBUTES:
            continue
        kind, space = attribute.get_type(), attribute.get_space()
        value = np.empty(space.shape, kind.dtype)
        attribute.read(value)
        h5a.create(target, attribute.name, kind, space).write(value)


def _copy_rows(
    source: h5d.DatasetID, target: h5g.GroupID, name: bytes, rows: int | None, pool: ThreadPoolExecutor
) -> h5d.DatasetID:
    shape = source.shape if rows is None or not source.shape else (rows, *source.shape[1:])
    kind = source.get_type()
    layout = h5p.create(h5p.DATASET_CREATE)
    size = source.dtype.itemsize
    filtered = len(shape) == 1 and not source.dtype.hasobject and shape[0] * size > SMALLEST_BYTES
    chunk_rows = min(shape[0], CHUNK_ROWS) if filtered else 0
    if filtered:
        layout.set_chunk((chunk_rows,))
        if size > 1:
            layout.set_shuffle()
        layout.set_deflate(LEVEL)
    space = h5s.create_simple(shape) if shape else h5s.create(h5s.SCALAR)
    made = h5d.create(target, name, kind, space, layout)
    if filtered:
        for first, chunk in _compressed(source, shape[0], chunk_rows, pool):
            made.write_direct_chunk((first,), chunk)
    elif 0 not in shape:
        values = np.empty(source.shape, source.dtype)
        source.read(h5s.ALL, h5s.ALL, values)
        made.write(h5s.ALL, h5s.ALL, np.ascontiguousarray(values[: shape[0]] if shape else values))
    return made


def _compressed(
    source: h5d.DatasetID, rows: int, chunk_rows: int, pool: ThreadPoolExecutor
) -> Iterator[tuple[int, bytes]]:
    """Yield the first row and the filtered bytes of each chunk; threads compress while the next ones are read."""
    waiting: deque[tuple[int, Future[bytes]]] = deque()
    place = source.get_space()
    for first in range(0, rows, chunk_rows):
        values = np.empty(min(chunk_rows, rows - first), source.dtype)
        place.select_hyperslab((first,), values.shape)
        source.read(h5s.create_simple(values.shape), place, values)
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


CLOSING = ".closing"
"""Ending of the compressed copy while it is written; whoever dies then leaves the `.partial` file as it was."""


def close_run(partial: Path, path: Path) -> None:
    """Make `path` of the complete and closed file `partial`; a file of that name is never replaced.

    Raises RunFileError E9004 when the name is taken or cannot be given; then `partial` stays.
    """
    closing = path.with_name(path.name + CLOSING)
    try:
        closing.unlink(missing_ok=True)
        # Every chunk is read once: a cache would keep up to 8 MB of each dataset.
        with open_hdf5(partial, rdcc_nbytes=0) as source:
            compact(source, closing)
    except HDF5_ERRORS:
        # Better large than lost: the disk may not have room for a second file.
        rename_without_replacing(partial, path)
        return
    try:
        rename_without_replacing(closing, path)
    except RunFileError as error:
        closing.unlink(missing_ok=True)
        raise cannot_name(partial, path, error.__cause__ or error) from error
    partial.unlink(missing_ok=True)
