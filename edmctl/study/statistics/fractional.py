"""Two-level fractional factorials: generators, the words they define, aliases and resolution.

After Box, Hunter and Hunter, Statistics for Experimenters (2005), chapter 6. Factors are letters in their order,
`I` left out as there; an effect is the set of its letters.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from edmctl.dataclasses import dataclass

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

    def coded(self) -> NDArray[np.float64]:
        """Return the settings as −1 and 1: (runs, factors); the first base factor is the slowest."""
        made = {one for one, _, _ in self.generators}
        base = [one for one in range(self.factors) if one not in made]
        settings = np.empty((self.runs, self.factors))
        settings[:, base] = list(itertools.product((-1.0, 1.0), repeat=len(base)))
        for one, word, sign in self.generators:
            settings[:, one] = sign * settings[:, sorted(word)].prod(axis=1)
        return settings

    def defining_words(self) -> dict[Word, int]:
        """Return every word that is constant over the fraction, with its sign."""
        words: dict[Word, int] = {frozenset(): 1}
        for one, word, sign in self.generators:
            words |= {known ^ word ^ {one}: s * sign for known, s in words.items()}
        del words[frozenset()]
        return words

    @property
    def resolution(self) -> int | None:
        """Length of the shortest defining word; None for the whole factorial."""
        return min((len(word) for word in self.defining_words()), default=None)

    def aliases(self, order: int = 2) -> list[tuple[tuple[Word, int], ...]]:
        """Return the groups of effects up to `order` factors that cannot be told apart, each with its sign."""
        words = self.defining_words()
        groups, seen = [], set()
        for effect in _effects(self.factors, order):
            if effect in seen:
                continue
            same = [
                (effect, 1),
                *((effect ^ word, sign) for word, sign in words.items() if len(effect ^ word) <= order),
            ]
            same = [one for one in same if one[0]]
            seen |= {one for one, _ in same}
            if len(same) > 1:
                groups.append(tuple(sorted(same, key=lambda one: (len(one[0]), sorted(one[0])))))
        return groups


def letters_of(word: Word) -> str:
    """Return an effect as its letters, `ABC`."""
    return "".join(LETTERS[one] for one in sorted(word))


def fraction_of(factors: int, generators: Sequence[str]) -> Fraction:
    """Return the fraction that generators such as `D = ABC` or `E=-AB` define.

    Raises ValueError where one is none, sets a factor twice, or leans on a factor that is set itself.
    """
    known = LETTERS[:factors]
    read = []
    for text in generators:
        match = re.fullmatch(r"([A-Z])=([+-]?)([A-Z]{2,})", text.upper().replace(" ", ""))
        if not match or not set(match[1] + match[3]) <= set(known) or len(set(match[3])) < len(match[3]):
            raise ValueError(
                f"{text!r} is no generator: a letter of {known[0]} to {known[-1]}, =, and others: D = ABC."
            )
        read.append(
            (known.index(match[1]), frozenset(known.index(c) for c in match[3]), -1 if match[2] == "-" else 1)
        )
    made = [one for one, _, _ in read]
    for one, word, _ in read:
        if made.count(one) > 1:
            raise ValueError(f"{LETTERS[one]} has two generators.")
        if leaning := word & set(made):
            raise ValueError(
                f"The generator of {LETTERS[one]} leans on {letters_of(leaning)}, which is generated itself."
            )
    return Fraction(factors, tuple(read))


def fraction_for(factors: int, resolution: int) -> Fraction:
    """Return the smallest fraction of at least this resolution; of those of its size, one of the highest.

    It is the whole factorial where none is smaller. Raises ValueError where the resolution is below 3.
    """
    if resolution < 3:
        raise ValueError("Below resolution 3 main effects are aliases of each other.")
    for base in range(2, factors):
        words = [
            frozenset(word)
            for size in range(resolution - 1, base + 1)
            for word in itertools.combinations(range(base), size)
        ]
        best = None
        for wanted in range(resolution, base + 2):
            found = _search(factors, base, wanted, words)
            if found is None:
                break
            best = found
        if best is not None:
            return best
    return Fraction(factors, ())


def _search(factors: int, base: int, resolution: int, words: Sequence[Word]) -> Fraction | None:
    """Return a fraction with factors from `base` on generated, no defining word shorter than `resolution`."""
    # Longer generators first: they make longer words.
    order = sorted(
        (word for word in words if len(word) >= resolution - 1), key=lambda word: (-len(word), sorted(word))
    )

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
    every = [word for word in _effects(factors, factors) if len(word) > 1]

    def extended(chosen: tuple[Word, ...], hidden: frozenset[Word], least: int) -> tuple[Word, ...] | None:
        if len(chosen) == count:
            return chosen
        for word in every:
            new = {known ^ word for known in hidden} | {word}
            fits = word not in hidden and all(len(one) >= least for one in new)
            if fits and (found := extended((*chosen, word), hidden | new, least)):
                return found
        return None

    for least in range(factors, 1, -1):
        if found := extended((), frozenset(), least):
            return found
    return ()


def _effects(factors: int, order: int) -> Iterator[Word]:
    for size in range(1, order + 1):
        yield from map(frozenset, itertools.combinations(range(factors), size))
