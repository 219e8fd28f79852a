"""Least squares over terms of a design: coefficients, prediction intervals, lack of fit, leaving points out.

A term is a block of columns of the model matrix. Numbers enter coded to −1 … 1, categories by effects that sum to
zero, so that what a term explains beyond all others does not depend on the order of the factors. After Montgomery,
Design and Analysis of Experiments (2017), chapters 10 and 11.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from edmctl.array_types import Array
from edmctl.dataclasses import dataclass, field

Term = tuple[tuple[str, int], ...]
"""Factors with their powers; without any it is the mean. A category has the power 1."""

MEAN: Term = ()


@dataclass(frozen=True, slots=True)
class Settings:
    """What was run, by factor: numbers coded to −1 … 1, and names of categories, one value a run."""

    numbers: Mapping[str, ArrayLike] = field(default_factory=dict)
    categories: Mapping[str, Sequence[object]] = field(default_factory=dict)
    names: Mapping[str, Sequence[object]] = field(default_factory=dict)
    """All names of each category, in the order of the design; the effect of the last one follows from the others."""

    @property
    def runs(self) -> int:
        return len(np.asarray(next(iter((*self.numbers.values(), *self.categories.values())))))

    def columns(self, factor: str, power: int) -> Array:
        """Return what a factor puts into a term: (runs, 1), or (runs, names − 1) of a category."""
        if factor in self.numbers:
            return np.asarray(self.numbers[factor], float)[:, None] ** power
        names = list(self.names[factor])
        effects = np.vstack([np.eye(len(names) - 1), -np.ones(len(names) - 1)])
        return effects[[names.index(value) for value in self.categories[factor]]]


def main_effects(factors: Sequence[str]) -> list[Term]:
    """Return the mean, and the terms of each factor alone."""
    return [MEAN, *(((name, 1),) for name in factors)]


def with_interactions(factors: Sequence[str]) -> list[Term]:
    """Return main effects, then the product of each pair of factors."""
    pairs = [((a, 1), (b, 1)) for n, a in enumerate(factors) for b in factors[n + 1 :]]
    return [*main_effects(factors), *pairs]


def second_order(numbers: Sequence[str], categories: Sequence[str] = ()) -> list[Term]:
    """Return the terms of a full second-order surface; a category has no square."""
    return [*with_interactions([*numbers, *categories]), *(((name, 2),) for name in numbers)]


def term_name(term: Term) -> str:
    """Return a term as tables name it: `current × t_on²`."""
    return " × ".join(name if power == 1 else f"{name}{'²³'[power - 2]}" for name, power in term) or "mean"


@dataclass(frozen=True, slots=True)
class ModelMatrix:
    """Columns of a linear model, and which of them belong to which term."""

    columns: Array
    """(runs, columns)."""
    spans: Mapping[Term, slice]


def model_matrix(settings: Settings, terms: Sequence[Term]) -> ModelMatrix:
    """Return the columns of `terms` at `settings`."""
    blocks, spans, end = [], {}, 0
    for term in terms:
        block = np.ones((settings.runs, 1))
        for factor, power in term:
            own = settings.columns(factor, power)
            block = (block[:, :, None] * own[:, None, :]).reshape(len(block), -1)
        blocks.append(block)
        spans[term] = slice(end, end := end + block.shape[1])
    return ModelMatrix(np.hstack(blocks), spans)


def undetermined(model: ModelMatrix) -> list[Term]:
    """Return the terms that add less than all of their columns to the terms before them."""
    rank, found = 0, []
    for term, span in model.spans.items():
        known = int(np.linalg.matrix_rank(model.columns[:, : span.stop]))
        if known - rank < span.stop - span.start:
            found.append(term)
        rank = known
    return found
