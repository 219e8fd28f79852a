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

The library in C calculates them (firmware/operators). This module declares its records, and checks the arrays whose
addresses they contain.
"""

from __future__ import annotations

import ctypes
from ctypes import c_double, c_int64, c_void_p

import numpy as np

from edmctl.array_types import Array, Integers
from edmctl.core.library import library

States = tuple[Array, Array, Array]  # arrays of a state: plays (n,), stops (k,) and lags (g, j)
_FLOAT = np.dtype(np.float64)
_Bytes = ctypes.c_char * 0  # gives an address several times as fast as `ndarray.ctypes`


class Bank(ctypes.Structure):
    """Parameters, `struct bank`: n sharp plays of m pieces, k rounded ones, g of them with j lags each.

    thresholds (n,), knots (n, m + 1), slopes (n, m), taus (j,), weights (g, j) : ndarray
    rounded : ndarray, shape (k, 5): rising and falling limit, c, ρ, C
    roundness : ndarray, shape (k,): weights of the rounded plays
    creeping : ndarray of int, shape (g,): plays, from n on rounded ones

    Raises ValueError when the arrays do not fit each other.
    """

    _fields_ = [
        *((name, c_int64) for name in "nmkgj"),
        *((name, c_void_p) for name in ("thresholds", "knots", "slopes", "rounded", "roundness")),
        *((name, c_void_p) for name in ("creeping", "taus", "weights")),
        ("lag_s", c_double),
    ]

    def __init__(
        self,
        thresholds: Array,
        knots: Array,
        slopes: Array,
        rounded: Array,
        roundness: Array,
        creeping: Integers,
        taus: Array,
        weights: Array,
        lag_s: float,
    ) -> None:
        (n, m), k, g, j = slopes.shape, len(roundness), len(creeping), len(taus)
        shapes = (thresholds.shape, knots.shape, rounded.shape, weights.shape)
        inside = bool(((creeping >= 0) & (creeping < n + k)).all())
        if shapes != ((n,), (n, m + 1), (k, 5), (g, j)) or m < 1 or not inside:
            raise ValueError("the arrays of a bank do not fit each other")
        plays = [_constant(one) for one in (thresholds, knots, slopes, rounded, roundness)]
        creep = np.ascontiguousarray(creeping, dtype=np.int64), _constant(taus), _constant(weights)
        self._arrays = (*plays, *creep)  # kept as long as their addresses
        super().__init__(n, m, k, g, j, *(one.ctypes.data for one in self._arrays), lag_s)
        self.shapes = ((n,), (k,), (g, j))
        self.room: int = library().bank_room(ctypes.byref(self))

    def __reduce__(self) -> tuple[object, ...]:
        """Return how a copy is made: with arrays of its own."""
        return Bank, (*self._arrays, self.lag_s)


class Memory(ctypes.Structure):
    """State of a bank, `struct memory`, over its arrays, which C changes; ValueError for those of another bank."""

    t_s: float
    u_v: float
    lagged_v: float

    _fields_ = [
        *((name, c_void_p) for name in ("plays", "stops", "lags", "room")),
        *((name, c_double) for name in ("t_s", "u_v", "lagged_v")),
    ]

    def __init__(self, bank: Bank, arrays: States, t_s: float, u_v: float, lagged_v: float) -> None:
        plays, stops, lags = arrays
        if (plays.shape, stops.shape, lags.shape) != bank.shapes:
            shapes = tuple(one.shape for one in arrays)
            raise ValueError(f"a state of shape {shapes} for a model of {bank.shapes}")
        room = np.empty(bank.room)
        self._arrays = plays, stops, lags, room  # kept as long as their addresses
        super().__init__(place_of(plays), place_of(stops), place_of(lags), place_of(room), t_s, u_v, lagged_v)


class Elements(ctypes.Structure):
    """Elasto-slip elements, `struct elements`: stiffness, limits and stretch, shape (n,); C changes the last.

    Raises ValueError when they are not equally long.
    """

    _fields_ = [("n", c_int64), *((name, c_void_p) for name in ("stiffness", "limits", "stops"))]

    def __init__(self, stiffness: Array, limits: Array, stops: Array) -> None:
        if not stiffness.shape == limits.shape == stops.shape == (len(stops),):
            raise ValueError(f"a state of shape {stops.shape} for {stiffness.size} elements")
        self._arrays = (_constant(stiffness), _constant(limits), stops)  # kept as long as their addresses
        super().__init__(len(stops), *(one.ctypes.data for one in self._arrays[:2]), place_of(stops))


def call(function: str, *arguments: object) -> None:
    """Call a function of the library with numbers, structures (by reference) and contiguous arrays (by address)."""
    getattr(library(), function)(*(_passed(argument) for argument in arguments))


def _passed(argument: object) -> object:
    if isinstance(argument, ctypes.Structure):
        return ctypes.byref(argument)
    return argument.ctypes.data if isinstance(argument, np.ndarray) else argument


def _constant(array: Array) -> Array:
    return np.ascontiguousarray(array, dtype=np.float64)


def place_of(array: Array) -> int:
    """Return the address of an array that C writes. Raises ValueError unless it is contiguous, writable float64."""
    if array.dtype != _FLOAT or not array.flags.carray:
        raise ValueError("the arrays of a state are float64, row after row in memory, and writable")
    return ctypes.addressof(_Bytes.from_buffer(array.data))
