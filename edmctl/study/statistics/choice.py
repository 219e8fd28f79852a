"""Pareto front, rankings of points, and Sobol indices of factors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from edmctl.array_types import Array
from edmctl.dataclasses import dataclass
from edmctl.quantity import coverage_factor

Better = Literal["larger", "smaller"]


def pareto_front(responses: ArrayLike, better: Sequence[Better]) -> NDArray[np.bool_]:
    """Return which runs no other dominates, of (runs, responses); a run that lacks a response is not among them."""
    values = _larger_is_better(responses, better)
    whole = np.isfinite(values).all(axis=1)
    as_good = (values[None, :, :] >= values[:, None, :]).all(axis=2)
    better_once = (values[None, :, :] > values[:, None, :]).any(axis=2)
    dominated = np.logical_and(as_good, better_once).any(axis=1)
    return np.asarray(whole & ~dominated)


def grey_relational_grade(
    responses: ArrayLike, better: Sequence[Better], weights: Sequence[float], distinguishing: float = 0.5
) -> NDArray[np.float64]:
    """Return the grade of each run, 0 … 1 (Deng, J. Grey Syst. 1, 1989; normalised over the runs at hand)."""
    values = _larger_is_better(responses, better)
    low, high = np.nanmin(values, axis=0), np.nanmax(values, axis=0)
    span = np.where(high > low, high - low, 1.0)
    missed = (high - values) / span
    coefficient = distinguishing / (missed + distinguishing)
    return np.asarray(coefficient @ _shares(weights))


def topsis_closeness(
    responses: ArrayLike, better: Sequence[Better], weights: Sequence[float]
) -> NDArray[np.float64]:
    """Return how close each run is to the ideal, 0 … 1 (Hwang and Yoon, 1981)."""
    values = _larger_is_better(responses, better)
    size = np.sqrt(np.nansum(values**2, axis=0))
    scaled = values / np.where(size > 0, size, 1.0) * _shares(weights)
    to_best = np.sqrt(((scaled - np.nanmax(scaled, axis=0)) ** 2).sum(axis=1))
    to_worst = np.sqrt(((scaled - np.nanmin(scaled, axis=0)) ** 2).sum(axis=1))
    with np.errstate(invalid="ignore"):
        return np.asarray(to_worst / (to_best + to_worst))


def _larger_is_better(responses: ArrayLike, better: Sequence[Better]) -> NDArray[np.float64]:
    return np.asarray(responses, float) * [1.0 if one == "larger" else -1.0 for one in better]


def _shares(weights: Sequence[float]) -> NDArray[np.float64]:
    return np.asarray(np.asarray(weights, float) / np.sum(weights))


@dataclass(frozen=True, slots=True)
class SobolIndices:
    """Integers by factor, and half the widths of their 95 % intervals."""

    first_order: Array
    total: Array
    first_order_u95: Array
    total_u95: Array


def sensitivity_points(factors: int, base: int, seed: int) -> Array:
    """Return base × (factors + 2) points in 0 … 1: samples A and B, then A with each factor's column of B in turn.

    Raises ValueError where `base` is no power of two: a scrambled Sobol sequence is balanced only there.
    """
    from scipy.stats import qmc

    if base < 2 or base & (base - 1):
        raise ValueError(
            f"The number of base samples is a power of two, such as {2 ** max(1, base.bit_length())}."
        )
    made = qmc.Sobol(2 * factors, scramble=True, rng=np.random.default_rng(seed)).random(base)
    a, b = np.asarray(made[:, :factors]), np.asarray(made[:, factors:])
    mixed = [np.where(np.arange(factors) == factor, b, a) for factor in range(factors)]
    return np.vstack([a, b, *mixed])


def sobol_indices(response: ArrayLike, factors: int, seed: int = 0, resamples: int = 400) -> SobolIndices:
    """Return the indices of a response at `sensitivity_points`, in their order.

    First order after Saltelli et al. (Comput. Phys. Communications 181, 2010), total after Jansen; intervals by
    bootstrap over the base samples. One missing response takes its base sample out, and no more. Raises ValueError
    where the number of responses does not fit or fewer than two base samples are whole.
    """
    values = np.asarray(response, float)
    if len(values) % (factors + 2):
        raise ValueError(f"{len(values)} responses are no multiple of {factors} factors + 2.")
    rows = values.reshape(factors + 2, -1).T
    rows = rows[np.isfinite(rows).all(axis=1)]
    if len(rows) < 2:
        raise ValueError("Fewer than two base samples have all their responses.")
    first, total = _indices(rows[None])
    rng = np.random.default_rng(seed)
    again = [_indices(rows[rng.integers(len(rows), size=(1, len(rows)))]) for _ in range(resamples)]
    spread = [np.std([np.ravel(one[n]) for one in again], axis=0) * coverage_factor(0.95) for n in (0, 1)]
    return SobolIndices(first[0], total[0], spread[0], spread[1])


def _indices(rows: Array) -> tuple[Array, Array]:
    """Return first-order and total indices of samples (…, base, factors + 2)."""
    a, b, mixed = rows[..., 0], rows[..., 1], rows[..., 2:]
    both = np.concatenate([a, b], axis=-1)
    centre = both.mean(axis=-1, keepdims=True)
    variance = both.var(axis=-1)[..., None]
    a, b, mixed = a - centre, b - centre, mixed - centre[..., None]
    with np.errstate(divide="ignore", invalid="ignore"):
        first = (b[..., None] * (mixed - a[..., None])).mean(axis=-2) / variance
        total = ((a[..., None] - mixed) ** 2).mean(axis=-2) / 2 / variance
    return first, total
