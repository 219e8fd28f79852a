"""Non-negative least squares, small and dense.

The active-set method of Lawson & Hanson, Solving Least Squares Problems, 1974, ch. 23. It is here because
importing `scipy.optimize` takes 0.2 s, a fifth of a whole virtual run; it is tested against
`scipy.optimize.nnls`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from edmctl.actuator.triangles import triangle_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

ROUNDING = 1e-13
"""A slope this small against the largest possible one is zero."""


def nnls(matrix: Array, target: Array, start: Array | None = None) -> Array:
    """Return x ≥ 0, shape (p,), that minimises |matrix · x − target|.

    matrix : ndarray, shape (n, p); target : ndarray, shape (n,).
    start : ndarray, shape (p,), ≥ 0: where to begin. Near the solution it saves most steps.
    Raises RuntimeError when the active set does not settle within 10 p changes.
    """
    triangle = triangle_of(np.column_stack([matrix, target]))
    matrix, target = triangle[:, :-1], triangle[:, -1]
    columns = matrix.shape[1]
    tolerance = ROUNDING * float(np.linalg.norm(matrix, axis=0).max()) * float(np.linalg.norm(target))
    x = np.zeros(columns) if start is None else start.copy()
    free = x > 0.0
    if free.any():
        x = _minimise(matrix, target, x, free)
    useless = np.zeros(columns, dtype=bool)
    for _ in range(10 * columns + 1):
        slope = np.where(free | useless, -np.inf, matrix.T @ (target - matrix @ x))
        entering = int(np.argmax(slope))
        if slope[entering] <= tolerance:
            return x
        free[entering] = True
        x = _minimise(matrix, target, x, free)
        # Rounding may turn a column back at once: it waits until another one has moved x.
        if free[entering]:
            useless[:] = False
        else:
            useless[entering] = True
    raise RuntimeError(f"non-negative least squares did not settle in {10 * columns} steps")


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
