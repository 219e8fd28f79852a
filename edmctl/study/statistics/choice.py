"""Pareto front, rankings of points, and Sobol indices of factors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from edmctl.array_types import Array
from edmctl.dataclasses import dataclass
from edmctl.quantity import coverage_factor

DISTINGUISHING = 0.5


def pareto_front(costs: ArrayLike) -> NDArray[np.bool_]:
    """Return which runs no other dominates, of (runs, costs); a run that lacks a cost is not among them."""
    values = np.asarray(costs, float)
    whole = np.isfinite(values).all(axis=1)
    as_good = (values[None, :, :] <= values[:, None, :]).all(axis=2)
    better_once = (values[None, :, :] < values[:, None, :]).any(axis=2)
    dominated = np.logical_and(as_good, better_once).any(axis=1)
    return np.asarray(whole & ~dominated)


def grey_relational_grade(costs: ArrayLike, weights: Sequence[float]) -> Array:
    """Return the grade of each run, 0 … 1 (Deng, J. Grey Syst. 1, 1989; normalised over these runs)."""
    values = -np.asarray(costs, float)
    low, high = np.nanmin(values, axis=0), np.nanmax(values, axis=0)
    missed = (high - values) / np.where(high > low, high - low, 1.0)
    return np.asarray(DISTINGUISHING / (missed + DISTINGUISHING) @ (np.asarray(weights) / np.sum(weights)))


def topsis_closeness(costs: ArrayLike, weights: Sequence[float]) -> Array:
    """Return how close each run is to the ideal, 0 … 1 (Hwang and Yoon, 1981)."""
    values = -np.asarray(costs, float)
    size = np.sqrt(np.nansum(values**2, axis=0))
    scaled = values / np.where(size > 0, size, 1.0) * (np.asarray(weights) / np.sum(weights))
    to_best = np.sqrt(((scaled - np.nanmax(scaled, axis=0)) ** 2).sum(axis=1))
    to_worst = np.sqrt(((scaled - np.nanmin(scaled, axis=0)) ** 2).sum(axis=1))
    with np.errstate(invalid="ignore"):
        return np.asarray(to_worst / (to_best + to_worst))


@dataclass(frozen=True, slots=True)
class SobolIndices:
    """Indices by factor, and half the widths of their 95 % intervals."""

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
    rng = np.random.default_rng(seed)
    again = [_indices(rows[rng.integers(len(rows), size=len(rows))]) for _ in range(resamples)]
    return SobolIndices(*_indices(rows), *np.std(again, axis=0) * coverage_factor(0.95))


def _indices(rows: Array) -> tuple[Array, Array]:
    """Return first-order and total indices of samples (base, factors + 2)."""
    variance = rows[:, :2].var()
    a, b, *mixed = (rows - rows[:, :2].mean()).T
    with np.errstate(divide="ignore", invalid="ignore"):
        first = [(b * (one - a)).mean() / variance for one in mixed]
        total = [((a - one) ** 2).mean() / 2 / variance for one in mixed]
    return np.array(first), np.array(total)
