"""Several responses at once: what is dominated, and the rankings that people make of the rest.

What dominates what is a fact of the responses. A ranking is a preference: its weights and its normalisation are
chosen.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

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
