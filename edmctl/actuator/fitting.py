"""Fits of actuator models: records reduced to triangles, and one convex problem for the weights.

A `Design` has the thresholds, knots and time constants that the records can support. A model is linear in its
weights once they are chosen, so a record of any length is worth only the triangular factor R of [features |
displacement]. Records are cut into contiguous blocks with a triangle each: every fit, fold and resample afterwards
is a choice among them, and never touches the samples again.

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

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmctl.actuator.model import ActuatorModel, call, consecutive, none_of
from edmctl.actuator.record import Record, length_s, sample_s
from edmctl.array_types import Array, Flags, Integers
from edmctl.dataclasses import dataclass, field, replace

BLOCKS = 64
PLAYS, HINGES = 10, 4
THRESHOLD_EXPONENT = 1.4  # thresholds lie denser near zero, where the weights of soft PZT are largest
CREEPING_SHARES = (0.0, 0.25, 0.5)  # plays that creep, by threshold over the largest
FIRST_TAU_S, FIRST_TAU_SHARE = 0.02, 1e-3
OWN_TAU_SHARE = 0.2
"""Fastest lag, at most so long and such a share of the record; slowest that has a weight of its own."""
TAU_RATIO = 5.0  # lags in steps of 5 stay within 0.6 % of a decade's creep of the logarithm of time
LONGEST_TAU_S = 4000.0  # creep is continued up to here: longer than a hole takes
ROWS_AT_ONCE, NARROW = 128, 64
"""Rows of a matrix of so many columns that are taken at once; of a wider one, four times as many."""


@dataclass(frozen=True, slots=True)
class Design:
    """What a model is to be made of; the weights are open.

    column_of : int, shape (j,); lags with the same number get the same weight
    rounded : shape (k, 4), rising and falling limit, sharpness and unloading of the rounded plays
    lag_s : of the amplifier
    """

    thresholds_v: Array
    knots_v: Array
    creep_plays: NDArray[np.int64]
    time_constants_s: Array
    column_of: NDArray[np.int64]
    low_v: float
    high_v: float
    rounded: Array = field(default_factory=lambda: none_of(0, 4))
    lag_s: float = 0.0

    @property
    def creep_columns(self) -> int:
        """Columns of creep per creeping play."""
        return int(self.column_of.max(initial=-1)) + 1

    @property
    def features(self) -> int:
        """Weights to be found."""
        plays, pieces = len(self.thresholds_v), self.knots_v.shape[1] - 1
        features: int = plays * pieces + len(self.rounded) + len(self.creep_plays) * self.creep_columns
        return features

    @property
    def first_play(self) -> slice:
        """Features of the play of threshold 0, whose slopes have a floor."""
        return slice(0, self.knots_v.shape[1] - 1)

    def model(self, weights: Array, zero_um: float, delay_s: float) -> ActuatorModel:
        """Return the model with these weights, shape (features,)."""
        plays, pieces = len(self.thresholds_v), self.knots_v.shape[1] - 1
        slopes, roundness, creep = np.split(weights, [plays * pieces, plays * pieces + len(self.rounded)])
        creep = creep.reshape(len(self.creep_plays), self.creep_columns)
        return ActuatorModel(
            thresholds_v=self.thresholds_v,
            knots_v=self.knots_v,
            slopes_um_per_v=slopes.reshape(plays, pieces).copy(),
            creep_plays=self.creep_plays,
            time_constants_s=self.time_constants_s,
            creep_um_per_v=np.ascontiguousarray(creep[:, self.column_of]),
            zero_um=zero_um,
            delay_s=delay_s,
            low_v=self.low_v,
            high_v=self.high_v,
            rounded_limits_v=self.rounded[:, :2].copy(),
            rounded_sharpness=self.rounded[:, 2].copy(),
            rounded_unloading=self.rounded[:, 3].copy(),
            rounded_um_per_v=roundness.copy(),
            lag_s=self.lag_s,
        )

    def with_rounded(self, rounded: Array) -> Design:
        """Return it with rounded plays, shape (k, 4), which creep."""
        sharp = self.creep_plays[self.creep_plays < len(self.thresholds_v)]
        creeping = len(self.thresholds_v) + np.arange(len(rounded) if len(self.time_constants_s) else 0)
        return replace(self, rounded=rounded, creep_plays=np.concatenate([sharp, creeping]))


@dataclass(frozen=True, slots=True)
class Block:
    """Consecutive samples of one record, reduced.

    triangle : shape (at most c, c), R of [one column of ones per record | features | displacement by each delay]
    record, first, end : which record, which of its samples
    low_v, high_v : shape (n,), how far each play went
    """

    triangle: Array
    samples: int
    record: int
    first: int
    end: int
    low_v: Array
    high_v: Array


@dataclass(frozen=True, slots=True)
class Reduction:
    """Records under a design.

    delays_s : delays that the displacement is advanced by; a model gets the first one
    used : samples of each record that count, shape (n,)
    sketch : shape (about 500, features), features of evenly spread samples, which show the effect of weights
    plays_v : position of the plays at each sample of each record, shape (n, plays)
    """

    design: Design
    records: Sequence[Record]
    delays_s: Array
    used: Sequence[Flags]
    blocks: tuple[Block, ...]
    sketch: Array
    plays_v: tuple[Array, ...]

    def model(self, weights: Array, zero_um: float = 0.0) -> ActuatorModel:
        """Return the model with these weights, shape (features,)."""
        return self.design.model(weights, zero_um, float(self.delays_s[0]))

    def chosen(self, block: int, values: Mapping[int, Array] | Sequence[Array]) -> Array:
        """Return the values of the samples of a block that count, from those of each record."""
        one = self.blocks[block]
        own = slice(one.first, one.end)
        chosen: Array = values[one.record][own][self.used[one.record][own]]
        return chosen


def reduce_records(
    design: Design, records: Sequence[Record], delays_s: Sequence[float] | Array, used: Sequence[Flags]
) -> Reduction:
    """Reduce those samples of the records that are used, less what comes after their end less the last delay.

    The displacement is advanced by each of the delays, so that one pass serves a whole search.
    """
    delays_s = np.asarray(delays_s, dtype=np.float64)
    total = sum(len(record.t_s) for record in records)
    plays, pieces = len(design.thresholds_v), design.knots_v.shape[1] - 1
    blocks: list[Block] = []
    sketches: list[Array] = []
    plays_v: list[Array] = []
    for number, (record, counts) in enumerate(zip(records, used, strict=True)):
        features = features_of(design, record)
        ways_v = features[:, : plays * pieces].reshape(-1, plays, pieces).sum(axis=2)
        plays_v.append(ways_v + design.knots_v[:, 0])
        rows = np.zeros((len(record.t_s), len(records) + design.features + len(delays_s)))
        rows[:, number] = 1.0
        rows[:, len(records) : len(records) + design.features] = features
        for k, delay_s in enumerate(delays_s):
            rows[:, len(records) + design.features + k] = np.interp(
                record.t_s + delay_s, record.t_s, record.y_um
            )
        end = int(np.searchsorted(record.t_s, record.t_s[-1] - delays_s.max(), side="right"))
        count = max(1, round(BLOCKS * len(record.t_s) / total))
        edges = np.linspace(int(np.argmax(counts)), end, count + 1).astype(int).tolist()
        for a, b in pairwise(edges):
            chosen = counts[a:b]
            samples = int(chosen.sum())
            if samples:
                at_v = plays_v[-1][a:b][chosen]
                reduced = triangle_of(rows[a:b][chosen])
                blocks.append(Block(reduced, samples, number, a, b, at_v.min(axis=0), at_v.max(axis=0)))
        sketches.append(features[:: max(1, total // 500)])
    return Reduction(design, records, delays_s, used, tuple(blocks), np.concatenate(sketches), tuple(plays_v))


def features_of(design: Design, record: Record) -> Array:
    """Features of every sample, shape (n, features)."""
    weights = np.zeros(design.features)
    weights[design.first_play] = 1.0
    model = design.model(weights, 0.0, 0.0)
    state = model.starting_state(record.t_s, record.u_v, record.previous_v)
    t_s, u_v = consecutive(record.t_s, record.u_v, state.t_s)
    column_of = np.ascontiguousarray(design.column_of, dtype=np.int64)
    features = np.empty((len(t_s), design.features))
    record_of = (len(t_s), t_s, u_v)
    columns = (column_of, design.creep_columns)
    call("bank_features", model.bank, state.memory(model), *record_of, *columns, features)
    return features


def choose_design(
    records: Sequence[Record], *, hinges: int = HINGES, plays: int = PLAYS, creep: bool = True
) -> Design:
    """Thresholds to half the span, knots where each play can be, time constants that the records support."""
    low_v = min(float(record.u_v.min()) for record in records)
    high_v = max(float(record.u_v.max()) for record in records)
    thresholds_v = thresholds(high_v - low_v, plays)
    taus_s, column_of = _time_constants(records) if creep else (np.empty(0), np.empty(0, dtype=np.int64))
    creeping = [int(np.abs(thresholds_v - share * thresholds_v[-1]).argmin()) for share in CREEPING_SHARES]
    return Design(
        thresholds_v=thresholds_v,
        knots_v=knots(thresholds_v, low_v, high_v, hinges),
        creep_plays=np.unique(creeping).astype(np.int64) if len(taus_s) else np.empty(0, dtype=np.int64),
        time_constants_s=taus_s,
        column_of=column_of,
        low_v=low_v,
        high_v=high_v,
    )


def knots(thresholds_v: Array, low_v: float, high_v: float, pieces: int) -> Array:
    """Return where equal pieces of each play begin and end, shape (plays, pieces + 1), V."""
    return np.linspace(low_v + thresholds_v, high_v - thresholds_v, pieces + 1, axis=1)


def thresholds(span_v: float, plays: int) -> Array:
    """Thresholds of the plays, shape (plays,), V."""
    thresholds_v: Array = 0.5 * span_v * np.power(np.arange(plays) / plays, THRESHOLD_EXPONENT)
    return thresholds_v


def _time_constants(records: Sequence[Record]) -> tuple[Array, NDArray[np.int64]]:
    """Lags from two samples to a fifth of the longest record, each with its own weight, and slower ones.

    Those share the weight of the slowest: creep runs on like the logarithm of time, and a record that ends
    cannot say otherwise.
    """
    longest_s = length_s(records)
    first_s = max(2.0 * sample_s(records), min(FIRST_TAU_S, FIRST_TAU_SHARE * longest_s))
    steps = np.log(np.array([LONGEST_TAU_S, OWN_TAU_SHARE * longest_s]) / first_s) / np.log(TAU_RATIO)
    count, own = np.maximum(1, 1 + np.floor(steps + 1e-9).astype(int)).tolist()
    taus_s: Array = first_s * np.power(TAU_RATIO, np.arange(count, dtype=np.float64))
    return taus_s, np.minimum(np.arange(count), min(count, own) - 1)


def triangle_of(rows: Array) -> Array:
    """R of a matrix, shape (min(n, c), c), by taking the rows in turn."""
    triangle = rows[:0]
    at_once = ROWS_AT_ONCE if rows.shape[1] <= NARROW else 4 * ROWS_AT_ONCE
    for first in range(0, len(rows), at_once):
        stacked = np.vstack([triangle, rows[first : first + at_once]])
        triangle = np.asarray(np.linalg.qr(stacked, mode="r"), dtype=np.float64)
    return triangle


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
