"""Non-negative least squares, small and dense.

The active-set method of Lawson & Hanson, Solving Least Squares Problems, 1974, ch. 23. It is here because
importing `scipy.optimize` takes 0.2 s, a fifth of a whole virtual run; it is tested against
`scipy.optimize.nnls`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

ROUNDING = 1e-13
"""A slope this small against the largest possible one is zero."""
ROWS_AT_ONCE = 128
"""Small enough that BLAS stays on one thread: on busy cores its threads wait 40 ms for each other."""


def nnls(matrix: Array, target: Array) -> Array:
    """Return x ≥ 0, shape (p,), that minimises |matrix · x − target|.

    matrix : ndarray, shape (n, p); target : ndarray, shape (n,).
    Raises RuntimeError when the active set does not settle within 10 p changes.
    """
    matrix, target = _reduce(matrix, target)
    columns = matrix.shape[1]
    tolerance = ROUNDING * float(np.linalg.norm(matrix, axis=0).max()) * float(np.linalg.norm(target))
    x = np.zeros(columns)
    free = np.zeros(columns, dtype=bool)
    for _ in range(10 * columns + 1):
        slope = np.where(free, -np.inf, matrix.T @ (target - matrix @ x))
        entering = int(np.argmax(slope))
        if slope[entering] <= tolerance:
            return x
        free[entering] = True
        x = _minimise(matrix, target, x, free)
    raise RuntimeError(f"non-negative least squares did not settle in {10 * columns} steps")


def _reduce(matrix: Array, target: Array) -> tuple[Array, Array]:
    """Return at most p + 1 rows with the same sums of squares, by QR of the rows taken in turn."""
    rows = np.column_stack([matrix, target])
    triangle = rows[:0]
    for first in range(0, len(rows), ROWS_AT_ONCE):
        stacked = np.vstack([triangle, rows[first : first + ROWS_AT_ONCE]])
        triangle = np.asarray(np.linalg.qr(stacked, mode="r"), dtype=np.float64)
    return triangle[:, :-1], triangle[:, -1]


def _minimise(matrix: Array, target: Array, x: Array, free: NDArray[np.bool_]) -> Array:
    """Minimise over the free columns; while one turns negative, step to the border and fix it there."""
    while True:
        wanted = np.zeros_like(x)
        wanted[free] = np.linalg.lstsq(matrix[:, free], target, rcond=None)[0]
        crossing = free & (wanted <= 0.0)
        if not crossing.any():
            return wanted
        steps = np.full_like(x, np.inf)
        steps[crossing] = x[crossing] / (x[crossing] - wanted[crossing])
        step = float(steps.min())
        x = x + step * (wanted - x)
        free &= steps > step
        x = np.where(free, x, 0.0)
