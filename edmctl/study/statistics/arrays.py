"""Orthogonal arrays from L4 to L36: in every pair of columns each pair of levels stands equally often.

They are constructed: linear ones over a field of 2, 3 or 5 elements, L18 and L36 by developing difference matrices
(Bose and Bush, Ann. Math. Stat. 23, 1952). But for those with columns of four levels, columns stand in the order of
Taguchi's tables (System of Experimental Design, 1987), so that column numbers of papers hold.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from edmctl.dataclasses import dataclass

Levels = NDArray[np.int64]
"""Level numbers from 0: (runs, columns)."""

SIXFOLD = ("000000", "001122", "010212", "022110", "012021", "021201")
"""Difference matrix of order 6 over the integers modulo 3, behind L18."""
TWELVEFOLD = (
    "000000000000", "000011112222", "001201220112", "002102121021", "012021022101", "012100212210",
    "010222011012", "011220100221", "021012202011", "021110021202", "022212110100", "020121201120",
)  # fmt: skip
"""Difference matrix of order 12 over the integers modulo 3, behind L36."""
TWELVE = (
    "00000000000", "00000111111", "00111000111", "01011011001", "01101101010", "01110110100",
    "10110011010", "10101110001", "10011101100", "11100001101", "11010100011", "11001010110",
)  # fmt: skip
"""The array of Plackett and Burman (Biometrika 33, 1946) in Taguchi's order."""


@dataclass(frozen=True, slots=True)
class OrthogonalArray:
    """An array by its name: `L18 (2^1 3^7)`."""

    name: str
    levels: Levels
    """Level numbers from 0: (runs, columns)."""

    @property
    def counts(self) -> tuple[int, ...]:
        """Number of levels of each column."""
        return tuple(int(column.max()) + 1 for column in self.levels.T)


@cache
def arrays() -> dict[str, OrthogonalArray]:
    """Return every array by its name, smaller ones first."""
    three_by_four = [(a, b, (a + b) % 2, third) for third in range(3) for a in range(2) for b in range(2)]
    two = {f"L{2**order}": _of_two_levels(order) for order in (2, 3, 4, 5)}
    made = [
        ("L4 (2^3)", two["L4"]),
        ("L8 (2^7)", two["L8"]),
        ("L8 (4^1 2^4)", _with_four_levels(3, 1)),
        ("L9 (3^4)", _linear(3, 2)),
        ("L12 (2^11)", _rows(TWELVE)),
        ("L16 (2^15)", two["L16"]),
        *((f"L16 (4^{n} 2^{15 - 3 * n})", _with_four_levels(4, n)) for n in range(1, 5)),
        ("L16 (4^5)", _with_four_levels(4, 5)),
        ("L18 (2^1 3^7)", _developed(SIXFOLD, np.array([(r // 3, r % 3) for r in range(6)]))),
        ("L18 (6^1 3^6)", _developed(SIXFOLD, np.arange(6)[:, None])),
        ("L25 (5^6)", _linear(5, 2)),
        ("L27 (3^13)", _linear(3, 3)),
        ("L32 (2^31)", two["L32"]),
        ("L32 (2^1 4^9)", _with_four_levels(5, 9)[:, [9, *range(9)]]),
        ("L36 (2^11 3^12)", _developed(TWELVEFOLD, _rows(TWELVE))),
        ("L36 (2^3 3^13)", _developed(TWELVEFOLD, np.array(three_by_four))),
    ]
    return {name: OrthogonalArray(name, levels) for name, levels in made}


def array_for(counts: Sequence[int], wanted: str | None = None) -> tuple[OrthogonalArray, tuple[int, ...]]:
    """Return the smallest array with a column for each factor of so many levels, and the columns, from 0.

    `wanted` names an array, `L18`, or one of its forms, `L18 (6^1 3^6)`. Raises ValueError where none holds the
    factors.
    """
    named = {
        name: one for name, one in arrays().items() if wanted is None or wanted in (name, name.split()[0])
    }
    if not named:
        raise ValueError(f"There is no array {wanted}; there are {', '.join(arrays())}.")
    for one in sorted(named.values(), key=lambda a: len(a.levels)):
        columns = _columns_for(counts, one.counts)
        if columns is not None:
            return one, columns
    asked = ", ".join(f"{n} of {levels}" for levels, n in sorted(Counter(counts).items()))
    raise ValueError(
        f"{wanted or 'No array up to L36'} has no columns for these factors by their levels: {asked}."
    )


def _columns_for(counts: Sequence[int], columns: Sequence[int]) -> tuple[int, ...] | None:
    free = list(range(len(columns)))
    chosen = []
    for count in counts:
        column = next((c for c in free if columns[c] == count), None)
        if column is None:
            return None
        free.remove(column)
        chosen.append(column)
    return tuple(chosen)


def _digits(base: int, order: int) -> Levels:
    """Return all words of `order` digits, the first one slowest: (base ** order, order)."""
    return np.array(list(itertools.product(range(base), repeat=order)))


def _of_two_levels(order: int) -> Levels:
    """Return the array of 2 ** order runs; column number c is the sum of the digits that c has as bits."""
    digits = _digits(2, order)
    numbers = range(1, 2**order)
    weights = np.array([[number >> bit & 1 for bit in range(order)] for number in numbers])
    levels: Levels = digits @ weights.T % 2
    return levels


def _linear(base: int, order: int) -> Levels:
    """Return the array whose columns are the directions over the integers modulo `base`, in Taguchi's order."""
    directions = [
        [*reversed(lower), 1] + [0] * (order - 1 - newest)
        for newest in range(order)
        for lower in itertools.product(range(base), repeat=newest)
    ]
    levels: Levels = _digits(base, order) @ np.array(directions).T % base
    return levels


def _with_four_levels(order: int, count: int) -> Levels:
    """Return an array of 2 ** order runs with `count` columns of four levels, then those of two that are left.

    A column of four levels takes the place of three of two, one of which is the sum of the others.
    """
    two = _of_two_levels(order)
    lines = _disjoint_lines(2**order, count)
    if lines is None:
        raise AssertionError("no such array")
    left = sorted(set(range(1, 2**order)) - {number for line in lines for number in line})
    four = [two[:, a - 1] * 2 + two[:, b - 1] for a, b, _ in lines]
    return np.column_stack([*four, *(two[:, number - 1] for number in left)])


def _disjoint_lines(
    size: int, count: int, used: frozenset[int] = frozenset()
) -> list[tuple[int, int, int]] | None:
    """Return triples a, b, a xor b of numbers below `size` that share none, by trying."""
    if not count:
        return []
    free = [number for number in range(1, size) if number not in used]
    spare = len(free) - 3 * count
    for first in free[: spare + 1]:  # no more than the spare ones stay without a line
        for second in free:
            third = first ^ second
            if second > first and third > second and third in free:
                rest = _disjoint_lines(size, count - 1, used | {first, second, third})
                if rest is not None:
                    return [(first, second, third), *rest]
    return None


def _rows(rows: Sequence[str]) -> Levels:
    return np.array([[int(digit) for digit in row] for row in rows])


def _developed(differences: Sequence[str], beside: Levels) -> Levels:
    """Return each row of `beside` three times, with a row of differences to which 0, 1 and 2 is added."""
    developed = np.array([(row + added) % 3 for row in _rows(differences) for added in range(3)])
    return np.column_stack([np.repeat(beside, 3, axis=0), developed])
