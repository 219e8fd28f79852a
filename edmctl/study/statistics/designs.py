"""Designs for response surfaces and for sampling a space: settings coded to −1 … 1, (runs, factors).

Centre runs are not in them: how many there are, and where in the order, is the study's business.
"""

from __future__ import annotations

import itertools
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from edmctl.dataclasses import dataclass

Levels = NDArray[np.int64]
"""Level numbers from 0: (runs, columns)."""
Coded = NDArray[np.float64]
"""Settings from −1 to 1: (runs, factors)."""

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
        return tuple(int(column.max()) + 1 for column in self.levels.T)


@cache
def arrays() -> dict[str, OrthogonalArray]:
    """Return every array by its name, smaller ones first."""
    three_by_four = [(a, b, (a + b) % 2, third) for third in range(3) for a in range(2) for b in range(2)]
    made = [
        ("L4 (2^3)", _linear(2, 2)),
        ("L8 (2^7)", _linear(2, 3)),
        ("L8 (4^1 2^4)", _with_four_levels(3, 1)),
        ("L9 (3^4)", _linear(3, 2)),
        ("L12 (2^11)", _rows(TWELVE)),
        ("L16 (2^15)", _linear(2, 4)),
        *((f"L16 (4^{n} 2^{15 - 3 * n})", _with_four_levels(4, n)) for n in range(1, 5)),
        ("L16 (4^5)", _with_four_levels(4, 5)),
        ("L18 (2^1 3^7)", _developed(SIXFOLD, np.array([(r // 3, r % 3) for r in range(6)]))),
        ("L18 (6^1 3^6)", _developed(SIXFOLD, np.arange(6)[:, None])),
        ("L25 (5^6)", _linear(5, 2)),
        ("L27 (3^13)", _linear(3, 3)),
        ("L32 (2^31)", _linear(2, 5)),
        ("L32 (2^1 4^9)", _with_four_levels(5, 9)[:, [9, *range(9)]]),
        ("L36 (2^11 3^12)", _developed(TWELVEFOLD, _rows(TWELVE))),
        ("L36 (2^3 3^13)", _developed(TWELVEFOLD, np.array(three_by_four))),
    ]
    return {name: OrthogonalArray(name, levels) for name, levels in made}


def array_for(counts: Sequence[int], name: str | None = None) -> tuple[OrthogonalArray, tuple[int, ...]]:
    """Return the smallest array with a column for each factor of so many levels, and the columns, from 0.

    name : of an array, `L18`, or of one of its forms, `L18 (6^1 3^6)`

    Raises ValueError where none holds the factors.
    """
    named = [one for one in arrays().values() if name is None or name in (one.name, one.name.split()[0])]
    if not named:
        raise ValueError(f"There is no array {name}; there are {', '.join(arrays())}.")
    for one in sorted(named, key=lambda array: len(array.levels)):
        free = dict(enumerate(one.counts))
        chosen = []
        for count in counts:
            column = next((column for column, levels in free.items() if levels == count), None)
            if column is not None:
                chosen.append(column)
                del free[column]
        if len(chosen) == len(counts):
            return one, tuple(chosen)
    levels = ", ".join(f"{n} of {levels}" for levels, n in sorted(Counter(counts).items()))
    raise ValueError(
        f"{name or 'No array up to L36'} has no columns for these factors by their levels: {levels}."
    )


def _digits(base: int, order: int) -> Levels:
    """Return all words of `order` digits, the first one slowest: (base ** order, order)."""
    return np.array(list(itertools.product(range(base), repeat=order)))


def _linear(base: int, order: int) -> Levels:
    """Return the array whose columns are the directions over the integers modulo `base`, in Taguchi's order."""
    directions = [
        [*reversed(lower), 1] + [0] * (order - 1 - newest)
        for newest in range(order)
        for lower in itertools.product(range(base), repeat=newest)
    ]
    levels: Levels = _digits(base, order) @ np.array(directions).T % base
    return levels


FOURS = {
    3: ((1, 2),),
    4: ((1, 2), (4, 8), (5, 10), (6, 11), (7, 9)),
    5: ((1, 2), (4, 8), (5, 10), (6, 16), (7, 18), (9, 17), (11, 20), (13, 19), (14, 23)),
}
"""By order, columns of two levels: a pair and its sum, which no other pair has, give one column of four levels."""


def _with_four_levels(order: int, count: int) -> Levels:
    """Return an array of 2 ** order runs: `count` columns of four levels, then the remaining ones of two."""
    two, pairs = _linear(2, order), FOURS[order][:count]
    used = {number for a, b in pairs for number in (a, b, a ^ b)}
    four = [two[:, a - 1] * 2 + two[:, b - 1] for a, b in pairs]
    left = [two[:, number - 1] for number in range(1, 2**order) if number not in used]
    return np.column_stack([*four, *left])


def _rows(rows: Sequence[str]) -> Levels:
    return np.array([[int(digit) for digit in row] for row in rows])


def _developed(differences: Sequence[str], beside: Levels) -> Levels:
    """Return each row of `beside` three times, with a row of differences to which 0, 1 and 2 is added."""
    developed = np.array([(row + added) % 3 for row in _rows(differences) for added in range(3)])
    return np.column_stack([np.repeat(beside, 3, axis=0), developed])


LETTERS = "ABCDEFGHJKLMNOPQRSTUVWXYZ"

Word = frozenset[int]
"""An effect: the factors, from 0, whose product it is."""


@dataclass(frozen=True, slots=True)
class Fraction:
    """A fraction of the two-level factorial of `factors` factors.

    `generators` hold a factor, the word of base factors it is set by, and the sign.
    """

    factors: int
    generators: tuple[tuple[int, Word, int], ...]

    @property
    def runs(self) -> int:
        return int(2 ** (self.factors - len(self.generators)))

    def coded(self) -> Coded:
        """Return the settings as −1 and 1: (runs, factors); the first base factor is the slowest."""
        generated = {factor for factor, _, _ in self.generators}
        base = [factor for factor in range(self.factors) if factor not in generated]
        settings = np.empty((self.runs, self.factors))
        settings[:, base] = list(itertools.product((-1.0, 1.0), repeat=len(base)))
        for factor, word, sign in self.generators:
            settings[:, factor] = sign * settings[:, sorted(word)].prod(axis=1)
        return settings

    def defining_words(self) -> dict[Word, int]:
        """Return every word that is constant over the fraction, with its sign."""
        words: dict[Word, int] = {frozenset(): 1}
        for factor, word, sign in self.generators:
            words |= {known ^ word ^ {factor}: s * sign for known, s in words.items()}
        del words[frozenset()]
        return words

    @property
    def resolution(self) -> int | None:
        """Length of the shortest defining word; None for the whole factorial."""
        return min(map(len, self.defining_words()), default=None)

    def aliases(self, order: int = 2) -> list[tuple[tuple[Word, int], ...]]:
        """Return the groups of effects up to `order` factors that cannot be separated, each with its sign."""
        words = self.defining_words()
        groups, seen = [], set()
        for effect in _effects(self.factors, order):
            group = [(effect, 1), *((effect ^ word, sign) for word, sign in words.items())]
            group = [(other, sign) for other, sign in group if 0 < len(other) <= order]
            if effect not in seen and len(group) > 1:
                groups.append(tuple(sorted(group, key=lambda alias: (len(alias[0]), sorted(alias[0])))))
            seen |= {other for other, _ in group}
        return groups


def letters_of(word: Word) -> str:
    """Return an effect as its letters, `ABC`."""
    return "".join(LETTERS[one] for one in sorted(word))


def fraction_of(factors: int, generators: Sequence[str]) -> Fraction:
    """Return the fraction that generators such as `D = ABC` or `E=-AB` define.

    Raises ValueError for another text, or where a factor is generated twice or by a factor that is generated itself.
    """
    known = LETTERS[:factors]
    found: dict[int, tuple[Word, int]] = {}
    for text in generators:
        match = re.fullmatch(r"([A-Z])=([+-]?)([A-Z]{2,})", text.upper().replace(" ", ""))
        if not match or not set(match[1] + match[3]) <= set(known) or len(set(match[3])) < len(match[3]):
            raise ValueError(
                f"{text!r} is no generator: a letter of {known[0]} to {known[-1]}, =, and others: D = ABC."
            )
        factor = known.index(match[1])
        if factor in found:
            raise ValueError(f"{match[1]} has two generators.")
        found[factor] = frozenset(map(known.index, match[3])), -1 if match[2] == "-" else 1
    for factor, (word, _) in found.items():
        if generated := word & set(found):
            letters = letters_of(generated)
            raise ValueError(f"The generator of {LETTERS[factor]} uses {letters}, which is generated itself.")
    return Fraction(factors, tuple((factor, word, sign) for factor, (word, sign) in found.items()))


def fraction_for(factors: int, resolution: int) -> Fraction:
    """Return the smallest fraction of at least this resolution; of equal size, one of the highest resolution.

    It is the whole factorial where none is smaller. Raises ValueError where the resolution is below 3.
    """
    if resolution < 3:
        raise ValueError("Below resolution 3 main effects are aliases of each other.")
    for base in range(2, factors):
        for least in range(base + 1, resolution - 1, -1):
            if found := _search(factors, base, least):
                return found
    return Fraction(factors, ())


def _search(factors: int, base: int, resolution: int) -> Fraction | None:
    """Return a fraction with factors from `base` on generated, no defining word shorter than `resolution`."""
    sizes = range(base, resolution - 2, -1)  # longer generators first: they make longer words
    order = [frozenset(word) for size in sizes for word in itertools.combinations(range(base), size)]

    def extended(chosen: tuple[int, ...], defining: frozenset[Word]) -> tuple[int, ...] | None:
        if len(chosen) == factors - base:
            return chosen
        for index in range(chosen[-1] + 1 if chosen else 0, len(order)):
            word = order[index] | {base + len(chosen)}
            new = {known ^ word for known in defining} | {word}
            if min(map(len, new)) >= resolution and (done := extended((*chosen, index), defining | new)):
                return done
        return None

    chosen = extended((), frozenset())
    if chosen is None:
        return None
    return Fraction(factors, tuple((base + n, order[index], 1) for n, index in enumerate(chosen)))


def hiding_words(factors: int, count: int) -> tuple[Word, ...]:
    """Return so many words for blocks to hide: they and all their products are as long as can be, 2 at least.

    Box, Hunter and Hunter (2005), chapter 5. None where a main effect would be hidden.
    """
    words = [word for word in _effects(factors, factors) if len(word) > 1]

    def extended(chosen: tuple[Word, ...], hidden: frozenset[Word], least: int) -> tuple[Word, ...]:
        if len(chosen) == count:
            return chosen
        for word in words:
            new = {known ^ word for known in hidden} | {word}
            fits = word not in hidden and min(map(len, new)) >= least
            if fits and (found := extended((*chosen, word), hidden | new, least)):
                return found
        return ()

    found = (extended((), frozenset(), least) for least in range(factors, 1, -1))
    return next(filter(None, found), ())


def _effects(factors: int, order: int) -> Iterator[Word]:
    for size in range(1, order + 1):
        yield from map(frozenset, itertools.combinations(range(factors), size))


BOX_BEHNKEN = {
    3: ("12", "13", "23"),
    4: ("12", "34", "14", "23", "13", "24"),
    5: ("12", "34", "25", "13", "45", "23", "14", "35", "24", "15"),
    6: ("124", "235", "346", "145", "256", "136"),
    7: ("456", "167", "257", "124", "347", "135", "236"),
}
"""Factors that vary together in each block of runs (Box and Behnken, Technometrics 2, 1960, table 4)."""


def box_behnken(factors: int) -> Coded:
    """Return the Box-Behnken design without centre runs: 12, 24, 40, 48 or 56 runs of 3 to 7 factors.

    Raises ValueError for another number of factors.
    """
    if factors not in BOX_BEHNKEN:
        raise ValueError(f"A Box-Behnken design has 3 to 7 factors, not {factors}.")
    runs = []
    for block in BOX_BEHNKEN[factors]:
        together = [int(digit) - 1 for digit in block]
        settings = np.zeros((2 ** len(together), factors))
        settings[:, together] = list(itertools.product((-1.0, 1.0), repeat=len(together)))
        runs.append(settings)
    return np.vstack(runs)


def central_composite(factors: int, alpha: float | str = "face") -> Coded:
    """Return a central composite design without centre runs: the cube, then the axial points at ± `alpha`.

    The cube is the smallest fraction of resolution 5. `alpha` is a distance, `face` (1) or `rotatable` (fourth root
    of the runs of the cube); where it is beyond 1 everything is scaled so that the axial points are at ± 1: bounds
    of a factor are bounds of the runs. Raises ValueError below two factors or for another alpha.
    """
    if factors < 2:
        raise ValueError("A central composite design has at least 2 factors.")
    cube = fraction_for(factors, 5).coded()
    distance = {"face": 1.0, "rotatable": len(cube) ** 0.25}.get(alpha) if isinstance(alpha, str) else alpha
    if distance is None or not 0 < distance < 10:
        raise ValueError(f"alpha is face, rotatable or a distance up to 10, not {alpha!r}.")
    axial = np.repeat(np.eye(factors), 2, axis=0) * np.tile([-distance, distance], factors)[:, None]
    return np.vstack([cube, axial]) / max(1.0, distance)


MOST_IMPROVED = 200
"""Runs of a Latin hypercube that swaps improve: of more, chance alone fills the space, and swaps take long."""


def latin_hypercube(factors: int, runs: int, seed: int) -> Coded:
    """Return a Latin hypercube: a run in each of `runs` equal slices of each factor, of low centred discrepancy."""
    from scipy.stats import qmc

    way: Literal["random-cd"] | None = "random-cd" if runs <= MOST_IMPROVED else None
    made = qmc.LatinHypercube(factors, optimization=way, rng=np.random.default_rng(seed)).random(runs)
    return np.asarray(made) * 2 - 1


def sobol_points(factors: int, runs: int, seed: int) -> Coded:
    """Return the first points of a scrambled Sobol sequence; a longer one begins with those of a shorter one."""
    from scipy.stats import qmc

    whole = (max(runs, 1) - 1).bit_length()
    made = qmc.Sobol(factors, scramble=True, rng=np.random.default_rng(seed)).random_base2(whole)
    return np.asarray(made[:runs]) * 2 - 1
