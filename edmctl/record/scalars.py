"""Reads single values of a run file through h5py's low-level calls, which take a quarter of the time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import h5py
import numpy as np
from h5py import h5d, h5s, h5t

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

_TEXT = h5py.string_dtype()
_TEXT_TYPE = h5t.py_create(_TEXT)
_WORD = h5py.string_dtype("utf-8", 16)
"""No word of a table is longer."""


def read_text(file: h5py.File, path: str) -> str:
    """Return the text at `path`. Raises what h5py raises; KeyError when there is none."""
    dataset = h5d.open(file.id, path.encode())
    kind = dataset.get_type()
    if kind.get_class() != h5t.STRING:
        raise TypeError(f"{path} is no text")
    if kind.is_variable_str():
        value = np.empty((), _TEXT)
        dataset.read(h5s.ALL, h5s.ALL, value, _TEXT_TYPE)
    else:
        value = np.empty((), f"S{kind.get_size()}")
        dataset.read(h5s.ALL, h5s.ALL, value, kind)
    utf8: bytes = value.item() or b""
    return utf8.decode()


def read_number(file: h5py.File, path: str) -> float:
    """Return the number at `path`. Raises what h5py raises; KeyError when there is none."""
    value = np.empty((), np.float64)
    h5d.open(file.id, path.encode()).read(h5s.ALL, h5s.ALL, value, h5t.NATIVE_DOUBLE)
    return float(value)


def read_fields(
    file: h5py.File, path: str, numbers: Sequence[str], words: Sequence[str] = ()
) -> NDArray[np.void]:
    """Return fields of a compound table, shape (rows,): float64, and bytes of a word. Raises what h5py raises.

    A field that an older file does not have is 0, or empty.
    """
    dataset = h5d.open(file.id, path.encode())
    (rows,) = dataset.shape
    table: NDArray[np.void] = np.zeros(
        rows, [*((name, "f8") for name in numbers), *((name, _WORD) for name in words)]
    )
    if rows:
        dataset.read(h5s.ALL, h5s.ALL, table)
    return table
