"""Consecutive samples as the compiled loops need them: they look neither left nor right."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Array = NDArray[np.float64]

CLOCK_ROUNDING_S = 1e-9


def consecutive(t_s: ArrayLike, values: ArrayLike, since_s: float = -math.inf) -> tuple[Array, Array]:
    """Return times and values as float64 arrays of shape (n,), row after row in memory.

    Raises ValueError unless both are one-dimensional, equally long and finite, and time runs forwards from
    `since_s` on.
    """
    times, numbers = _line(t_s), _line(values)
    if times.ndim != 1 or times.shape != numbers.shape:
        raise ValueError(
            f"times of shape {times.shape} and values of shape {numbers.shape}: (n,) each is needed"
        )
    if not (np.isfinite(times).all() and np.isfinite(numbers).all()):
        raise ValueError("times and values are finite numbers")
    if len(times) and (times[0] < since_s - CLOCK_ROUNDING_S or bool((np.diff(times) < 0.0).any())):
        raise ValueError(f"time runs forwards, here from {since_s:g} s on")
    return times, numbers


def _line(values: ArrayLike) -> Array:
    return np.ascontiguousarray(np.asarray(values, dtype=np.float64))
