"""The one convex problem behind an identification: non-negative weights, free zeros, a floor under the slope.

min |X·b + zero − y|² + λ N |b|² + μ N |D·b|² with b ≥ 0, columns scaled to RMS 1. D takes second differences of
the slopes from play to play, per volt of threshold: neighbouring plays of a material are alike, and slopes that
vary smoothly carry over to swings that the records do not hold. The zeros of the records are eliminated exactly
by the order of the columns in the triangles. The play of threshold 0, which is the immediate answer to the
voltage, keeps at least a small slope, so that every model that comes out can be inverted.

The solver is the active-set method of Lawson & Hanson, Solving Least Squares Problems, 1974, ch. 23. It is here
because importing `scipy.optimize` takes 0.2 s, a fifth of a whole virtual run; it is tested against
`scipy.optimize.nnls`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmctl.actuator.design import Design, Reduction, triangle_of
from edmctl.array_types import Array, Flags, Integers
from edmctl.dataclasses import dataclass

RIDGE = 1e-10  # only settles what the records leave open: held-out errors do not change from here to 1e-6
FLOOR_SHARE = 0.01
"""Least slope of the play of threshold 0, of the mean slope; it is half of it in measured actuators."""
STANDS_SHARE = 0.1  # of the mean slope; where a long move brings less, the tool stands
ROUNDING = 1e-13  # a slope this small against the largest possible one is zero


@dataclass(frozen=True, slots=True)
class Fit:
    """Weights, shape (features,), zero of each record (NaN: not fitted), sum of squared residuals, µm², and μ.

    on_floor : whether the data want less slope somewhere than the floor leaves, and no play makes up for it.
    """

    weights: Array
    zeros_um: Array
    residual_um2: float
    smoothness: float
    on_floor: bool


def fit(
    reduction: Reduction,
    *,
    delay: int = 0,
    smoothness: float = 0.0,
    times: Sequence[int] | None = None,
    start: Array | None = None,
) -> Fit:
    """Fit the blocks, each counted `times` (default once), to the displacement of delay number `delay`.

    smoothness : μ
    start : weights to begin the search from; a near solution saves most of the work.
    """
    design, free = reduction.design, len(reduction.records)
    features = design.features
    counts = [1] * len(reduction.blocks) if times is None else times
    columns = [*range(free + features), free + features + delay]
    chosen = [
        block.triangle[:, columns] * count**0.5
        for block, count in zip(reduction.blocks, counts, strict=True)
        if count
    ]
    triangle = triangle_of(np.vstack(chosen))
    samples = sum(block.samples * count for block, count in zip(reduction.blocks, counts, strict=True))
    matrix, target = triangle[free:, free:-1], triangle[free:, -1]
    floor_um_per_v = FLOOR_SHARE * mean_slope(design, matrix, target)
    floor = np.zeros(features)
    floor[design.first_play] = floor_um_per_v
    first = None if start is None else np.maximum(start - floor, 0.0)
    weights = floor + _non_negative(design, matrix, target - matrix @ floor, samples, smoothness, first)
    residual = matrix @ weights - target
    zeros_um = _zeros(triangle[:free, :free], triangle[:free, -1] - triangle[:free, free:-1] @ weights)
    on_floor = _stands(design, weights, floor_um_per_v)
    return Fit(weights, zeros_um, float(residual @ residual), smoothness, on_floor)


def _stands(design: Design, weights: Array, floor_um_per_v: float) -> bool:
    """Whether neither the voltage itself nor all plays together move the tool in some piece."""
    plays, pieces = len(design.thresholds_v), design.knots_v.shape[1] - 1
    together = weights[: plays * pieces].reshape(plays, pieces).sum(axis=0)
    together += weights[plays * pieces :].sum() if len(design.rounded) else 0.0
    on_floor = weights[design.first_play] <= 1.001 * floor_um_per_v
    return bool((on_floor & (together <= STANDS_SHARE * floor_um_per_v / FLOOR_SHARE)).any())


def _non_negative(
    design: Design, matrix: Array, target: Array, samples: int, smoothness: float, start: Array | None
) -> Array:
    scale = np.linalg.norm(matrix, axis=0) / np.sqrt(samples)
    moved = scale > 1e-9 * scale.max()
    scale[~moved] = scale.max()
    ridge = np.diag(np.full(design.features, np.sqrt(RIDGE * samples)))
    bends = curvature(design) * float(scale[design.first_play].sum()) * np.sqrt(smoothness * samples)
    stacked = np.vstack([matrix / scale, ridge, bends / scale])
    wanted = np.zeros(len(stacked))
    wanted[: len(target)] = target
    weights: Array = nnls(stacked, wanted, None if start is None else start * scale) / scale
    return weights


def _zeros(triangle: Array, right: Array) -> Array:
    zeros_um = np.full(len(right), np.nan)
    known = np.abs(np.diag(triangle)) > 0.0
    zeros_um[known] = np.linalg.solve(triangle[np.ix_(known, known)], right[known])
    return zeros_um


def mean_slope(design: Design, matrix: Array, target: Array) -> float:
    """Slope of the straight line through the data, µm/V; the play of threshold 0 is the voltage itself."""
    voltage = matrix[:, design.first_play].sum(axis=1)
    return max(0.0, float(voltage @ target) / max(float(voltage @ voltage), 1e-300))


def curvature(design: Design) -> Array:
    """Second differences of slopes per volt of threshold, times the mean width, shape (k, features).

    The play of threshold 0 is left out: it is the reversible answer, not one of a family.
    """
    plays, pieces = len(design.thresholds_v), design.knots_v.shape[1] - 1
    if plays < 4:
        return np.empty((0, design.features))
    width_v = np.gradient(design.thresholds_v)
    mean_v = float(width_v[1:].mean())
    rows = np.zeros((plays - 3, pieces, design.features))
    for k in range(len(rows)):
        for piece in range(pieces):
            for play, share in ((k + 1, 1.0), (k + 2, -2.0), (k + 3, 1.0)):
                rows[k, piece, play * pieces + piece] = share * mean_v / width_v[play]
    return rows.reshape(-1, design.features)


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


def _minimise(matrix: Array, target: Array, x: Array, free: Flags) -> Array:
    return minimise(lambda index: np.linalg.lstsq(matrix[:, index], target, rcond=None)[0], x, free)


def minimise(solve: Callable[[Integers], NDArray[np.floating[Any]]], x: Array, free: Flags) -> Array:
    """Minimise over the free entries of x; while one turns negative, step to the border and fix it there.

    solve : minimum over the entries with these numbers, without bounds
    """
    while True:
        index = np.flatnonzero(free)
        wanted, here = solve(index), x[index]
        x = np.zeros_like(x)
        if wanted.min(initial=1.0) > 0.0:
            x[index] = wanted
            return x
        crossing = wanted <= 0.0
        steps = np.full(len(here), np.inf)
        np.divide(here, here - wanted, out=steps, where=crossing & (here > wanted))
        steps[crossing & (here <= wanted)] = 0.0
        step = float(steps.min())
        x[index] = here + step * (wanted - here)
        gone = index[steps <= step]
        free[gone] = False
        x[gone] = 0.0
