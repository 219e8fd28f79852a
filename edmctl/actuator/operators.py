"""The operators that hysteresis and creep are made of, sample by sample.

Play of threshold r (volts): z_k = max(u_k − r, min(u_k + r, z_{k−1})), Krasnosel'skii & Pokrovskii 1989. It
needs no time: between turning points only the end matters. A play's output is bent by hinges, straight pieces
between knots (Prandtl's form of a discrete Preisach operator). Creep is a bank of first-order lags behind some
of the plays, L' = (z − L)/τ, exact for a play that moves in a straight line from sample to sample, so that a
record may be sampled at any rate.

A rounded play is C·u − s with a stop s that forgets with the way of the voltage (Bouc 1967, Wen 1976; Dahl's and
Duhem's friction are of the kind). With σ = ±s over the limit of the direction that the voltage moves in and the way
w over that limit,

    dσ/dw = (1 − σ)(1 + c·σ) for σ ≥ 0, loading;  1 + ρ·((1 − c)|σ| + c·σ²) for σ < 0, unloading:

c = 0 and 1 are the equation's powers 1 and 2, between lie those between, two limits make branches differ, and moves
have a closed form. C is the steepest that s can rise, so that a rounded play never falls while the voltage rises.

The amplifier's lag u_f' = (u − u_f)/τ comes before all of them, exact for a voltage that goes straight from sample
to sample. u_f may turn between two samples, where it crosses u: a path has its turning points too.

Everything here is compiled by numba, without fastmath: the source is the definition, bit for bit.

`before_v` is the voltage that the state belongs to.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmctl.actuator.compiling import cached, compiled
from edmctl.array_types import Array, Integers

SAME_STEP = 1e-9
"""Steps of a clock differ by its rounding, which is no reason to compute every lag anew."""
ENOUGH = 1e-14
"""A displacement is met within this share of the range times the steepest slope of the first play."""
STRAIGHT = 1e-7
"""A stop unloads along a straight line below this root of its equation's discriminant."""
ITERATIONS = 200
"""Bound of the root search; regula falsi needs about six, bisection alone fifty."""


class Bank(NamedTuple):
    """Parameters: n sharp plays of m pieces, k rounded ones, g of them with j lags each."""

    thresholds: Array  # (n,)
    knots: Array  # (n, m+1)
    slopes: Array  # (n, m)
    rounded: Array  # (k, 5): rising and falling limit, c, ρ, C
    roundness: Array  # (k,): weights
    creeping: Integers  # (g,): plays, from n on rounded ones
    taus: Array  # (j,)
    weights: Array  # (g, j): of the lags


class Memory(NamedTuple):
    """State; the arrays change in place."""

    plays: Array  # (n,)
    stops: Array  # (k,)
    lags: Array  # (g, j)


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
def stop(rounded: Array, move_v: float, stop_v: float) -> float:
    """One stop of a rounded play, row (5,), after the voltage moved monotonically by `move_v`."""
    if move_v == 0.0:
        return stop_v
    limit = rounded[0] if move_v > 0.0 else -rounded[1]
    c, way, at = rounded[2], move_v / limit, stop_v / limit
    if at < 0.0:
        # A Riccati equation with constant coefficients, 1 + b·σ + a·σ²: its moves are fractions of C and S.
        a, half_b = rounded[3] * c, -0.5 * rounded[3] * (1.0 - c)
        bend = half_b * half_b - a
        root = math.sqrt(abs(bend))
        end = -at / (1.0 + half_b * at)
        if root > STRAIGHT:
            end = math.atanh(root * end) / root if bend > 0.0 else math.atan(root * end) / root
        if way < end:
            both, slope = 1.0, way
            if root > STRAIGHT:
                both = math.cosh(root * way) if bend > 0.0 else math.cos(root * way)
                slope = math.sinh(root * way) / root if bend > 0.0 else math.sin(root * way) / root
            return float(limit * (at * (both + half_b * slope) + slope) / (both - (half_b + a * at) * slope))
        at, way = 0.0, way - end
    left = (1.0 - at) / (1.0 + c * at) * math.exp(-(1.0 + c) * way)
    return float(limit * (1.0 - left) / (1.0 + c * left))


@compiled
def lagged(lag_s: float, elapsed_s: float, from_v: float, u_v: float, lagged_v: float) -> float:
    """Voltage behind the lag, `elapsed_s` after `lagged_v`; before the lag it went straight, `from_v` to `u_v`."""
    if lag_s == 0.0:
        return u_v
    share = elapsed_s / lag_s
    if share == 0.0:
        return lagged_v
    stays = math.exp(-share)
    mean = -math.expm1(-share) / share
    return stays * lagged_v + (mean - stays) * from_v + (1.0 - mean) * u_v


@compiled
def turn_s(lag_s: float, elapsed_s: float, from_v: float, u_v: float, lagged_v: float) -> float:
    """When within the move the voltage behind the lag turns, s; 0 where it does not."""
    if lag_s == 0.0 or elapsed_s <= 0.0 or (lagged_v - from_v) * (u_v - from_v) <= 0.0:
        return 0.0
    at_s = lag_s * math.log1p((lagged_v - from_v) * elapsed_s / ((u_v - from_v) * lag_s))
    return at_s if at_s < elapsed_s else 0.0


@cached
def lagged_path(
    t_s: Array,
    u_v: Array,
    since_s: float,
    from_v: float,
    lagged_v: float,
    lag_s: float,
    times: Array,
    volts: Array,
    ends: Integers,
) -> int:
    """Voltage behind the lag at k samples and its turning points between them; how many they are together.

    times, volts : ndarray, shape (2 k,); receive them
    ends : ndarray, shape (k,); receives where the samples are among them
    """
    count = 0
    before_s = since_s
    for k in range(t_s.shape[0]):
        elapsed_s = t_s[k] - before_s
        at_s = turn_s(lag_s, elapsed_s, from_v, u_v[k], lagged_v)
        if at_s > 0.0:
            times[count] = before_s + at_s
            volts[count] = from_v + (u_v[k] - from_v) * (at_s / elapsed_s)
            count += 1
        lagged_v = lagged(lag_s, elapsed_s, from_v, u_v[k], lagged_v)
        times[count], volts[count], ends[k] = t_s[k], lagged_v, count
        count += 1
        before_s, from_v = t_s[k], u_v[k]
    return count


@compiled
def standing(bank: Bank, memory: Memory, u_v: float, index: int) -> float:
    """Where a play is, V; from the last of the sharp ones on, a rounded one."""
    if index < bank.thresholds.shape[0]:
        return float(memory.plays[index])
    k = index - bank.thresholds.shape[0]
    return float(bank.rounded[k, 4] * u_v - memory.stops[k])


@compiled
def moved(bank: Bank, memory: Memory, before_v: float, u_v: float, index: int) -> float:
    """Where it is after a monotone move; the state stays."""
    if index < bank.thresholds.shape[0]:
        return play(bank.thresholds[index], u_v, memory.plays[index])
    k = index - bank.thresholds.shape[0]
    return float(bank.rounded[k, 4] * u_v - stop(bank.rounded[k], u_v - before_v, memory.stops[k]))


@compiled
def answer_um(bank: Bank, memory: Memory, before_v: float, follow: Array, u_v: float) -> float:
    """Displacement after a monotone move to `u_v` that takes the time of `follow` (3, j), µm; the state stays."""
    total = 0.0
    for i in range(bank.thresholds.shape[0]):
        total += bent(bank.knots[i], bank.slopes[i], play(bank.thresholds[i], u_v, memory.plays[i]))
    for k in range(bank.rounded.shape[0]):
        total += bank.roundness[k] * (
            bank.rounded[k, 4] * u_v - stop(bank.rounded[k], u_v - before_v, memory.stops[k])
        )
    for g in range(bank.creeping.shape[0]):
        before = standing(bank, memory, before_v, bank.creeping[g])
        after = moved(bank, memory, before_v, u_v, bank.creeping[g])
        for j in range(follow.shape[1]):
            total += bank.weights[g, j] * (
                follow[0, j] * memory.lags[g, j] + follow[1, j] * before + follow[2, j] * after
            )
    return total


@compiled
def step(bank: Bank, memory: Memory, before_v: float, follow: Array, u_v: float) -> None:
    """Advance the state to `u_v`."""
    for g in range(bank.creeping.shape[0]):
        before = standing(bank, memory, before_v, bank.creeping[g])
        after = moved(bank, memory, before_v, u_v, bank.creeping[g])
        for j in range(follow.shape[1]):
            memory.lags[g, j] = (
                follow[0, j] * memory.lags[g, j] + follow[1, j] * before + follow[2, j] * after
            )
    for i in range(bank.thresholds.shape[0]):
        memory.plays[i] = play(bank.thresholds[i], u_v, memory.plays[i])
    for k in range(bank.rounded.shape[0]):
        memory.stops[k] = stop(bank.rounded[k], u_v - before_v, memory.stops[k])


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


@compiled
def advance_path(
    t_s: Array,
    u_v: Array,
    since_s: float,
    before_v: float,
    bank: Bank,
    memory: Memory,
    follow: Array,
    output: Array,
) -> None:
    """Advance the state along k points behind the lag; `output` (k,) receives the displacement, µm.

    `since_s` and `before_v` are the time and the voltage that the state belongs to; `follow` (3, j) is room to
    work in.
    """
    # Most steps move few of the plays: the others keep their part of the sum.
    count = bank.thresholds.shape[0]
    parts = np.empty(count)
    for i in range(count):
        parts[i] = bent(bank.knots[i], bank.slopes[i], memory.plays[i])
    before_s, elapsed_s = since_s, 0.0
    following(bank.taus, elapsed_s, follow)
    for k in range(t_s.shape[0]):
        elapsed_s = followed(bank.taus, t_s[k] - before_s, elapsed_s, follow)
        before_s = t_s[k]
        creep = 0.0
        for g in range(bank.creeping.shape[0]):
            before = standing(bank, memory, before_v, bank.creeping[g])
            after = moved(bank, memory, before_v, u_v[k], bank.creeping[g])
            lag, weight = memory.lags[g], bank.weights[g]
            for j in range(follow.shape[1]):
                lag[j] = follow[0, j] * lag[j] + (follow[1, j] * before + follow[2, j] * after)
            own = 0.0  # a sum for each play: additions wait for each other
            for j in range(follow.shape[1]):
                own += weight[j] * lag[j]
            creep += own
        total = 0.0
        for i in range(count):
            z = play(bank.thresholds[i], u_v[k], memory.plays[i])
            if z != memory.plays[i]:
                memory.plays[i] = z
                parts[i] = bent(bank.knots[i], bank.slopes[i], z)
            total += parts[i]
        for i in range(bank.rounded.shape[0]):
            memory.stops[i] = stop(bank.rounded[i], u_v[k] - before_v, memory.stops[i])
            total += bank.roundness[i] * (bank.rounded[i, 4] * u_v[k] - memory.stops[i])
        before_v = u_v[k]
        output[k] = total + creep


@cached
def advance_bank(
    t_s: Array,
    u_v: Array,
    since_s: float,
    from_v: float,
    lagged_v: float,
    lag_s: float,
    bank: Bank,
    memory: Memory,
    output: Array,
) -> float:
    """Advance the state over k > 0 samples; `output` (k,) receives the displacement, µm.

    `since_s`, `from_v` and `lagged_v` are the time, the voltage and that behind the lag which the state belongs to;
    the last of them after the samples comes back.
    """
    follow = np.empty((3, bank.taus.shape[0]))
    if lag_s == 0.0:
        advance_path(t_s, u_v, since_s, lagged_v, bank, memory, follow, output)
        return float(u_v[-1])
    count = t_s.shape[0]
    times, volts, path_um = np.empty(2 * count), np.empty(2 * count), np.empty(2 * count)
    ends = np.empty(count, dtype=np.int64)
    points = lagged_path(t_s, u_v, since_s, from_v, lagged_v, lag_s, times, volts, ends)
    advance_path(times[:points], volts[:points], since_s, lagged_v, bank, memory, follow, path_um[:points])
    for k in range(count):
        output[k] = path_um[ends[k]]
    return float(volts[points - 1])


@cached
def bank_features(
    t_s: Array,
    u_v: Array,
    since_s: float,
    before_v: float,
    bank: Bank,
    column_of: Integers,
    memory: Memory,
    follow: Array,
    features: Array,
) -> None:
    """Advance the state over k samples; `features` (k, f): bent plays, rounded plays, columns of creep.

    Lags with the same entry in `column_of` (j,) share one column, so that they get the same weight.
    """
    pieces = bank.knots.shape[1] - 1
    first_rounded = bank.thresholds.shape[0] * pieces
    first_creep = first_rounded + bank.rounded.shape[0]
    columns = column_of[-1] + 1 if column_of.shape[0] else 0
    before_s, elapsed_s = since_s, 0.0
    following(bank.taus, elapsed_s, follow)
    for k in range(t_s.shape[0]):
        elapsed_s = followed(bank.taus, t_s[k] - before_s, elapsed_s, follow)
        before_s = t_s[k]
        step(bank, memory, before_v, follow, u_v[k])
        before_v = u_v[k]
        for i in range(bank.thresholds.shape[0]):
            for m in range(pieces):
                features[k, i * pieces + m] = hinge(bank.knots[i], m, memory.plays[i])
        for i in range(bank.rounded.shape[0]):
            features[k, first_rounded + i] = bank.rounded[i, 4] * before_v - memory.stops[i]
        for c in range(bank.creeping.shape[0] * columns):
            features[k, first_creep + c] = 0.0
        for g in range(bank.creeping.shape[0]):
            for j in range(bank.taus.shape[0]):
                features[k, first_creep + g * columns + column_of[j]] += memory.lags[g, j]


@compiled
def lagged_answer_um(
    bank: Bank,
    memory: Memory,
    lag_s: float,
    elapsed_s: float,
    from_v: float,
    lagged_v: float,
    follow: Array,
    u_v: float,
) -> float:
    """Displacement, µm, when the voltage before the lag went straight to `u_v` in `elapsed_s`; the state stays."""
    end_v = lagged(lag_s, elapsed_s, from_v, u_v, lagged_v)
    at_s = turn_s(lag_s, elapsed_s, from_v, u_v, lagged_v)
    if at_s > 0.0:
        memory = Memory(memory.plays.copy(), memory.stops.copy(), memory.lags.copy())
        follow = np.empty_like(follow)
        turn_v = from_v + (u_v - from_v) * (at_s / elapsed_s)
        following(bank.taus, at_s, follow)
        step(bank, memory, lagged_v, follow, turn_v)
        following(bank.taus, elapsed_s - at_s, follow)
        lagged_v = turn_v
    return answer_um(bank, memory, lagged_v, follow, end_v)


@cached
def solve_bank(
    t_s: Array,
    y_um: Array,
    since_s: float,
    from_v: float,
    lagged_v: float,
    low_v: float,
    high_v: float,
    lag_s: float,
    bank: Bank,
    memory: Memory,
    follow: Array,
    output: Array,
    beyond: NDArray[np.bool_],
) -> float:
    """Advance the state along the voltages that give `y_um` (k,), into `output` (k,); `beyond` (k,): none does.

    The voltages lie in [low_v, high_v]; where none gives the displacement, the nearer end is taken. Returns the
    voltage behind the lag. The displacement rises strictly with the voltage (`model`), so a bracket always
    holds the one root: regula falsi, Illinois variant, until the bracket is as narrow as numbers are.
    """
    enough = ENOUGH * (high_v - low_v) * bank.slopes[0].max()
    before_s, known_s = since_s, 0.0
    following(bank.taus, known_s, follow)
    for k in range(t_s.shape[0]):
        elapsed_s = t_s[k] - before_s
        known_s = followed(bank.taus, elapsed_s, known_s, follow)
        low, high, side = low_v, high_v, 0
        if lag_s > 0.0 and elapsed_s <= 0.0:
            low, high = from_v, from_v  # in no time nothing comes through a lag
        below, above = 0.0, 0.0
        u, is_beyond = low, False
        for turn in range(ITERATIONS + 2):
            if turn == 1:
                u = high
            elif turn > 1:
                u = high - above * (high - low) / (above - below)
                if not low < u < high:
                    u = 0.5 * (low + high)
                if not low < u < high:
                    break
            y = lagged_answer_um(bank, memory, lag_s, elapsed_s, from_v, lagged_v, follow, u)
            error = y - y_um[k]
            if turn == 0:
                below = error
                if error >= 0.0:
                    is_beyond = error > enough
                    break
            elif turn == 1:
                above = error
                if error <= 0.0:
                    is_beyond = error < -enough
                    break
            elif abs(error) <= enough:
                break
            elif error < 0.0:
                low, below = u, error
                if side < 0:
                    above *= 0.5
                side = -1
            else:
                high, above = u, error
                if side > 0:
                    below *= 0.5
                side = 1
        output[k], beyond[k] = u, is_beyond
        end_v = lagged(lag_s, elapsed_s, from_v, u, lagged_v)
        at_s = turn_s(lag_s, elapsed_s, from_v, u, lagged_v)
        if at_s > 0.0:
            turn_v = from_v + (u - from_v) * (at_s / elapsed_s)
            following(bank.taus, at_s, follow)
            step(bank, memory, lagged_v, follow, turn_v)
            lagged_v = turn_v
            following(bank.taus, elapsed_s - at_s, follow)
        step(bank, memory, lagged_v, follow, end_v)
        if at_s > 0.0:
            following(bank.taus, known_s, follow)
        before_s, from_v, lagged_v = t_s[k], u, end_v
    return lagged_v


@cached
def turned_stops(rounded: Array, turns: Array, stops: Array) -> None:
    """Take stops (k,) along a voltage that goes from turn to turn, shape (m,), the first where they are."""
    for m in range(1, turns.shape[0]):
        for k in range(rounded.shape[0]):
            stops[k] = stop(rounded[k], turns[m] - turns[m - 1], stops[k])
