"""The operators that hysteresis and creep are made of, sample by sample.

Play of threshold r (volts): z_k = max(u_k − r, min(u_k + r, z_{k−1})), Krasnosel'skii & Pokrovskii 1989. It
needs no time: between turning points only the end matters. A play's output is bent by hinges, straight pieces
between knots (Prandtl's form of a discrete Preisach operator). Creep is a bank of first-order lags behind some
of the plays, L' = (z − L)/τ, exact for a play that moves in a straight line from sample to sample, so that a
record may be sampled at any rate.

Everything here is compiled by numba, without fastmath: the source is the definition, bit for bit.

Arrays: thresholds (n,), knots (n, m+1), slopes (n, m), creeping (g,) indices of plays, taus (j,), creep weights
(g, j); state plays (n,), lags (g, j).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from edmctl.actuator.compiling import cached, compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array: TypeAlias = NDArray[np.float64]
    Indices: TypeAlias = NDArray[np.int64]

SAME_STEP = 1e-9
"""Steps of a clock differ by its rounding, which is no reason to compute every lag anew."""
ENOUGH = 1e-14
"""A displacement is met within this share of the range times the steepest slope of the first play."""
ITERATIONS = 200
"""Bound of the root search; regula falsi needs about six, bisection alone fifty."""


@compiled
def play(threshold_v: float, u_v: float, z_v: float) -> float:
    """One play operator: where it is after the voltage went monotonically to `u_v`."""
    if z_v < u_v - threshold_v:
        return u_v - threshold_v
    if z_v > u_v + threshold_v:
        return u_v + threshold_v
    return z_v


@compiled
def hinge(knots: Array, piece: int, z_v: float) -> float:
    """How far `z_v` has come along one piece; the first piece is open below, the last above."""
    last = knots.shape[0] - 2
    if piece > 0 and z_v < knots[piece]:
        return 0.0
    if piece < last and z_v > knots[piece + 1]:
        return float(knots[piece + 1] - knots[piece])
    return float(z_v - knots[piece])


@compiled
def bent(knots: Array, slopes: Array, z_v: float) -> float:
    """One bent play at `z_v`, µm: the sum of slope times hinge over its pieces."""
    total = 0.0
    last = slopes.shape[0] - 1
    for piece in range(last):
        if z_v <= knots[piece + 1]:
            return float(total + slopes[piece] * (z_v - knots[piece]))
        total += slopes[piece] * (knots[piece + 1] - knots[piece])
    return float(total + slopes[last] * (z_v - knots[last]))


@compiled
def static_um(thresholds: Array, knots: Array, slopes: Array, plays: Array, u_v: float) -> float:
    """Sum of all bent plays at `u_v`, µm; the state stays."""
    total = 0.0
    for i in range(thresholds.shape[0]):
        total += bent(knots[i], slopes[i], play(thresholds[i], u_v, plays[i]))
    return total


@compiled
def creep_um(
    thresholds: Array,
    creeping: Indices,
    weights: Array,
    plays: Array,
    lags: Array,
    follow: Array,
    u_v: float,
) -> float:
    """Sum of all creep at `u_v` after a move that takes the time of `follow` (3, j); the state stays."""
    total = 0.0
    for g in range(creeping.shape[0]):
        before = plays[creeping[g]]
        after = play(thresholds[creeping[g]], u_v, before)
        for j in range(follow.shape[1]):
            total += weights[g, j] * (
                follow[0, j] * lags[g, j] + follow[1, j] * before + follow[2, j] * after
            )
    return total


@compiled
def step(thresholds: Array, creeping: Indices, plays: Array, lags: Array, follow: Array, u_v: float) -> None:
    """Advance the state to `u_v`."""
    for g in range(creeping.shape[0]):
        before = plays[creeping[g]]
        after = play(thresholds[creeping[g]], u_v, before)
        for j in range(follow.shape[1]):
            lags[g, j] = follow[0, j] * lags[g, j] + follow[1, j] * before + follow[2, j] * after
    for i in range(thresholds.shape[0]):
        plays[i] = play(thresholds[i], u_v, plays[i])


@compiled
def following(taus: Array, elapsed_s: float, follow: Array) -> None:
    """How each lag follows a straight move of `elapsed_s`: its share of itself, of the start, of the end.

    `follow` (3, j); the shares sum to 1. In no time a lag stays where it is.
    """
    for j in range(taus.shape[0]):
        share = elapsed_s / taus[j]
        stays = math.exp(-share)
        mean = -math.expm1(-share) / share if share > 0.0 else 1.0
        follow[0, j], follow[1, j], follow[2, j] = stays, mean - stays, 1.0 - mean


@compiled
def followed(taus: Array, step_s: float, known_s: float, follow: Array) -> float:
    """Bring `follow`, which is for moves of `known_s`, to moves of `step_s`; the time that it is for now."""
    if abs(step_s - known_s) > SAME_STEP * known_s:
        following(taus, step_s, follow)
        return step_s
    return known_s


@cached
def advance_bank(
    t_s: Array,
    u_v: Array,
    since_s: float,
    thresholds: Array,
    knots: Array,
    slopes: Array,
    creeping: Indices,
    taus: Array,
    weights: Array,
    plays: Array,
    lags: Array,
    follow: Array,
    output: Array,
) -> None:
    """Advance the state over k samples; `output` (k,) receives the displacement, µm.

    `since_s` is the time that the state belongs to; `follow` (3, j) is room to work in.
    """
    # Most steps move few of the plays: the others keep their part of the sum.
    parts = np.empty(thresholds.shape[0])
    for i in range(thresholds.shape[0]):
        parts[i] = bent(knots[i], slopes[i], plays[i])
    before_s, elapsed_s = since_s, 0.0
    following(taus, elapsed_s, follow)
    for k in range(t_s.shape[0]):
        elapsed_s = followed(taus, t_s[k] - before_s, elapsed_s, follow)
        before_s = t_s[k]
        creep = 0.0
        for g in range(creeping.shape[0]):
            before = plays[creeping[g]]
            after = play(thresholds[creeping[g]], u_v[k], before)
            lag, weight = lags[g], weights[g]
            for j in range(follow.shape[1]):
                lag[j] = follow[0, j] * lag[j] + (follow[1, j] * before + follow[2, j] * after)
            own = 0.0  # a sum for each play: additions wait for each other
            for j in range(follow.shape[1]):
                own += weight[j] * lag[j]
            creep += own
        total = 0.0
        for i in range(thresholds.shape[0]):
            z = play(thresholds[i], u_v[k], plays[i])
            if z != plays[i]:
                plays[i] = z
                parts[i] = bent(knots[i], slopes[i], z)
            total += parts[i]
        output[k] = total + creep


@cached
def bank_features(
    t_s: Array,
    u_v: Array,
    since_s: float,
    thresholds: Array,
    knots: Array,
    creeping: Indices,
    taus: Array,
    column_of: Indices,
    plays: Array,
    lags: Array,
    follow: Array,
    features: Array,
) -> None:
    """Advance the state over k samples; `features` (k, f) receives every bent play and every column of creep.

    Lags with the same entry in `column_of` (j,) share one column, so that they get the same weight.
    """
    pieces = knots.shape[1] - 1
    first_creep = thresholds.shape[0] * pieces
    columns = column_of[-1] + 1 if column_of.shape[0] else 0
    before_s, elapsed_s = since_s, 0.0
    following(taus, elapsed_s, follow)
    for k in range(t_s.shape[0]):
        elapsed_s = followed(taus, t_s[k] - before_s, elapsed_s, follow)
        before_s = t_s[k]
        step(thresholds, creeping, plays, lags, follow, u_v[k])
        for i in range(thresholds.shape[0]):
            for m in range(pieces):
                features[k, i * pieces + m] = hinge(knots[i], m, plays[i])
        for c in range(creeping.shape[0] * columns):
            features[k, first_creep + c] = 0.0
        for g in range(creeping.shape[0]):
            for j in range(taus.shape[0]):
                features[k, first_creep + g * columns + column_of[j]] += lags[g, j]


@compiled
def solve_voltage(
    y_um: float,
    low_v: float,
    high_v: float,
    thresholds: Array,
    knots: Array,
    slopes: Array,
    creeping: Indices,
    weights: Array,
    plays: Array,
    lags: Array,
    follow: Array,
) -> tuple[float, bool]:
    """Voltage in [low_v, high_v] at which the bank gives `y_um`, False; the nearer end where none does, True.

    The displacement rises strictly with the voltage from any state, so a bracket always holds the one root:
    regula falsi, Illinois variant, until the bracket is as narrow as numbers are.
    """
    low, high = low_v, high_v
    enough = ENOUGH * (high - low) * slopes[0].max()
    below = (
        static_um(thresholds, knots, slopes, plays, low)
        + creep_um(thresholds, creeping, weights, plays, lags, follow, low)
        - y_um
    )
    if below >= 0.0:
        return low, below > enough
    above = (
        static_um(thresholds, knots, slopes, plays, high)
        + creep_um(thresholds, creeping, weights, plays, lags, follow, high)
        - y_um
    )
    if above <= 0.0:
        return high, above < -enough
    side = 0
    for _ in range(ITERATIONS):
        u = high - above * (high - low) / (above - below)
        if not low < u < high:
            u = 0.5 * (low + high)
        if not low < u < high:
            break
        error = (
            static_um(thresholds, knots, slopes, plays, u)
            + creep_um(thresholds, creeping, weights, plays, lags, follow, u)
            - y_um
        )
        if abs(error) <= enough:
            return u, False
        if error < 0.0:
            low, below = u, error
            if side < 0:
                above *= 0.5
            side = -1
        else:
            high, above = u, error
            if side > 0:
                below *= 0.5
            side = 1
    return 0.5 * (low + high), False


@cached
def solve_bank(
    t_s: Array,
    y_um: Array,
    since_s: float,
    low_v: float,
    high_v: float,
    thresholds: Array,
    knots: Array,
    slopes: Array,
    creeping: Indices,
    taus: Array,
    weights: Array,
    plays: Array,
    lags: Array,
    follow: Array,
    output: Array,
    beyond: NDArray[np.bool_],
) -> None:
    """Advance the state along the voltages that give `y_um` (k,), into `output` (k,); `beyond` (k,): none does."""
    before_s, elapsed_s = since_s, 0.0
    following(taus, elapsed_s, follow)
    for k in range(t_s.shape[0]):
        elapsed_s = followed(taus, t_s[k] - before_s, elapsed_s, follow)
        before_s = t_s[k]
        u, beyond[k] = solve_voltage(
            y_um[k],
            low_v,
            high_v,
            thresholds,
            knots,
            slopes,
            creeping,
            weights,
            plays,
            lags,
            follow,
        )
        step(thresholds, creeping, plays, lags, follow, u)
        output[k] = u
