"""What a design is to have beyond plays: a rounded play and a lag, found by the residual they leave.

Their parameters are the only ones that the displacement does not follow linearly, so each trial fits all weights
anew (variable projection). Features are computed over all samples and judged on every k-th; what does not change
between trials is reduced once, to its normal equations. That is too coarse for weights and good enough to compare:
the weights of what is chosen come from `fitting`.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from edmctl.actuator.design import features_of
from edmctl.actuator.fitting import nnls

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from edmctl.actuator.design import Design
    from edmctl.actuator.record import Record

    Array = NDArray[np.float64]

ROWS = 6000
RIDGE = 1e-9
LEAST_LIMIT_SHARE, MOST_LIMIT_SHARE = 0.01, 0.5
"""Limits of a stop, over the span of voltage."""
FIRST_LIMIT_SHARES = (0.06, 0.15)
MOST_UNLOADING, MOST_BRANCH = 2.0, 0.6
TRIALS = 70


class Rows:
    """Every k-th sample of the records, for trials of designs at one delay."""

    def __init__(self, records: Sequence[Record], skip: Sequence[int], delay_s: float) -> None:
        total = sum(len(record.t_s) for record in records)
        stride = max(1, total // ROWS)
        self._records = records
        self._picked = [slice(first, None, stride) for first in skip]
        wanted = [
            np.interp(record.t_s[rows] + delay_s, record.t_s, record.y_um)
            for record, rows in zip(records, self._picked, strict=True)
        ]
        self._target = np.concatenate(wanted)
        self._free = np.zeros((len(self._target), len(records)))
        first = 0
        for number, values in enumerate(wanted):
            self._free[first : first + len(values), number] = 1.0
            first += len(values)

    def features(self, design: Design) -> Array:
        """Features of the picked samples, shape (rows, features), without each record's mean."""
        parts = [
            features_of(design, record)[rows]
            for record, rows in zip(self._records, self._picked, strict=True)
        ]
        return np.concatenate([part - part.mean(axis=0) for part in parts])

    @property
    def target(self) -> Array:
        """Displacements of the picked samples without each record's mean, shape (rows,)."""
        means = self._free.T @ self._target / self._free.sum(axis=0)
        return self._target - self._free @ means


class Trial:
    """Fits of a target to features that stay, with others added in turn; each search begins where the last ended."""

    def __init__(self, features: Array, target: Array) -> None:
        self._features, self._target = features, target
        self._gram, self._right = features.T @ features, features.T @ target
        self._square = float(target @ target)
        self._start: Array | None = None

    def residual(self, added: Array | None = None) -> float:
        """Sum of squares that non-negative weights leave, µm²."""
        gram, right = self._gram, self._right
        if added is not None:
            both = self._features.T @ added
            gram = np.block([[gram, both], [both.T, added.T @ added]])
            right = np.concatenate([right, added.T @ self._target])
        scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        gram = gram / np.outer(scale, scale) + RIDGE * np.eye(len(scale))
        right = right / scale
        triangle = np.linalg.cholesky(gram).T
        wanted = np.linalg.solve(triangle.T, right)
        start = self._start if self._start is not None and len(self._start) == len(right) else None
        weights = nnls(triangle, wanted, start)
        self._start = weights
        return self._square + float(weights @ (gram @ weights) - 2.0 * (weights @ right))


def best_rounded(design: Design, rows: Rows) -> Array:
    """Rounded play that leaves least, shape (1, 4)."""
    span_v = design.high_v - design.low_v
    target = rows.target
    trial = Trial(rows.features(design), target)
    alone = replace(
        design,
        thresholds_v=np.zeros(1),
        knots_v=np.array([[design.low_v, design.high_v]]),
        creep_plays=np.empty(0, dtype=np.int64),
    )

    def left(point: Array) -> float:
        features = rows.features(alone.with_rounded(_rounded(point, span_v)))
        return trial.residual(features[:, 1:])

    starts = [np.array([math.log(share), 0.5, 0.5, 0.0]) for share in FIRST_LIMIT_SHARES]
    first = min(starts, key=left)
    point = simplex_search(left, first, np.array([0.4, 0.3, 0.3, 0.3]), TRIALS)
    return _rounded(point, span_v)


def _rounded(point: Array, span_v: float) -> Array:
    """A row of limits, sharpness and unloading of any point."""
    share = min(max(math.exp(point[0]), LEAST_LIMIT_SHARE), MOST_LIMIT_SHARE)
    branch = MOST_BRANCH * math.tanh(point[3] / MOST_BRANCH)
    return np.array(
        [
            [
                share * span_v * math.exp(branch),
                share * span_v * math.exp(-branch),
                min(max(point[1], 0.0), 1.0),
                min(max(point[2], 0.0), MOST_UNLOADING),
            ]
        ]
    )


def simplex_search(left: Callable[[Array], float], first: Array, steps: Array, trials: int) -> Array:
    """Point of the least value after so many trials: Nelder & Mead, The Computer Journal 7 (1965) 308."""
    points = [first, *(first + step for step in np.diag(steps))]
    corners = sorted(((left(point), tuple(point)) for point in points), key=lambda one: one[0])
    spent = len(corners)
    while spent < trials:
        middle = np.mean([point for _, point in corners[:-1]], axis=0)
        worst, far = corners[-1][0], np.array(corners[-1][1])

        def at(share: float, middle: Array = middle, far: Array = far) -> tuple[float, tuple[float, ...]]:
            point = middle + share * (middle - far)
            return left(point), tuple(point)

        tried = at(1.0)
        spent += 1
        if tried[0] < corners[0][0]:
            tried = min(tried, at(2.0))
            spent += 1
        elif tried[0] >= corners[-2][0]:
            tried = min(tried, at(0.5 if tried[0] < worst else -0.5))
            spent += 1
        if tried[0] < worst:
            corners[-1] = tried
        else:
            best = np.array(corners[0][1])
            shrunk = [best + 0.5 * (np.array(point) - best) for _, point in corners[1:]]
            corners[1:] = [(left(point), tuple(point)) for point in shrunk]
            spent += len(shrunk)
        corners.sort(key=lambda one: one[0])
    return np.array(corners[0][1])
