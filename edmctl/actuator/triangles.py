"""The triangular factor of a tall matrix: all that a least-squares problem needs of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

ROWS_AT_ONCE = 128


def triangle_of(rows: Array) -> Array:
    """R of a matrix, shape (min(n, c), c), by taking the rows in turn."""
    triangle = rows[:0]
    for first in range(0, len(rows), ROWS_AT_ONCE):
        stacked = np.vstack([triangle, rows[first : first + ROWS_AT_ONCE]])
        triangle = np.asarray(np.linalg.qr(stacked, mode="r"), dtype=np.float64)
    return triangle


def one_thread() -> AbstractContextManager[object]:
    """Context in which BLAS keeps to one thread.

    Matrices here are small: threads would only wait for each other, on busy cores 40 ms at a time.
    """
    from threadpoolctl import threadpool_limits

    limits: AbstractContextManager[object] = threadpool_limits(limits=1, user_api="blas")
    return limits
