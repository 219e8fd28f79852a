"""Reads rows of a compressed column in several threads.

HDF5 unpacks chunks one after the other; zlib and numpy work without the interpreter's lock. So chunks are read as
they are stored, and the filters that `compaction` put them through are undone here.
"""

from __future__ import annotations

import os
import zlib
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import h5py
import numpy as np

from edmctl.record.disk import HDF5_ERRORS

if TYPE_CHECKING:
    from numpy.typing import NDArray

FEWEST_CHUNKS = 4
"""Fewer are not worth threads."""
_WORKERS = min(8, os.cpu_count() or 1)
_GZIP = [h5py.h5z.FILTER_DEFLATE]
_SHUFFLE_GZIP = [h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_DEFLATE]


def read_rows(dataset: h5py.Dataset, start: int, stop: int) -> NDArray[np.generic]:
    """Return `dataset[start:stop]` of one dimension, shape (n,).

    Several chunks of numbers through gzip, with shuffle or without, are unpacked side by side; everything else, and
    whatever is not as it should be, is left to HDF5.
    """
    if 0 <= start < stop <= dataset.shape[0] and _is_packed(dataset):
        chunk_rows = dataset.chunks[0]
        begins = range(start // chunk_rows * chunk_rows, stop, chunk_rows)
        if len(begins) >= FEWEST_CHUNKS:
            try:
                return _unpacked(dataset, start, stop, begins)
            except (*HDF5_ERRORS, ValueError, zlib.error):
                pass  # HDF5 says what is wrong, or fills in a chunk that was never written
    rows: NDArray[np.generic] = dataset[start:stop]
    return rows


def _is_packed(dataset: h5py.Dataset) -> bool:
    if dataset.chunks is None or dataset.dtype.kind not in "iuf":
        return False
    made = dataset.id.get_create_plist()
    filters = [made.get_filter(number)[0] for number in range(made.get_nfilters())]
    return filters in (_GZIP, _SHUFFLE_GZIP)


def _unpacked(dataset: h5py.Dataset, start: int, stop: int, begins: range) -> NDArray[np.generic]:
    kind = dataset.dtype
    # Of one byte there is nothing to shuffle, and without shuffle the bytes of a number are not apart.
    planes = kind.itemsize if dataset.shuffle else 1
    found = np.empty(stop - start, kind)
    in_bytes = found.view(np.uint8).reshape(-1, planes)
    numbers = kind.itemsize // planes
    chunk_bytes = begins.step * kind.itemsize

    def put(begin: int, packed: bytes) -> None:
        chunk = np.frombuffer(zlib.decompress(packed, bufsize=chunk_bytes), np.uint8).reshape(
            planes, begins.step * numbers
        )
        low, high = max(start, begin), min(stop, begin + begins.step)
        place = in_bytes[(low - start) * numbers : (high - start) * numbers]
        for number, plane in enumerate(chunk):
            place[:, number] = plane[(low - begin) * numbers : (high - begin) * numbers]

    with ThreadPoolExecutor(_WORKERS) as pool:
        waiting = []
        for begin in begins:
            skipped, packed = dataset.id.read_direct_chunk((begin,))
            if skipped:
                raise ValueError(f"a filter was left out at {begin}")
            waiting.append(pool.submit(put, begin, packed))
        for one in waiting:
            one.result()
    return found
