"""What a design is to have beyond plays: a rounded play and a lag, each where it predicts better.

Their parameters are the only ones that the displacement does not follow linearly, so each trial fits all weights
anew (variable projection). Features are computed over all samples and judged on every k-th, by normal equations.
That is too coarse for weights and good enough to compare: the weights of what is chosen come from `fitting`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmctl.actuator.fitting import Design, features_of, knots, minimise
from edmctl.actuator.record import LONGEST_LAG_S, Record, sample_s
from edmctl.array_types import Array, Flags

ROWS = 6000
FOLDS = 8
FINER = 2  # pieces of a play with knees that a record asks for, over the usual
RIDGE, SLOPE = 1e-9, 1e-9
NEEDED = 0.9  # what is added has to bring the held-out RMS error below this share
LEAST_UM = 1e-6
LEAST_LIMIT_SHARE, MOST_LIMIT_SHARE = 0.01, 0.5  # limits of a stop, over the span of voltage
FIRST_LIMIT_SHARES = (0.06, 0.15)
MOST_UNLOADING, MOST_BRANCH = 2.0, 0.6
TRIALS = 70
FIRST_LAGS_S = (0.0005, 0.002, 0.006)
LAG_TRIALS = 8
DELAY_STEPS = 5
MOVE_S, LEAST_MOVE_SHARE = 0.006, 0.004
SAME_STEP = 1.5
LEAST_MOVES = 200


class Extended(NamedTuple):
    """A design and the delay that goes with it."""

    design: Design
    delay_s: float


def extended(
    design: Design, records: Sequence[Record], used: Sequence[Flags], delay_s: float, *, is_fixed: bool
) -> Extended:
    """Return the design with what predicts clearly better; as it is where nothing does.

    used : samples of each record that count, shape (n,)
    is_fixed : whether the delay was given
    """
    rows = Rows(records, used)
    best, least = design, rows.held_out(Extended(design, delay_s))
    rounded = best_rounded(design, rows, delay_s)
    pieces = FINER * (design.knots_v.shape[1] - 1)
    finer_v = knots(design.thresholds_v, design.low_v, design.high_v, pieces)
    ways: list[Callable[[Design], Design]] = [
        lambda known: replace(known, knots_v=finer_v),
        lambda known: known.with_rounded(rounded),
    ]
    while ways:
        found = [rows.held_out(Extended(way(best), delay_s)) for way in ways]
        taken = int(np.argmin([_mean(errors_um) for errors_um in found]))
        if not predicts_better(found[taken], least):
            break
        best, least = ways.pop(taken)(best), found[taken]
    if best is not design and not is_fixed and rows.step_s <= LONGEST_LAG_S:
        delay_s = rows.best_delay(best, delay_s)
    without = Extended(best, delay_s)
    moves = Moves(records, used)
    if moves.count < LEAST_MOVES or moves.step_s > LONGEST_LAG_S:
        return without
    with_lag = best_lag(moves, without, is_fixed=is_fixed)
    return with_lag if predicts_better(moves.held_out(with_lag), moves.held_out(without)) else without


def vertex_delay_s(delays_s: Array, left: Sequence[float]) -> float:
    """Return the delay at the vertex of a parabola through the least value and its neighbours, not below 0."""
    middle = min(max(int(np.argmin(left)), 1), len(left) - 2)
    before, here, after = left[middle - 1 : middle + 2]
    bend = before - 2.0 * here + after
    vertex = min(max(0.5 * (before - after) / bend, -1.0), 1.0) if bend > 0.0 else 0.0
    return max(0.0, float(delays_s[middle] + vertex * (delays_s[1] - delays_s[0])))


def predicts_better(found_um: Array, before_um: Array) -> bool:
    """Whether RMS errors of folds, shape (FOLDS,), are clearly less, and so in most folds.

    Folds count alike: one that goes beyond the others, where everything extrapolates, decides nothing.
    """
    is_less = found_um < before_um
    return _mean(found_um) < NEEDED * _mean(before_um) and 2 * int(is_less.sum()) > len(is_less)


def _mean(errors_um: Array) -> float:
    return float(np.exp(np.log(np.maximum(errors_um, LEAST_UM)).mean()))


class Rows:
    """Every k-th sample of the records, to compare designs by.

    Between them, turning points are all that hysteresis needs.
    """

    def __init__(self, records: Sequence[Record], used: Sequence[Flags]) -> None:
        stride = max(1, sum(len(record.t_s) for record in records) // ROWS)
        self.step_s = sample_s(records)
        self.records: list[tuple[Record, Record]] = []
        self.picked: list[NDArray[np.int64]] = []
        for record, counts in zip(records, used, strict=True):
            is_kept = np.arange(len(record.t_s)) % stride == 0
            self._keep(record, is_kept, is_kept & counts)

    def _keep(self, record: Record, is_kept: NDArray[np.bool_], is_picked: NDArray[np.bool_]) -> None:
        direction = np.sign(np.diff(record.u_v))
        is_kept[1:-1] |= direction[1:] != direction[:-1]
        is_kept[[0, -1]] = True
        kept = record._replace(t_s=record.t_s[is_kept], u_v=record.u_v[is_kept], y_um=record.y_um[is_kept])
        self.records.append((kept, record))
        self.picked.append(np.flatnonzero(is_picked[is_kept]))

    @property
    def count(self) -> int:
        """How many."""
        return sum(len(picked) for picked in self.picked)

    def features(self, design: Design) -> Array:
        """Features, shape (rows, features)."""
        parts = zip(self.records, self.picked, strict=True)
        return np.concatenate([self.chosen(features_of(design, thin), picked) for (thin, _), picked in parts])

    def target(self, delay_s: float) -> Array:
        """Displacements advanced by the delay, shape (rows,)."""
        parts = zip(self.records, self.picked, strict=True)
        return np.concatenate(
            [
                self.chosen(np.interp(thin.t_s + delay_s, whole.t_s, whole.y_um), picked)
                for (thin, whole), picked in parts
            ]
        )

    def chosen(self, values: Array, picked: NDArray[np.int64]) -> Array:
        """Choose the rows of one record from its samples."""
        return values[picked]

    def centred(self, values: Array, rows: NDArray[np.bool_] | None = None) -> Array:
        """Without the mean of each record over the rows that are true (default: all)."""
        shifted, end = values.copy(), 0
        for picked in self.picked:
            own = slice(end, end + len(picked))
            end = own.stop
            seen = own if rows is None or not rows[own].any() else own.start + np.flatnonzero(rows[own])
            if len(picked):
                shifted[own] -= values[seen].mean(axis=0)
        return shifted

    def residual(self, trial: Extended) -> float:
        """Sum of squares that a fit of all rows leaves, µm²."""
        fitting = Trial(self.centred(self.features(trial.design)), self.centred(self.target(trial.delay_s)))
        return fitting.residual()

    def held_out(self, trial: Extended) -> Array:
        """RMS error of each fold of a blocked cross-validation, shape (FOLDS,), µm."""
        features, target = self.features(trial.design), self.target(trial.delay_s)
        fold_of = np.arange(len(target)) * FOLDS // len(target)
        rms_um, start = np.empty(FOLDS), None
        for fold in range(FOLDS):
            seen = fold_of != fold
            x, y = self.centred(features, seen), self.centred(target, seen)
            fitting = Trial(x[seen], y[seen], start)
            fitting.residual()
            start = fitting.weights
            errors_um = x[~seen] @ fitting.weights - y[~seen]
            rms_um[fold] = math.sqrt(float(np.mean(errors_um**2)))
        return rms_um

    def best_delay(self, design: Design, delay_s: float) -> float:
        """Delay near one that is known that leaves least.

        It is the vertex of a parabola through whole samples, which average no noise away; where the voltage steps
        between two samples there is no parabola, and the best whole sample stays.
        """
        delays_s, left = self.by_delay(design, delay_s)
        best, vertex_s = int(np.argmin(left)), vertex_delay_s(delays_s, left)
        is_worse = self.residual(Extended(design, vertex_s)) > left[best]
        return max(0.0, float(delays_s[best])) if is_worse else vertex_s

    def by_delay(self, design: Design, delay_s: float, least: int = -1) -> tuple[Array, list[float]]:
        """Delays of whole samples about one that is known, and what each leaves, µm²."""
        features = self.centred(self.features(design))
        first = max(least, math.floor(delay_s / self.step_s) - DELAY_STEPS // 2 + 1)
        delays_s: Array = self.step_s * np.arange(first, first + DELAY_STEPS, dtype=np.float64)
        left: list[float] = []
        start = None
        for tried_s in delays_s.tolist():
            fitting = Trial(features, self.centred(self.target(tried_s)), start)
            left.append(fitting.residual())
            start = fitting.weights
        return delays_s, left


class Moves(Rows):
    """Moves within some milliseconds instead of samples, where the records are sampled fastest: they show lags."""

    def __init__(self, records: Sequence[Record], used: Sequence[Flags]) -> None:
        self.records, self.picked = [], []
        self.step_s = min(float(np.percentile(np.diff(record.t_s), 1.0)) for record in records)
        self._span = max(1, round(MOVE_S / self.step_s))
        fast = [self._fast(record, counts) for record, counts in zip(records, used, strict=True)]
        stride = max(1, sum(int(moves.sum()) for _, moves in fast) // ROWS)
        coarse = max(1, sum(len(record.t_s) for record in records) // ROWS)
        for record, (is_fast, is_move) in zip(records, fast, strict=True):
            is_kept = is_fast | (np.arange(len(is_fast)) % coarse == 0)
            self._keep(record, is_kept, is_move & (np.cumsum(is_move) % stride == 0))

    def _fast(self, record: Record, counts: Flags) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return which samples have the fastest sampling, and which of them end a move."""
        is_fast = np.diff(record.t_s, prepend=record.t_s[0]) <= SAME_STEP * self.step_s
        is_move = np.zeros(len(is_fast), dtype=bool)
        if self._span >= len(is_fast):
            return is_fast, is_move
        fast_before = np.cumsum(is_fast)
        run: Flags = fast_before[self._span :] - fast_before[: -self._span] == self._span
        moved_v = np.abs(record.u_v[self._span :] - record.u_v[: -self._span])
        both = counts[self._span :] & counts[: -self._span]
        is_move[self._span :] = run & both & (moved_v > LEAST_MOVE_SHARE * np.ptp(record.u_v))
        return is_fast, is_move

    def chosen(self, values: Array, picked: NDArray[np.int64]) -> Array:
        """Choose changes over a move."""
        return values[picked] - values[picked - self._span]

    def centred(self, values: Array, rows: NDArray[np.bool_] | None = None) -> Array:
        """Return them as they are: a change has no zero."""
        del rows
        return values


class Trial:
    """Fits to features that stay, shape (rows, f), with others added in turn; each begins where the last ended."""

    def __init__(self, features: Array, target: Array, start: Array | None = None) -> None:
        self._features, self._target = features, target
        self._gram, self._right = features.T @ features, features.T @ target
        self._square = float(target @ target)
        self.weights = np.zeros(0) if start is None else start

    def residual(self, added: Array | None = None) -> float:
        """Sum of squares that non-negative weights leave, µm²."""
        gram, right = self._gram, self._right
        if added is not None:
            both = self._features.T @ added
            gram = np.block([[gram, both], [both.T, added.T @ added]])
            right = np.concatenate([right, added.T @ self._target])
        scale = np.sqrt(np.diag(gram))
        scale[scale <= 0.0] = 1.0
        gram = gram / np.outer(scale, scale) + RIDGE * np.eye(len(scale))
        right = right / scale
        start = self.weights * scale if len(self.weights) == len(scale) else np.zeros(len(scale))
        weights = nnls_of_normal(gram, right, start)
        self.weights = weights / scale
        return self._square + float(weights @ (gram @ weights) - 2.0 * (weights @ right))


def nnls_of_normal(gram: Array, right: Array, start: Array) -> Array:
    """Return x >= 0, shape (p,), that minimises x · gram · x - 2 right · x, from one that may be near.

    Lawson & Hanson as in `fitting.nnls`, on normal equations: an eighth of the work, and half the digits.
    """
    x, free = start.copy(), start > 0.0
    if free.any():
        x = _least(gram, right, x, free)
    tolerance = SLOPE * float(np.abs(right).max())
    for _ in range(3 * len(x)):
        slope = np.where(free, -np.inf, right - gram @ x)
        entering = int(slope.argmax())
        if slope[entering] <= tolerance:
            break
        free[entering] = True
        x = _least(gram, right, x, free)
    return x


def _least(gram: Array, right: Array, x: Array, free: Flags) -> Array:
    return minimise(lambda index: np.linalg.solve(gram[np.ix_(index, index)], right[index]), x, free)


def best_rounded(design: Design, rows: Rows, delay_s: float) -> Array:
    """Rounded play that leaves least, shape (1, 4)."""
    span_v = design.high_v - design.low_v
    trial = Trial(rows.centred(rows.features(design)), rows.centred(rows.target(delay_s)))
    alone = replace(
        design,
        thresholds_v=np.zeros(1),
        knots_v=np.array([[design.low_v, design.high_v]]),
        creep_plays=np.empty(0, dtype=np.int64),
    )

    def left(point: Array) -> float:
        features = rows.features(alone.with_rounded(_rounded(point, span_v)))
        return trial.residual(rows.centred(features[:, 1:]))

    starts = [np.array([math.log(share), 0.5, 0.5, 0.0]) for share in FIRST_LIMIT_SHARES]
    point = simplex_search(left, min(starts, key=left), np.array([0.4, 0.3, 0.3, 0.3]), TRIALS)
    return _rounded(point, span_v)


def _rounded(point: Array, span_v: float) -> Array:
    """Return limits, sharpness and unloading, shape (1, 4), of a point of the simplex."""
    share = min(max(math.exp(point[0]), LEAST_LIMIT_SHARE), MOST_LIMIT_SHARE)
    branch = MOST_BRANCH * math.tanh(point[3] / MOST_BRANCH)
    limits_v = (share * span_v * math.exp(branch), share * span_v * math.exp(-branch))
    unloading = min(max(point[2], 0.0), MOST_UNLOADING)
    return np.array([[*limits_v, min(max(point[1], 0.0), 1.0), unloading]])


def best_lag(moves: Moves, start: Extended, *, is_fixed: bool) -> Extended:
    """Add the lag that leaves least, with a delay of whole samples: the lag does the rest."""
    tried: dict[float, tuple[float, float]] = {}

    def left(lag_s: float) -> float:
        if lag_s not in tried:
            design = replace(start.design, lag_s=lag_s)
            if is_fixed:
                tried[lag_s] = moves.residual(Extended(design, start.delay_s)), start.delay_s
            else:
                delays_s, found = moves.by_delay(design, max(0.0, start.delay_s - lag_s), 0)
                tried[lag_s] = min(zip(found, delays_s.tolist(), strict=True))
        return tried[lag_s][0]

    grid = [0.0, *FIRST_LAGS_S, LONGEST_LAG_S]
    at = min(range(1, len(grid) - 1), key=lambda k: left(grid[k]))
    low, middle, high = grid[at - 1], grid[at], grid[at + 1]
    for _ in range(LAG_TRIALS):
        other = 0.5 * (low + middle) if middle - low > high - middle else 0.5 * (middle + high)
        if left(other) < left(middle):
            low, middle, high = (low, other, middle) if other < middle else (middle, other, high)
        else:
            low, high = (other, high) if other < middle else (low, other)
    return Extended(replace(start.design, lag_s=middle), tried[middle][1])


def simplex_search(left: Callable[[Array], float], first: Array, steps: Array, trials: int) -> Array:
    """Point of the least value after so many trials: Nelder & Mead, The Computer Journal 7 (1965) 308."""
    corners = [(left(point), tuple(point)) for point in (first, *(first + step for step in np.diag(steps)))]
    spent = len(corners)
    while spent < trials:
        corners.sort()
        (least, best), worst = corners[0], corners[-1]
        middle = np.mean([point for _, point in corners[:-1]], axis=0)
        away = middle - np.array(worst[1])
        tried = _valued(left, middle + away)
        spent += 1
        if tried[0] < least:
            tried, spent = min(tried, _valued(left, middle + 2.0 * away)), spent + 1
        elif tried[0] >= corners[-2][0]:
            share = 0.5 if tried[0] < worst[0] else -0.5
            tried, spent = min(tried, _valued(left, middle + share * away)), spent + 1
        if tried[0] < worst[0]:
            corners[-1] = tried
        else:
            shrunk = [0.5 * (np.array(point) + np.array(best)) for _, point in corners[1:]]
            corners[1:] = [_valued(left, point) for point in shrunk]
            spent += len(shrunk)
    return np.array(min(corners)[1])


def _valued(left: Callable[[Array], float], point: Array) -> tuple[float, tuple[float, ...]]:
    return left(point), tuple(point.tolist())
