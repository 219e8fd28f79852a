"""Least squares over the terms of a design, and analysis of variance: what each term explains of a response.

A term is a block of columns of the model matrix. Numbers enter coded to −1 … 1, categories by effects that sum to
zero, so that what a term explains beyond all others does not depend on the order of the factors. After Montgomery,
Design and Analysis of Experiments (2017), chapters 10 and 11.

Blocks are machines or tools, which are drawn at random. If a factor acts differently in them, that interaction has a
row of its own, and the factor is compared with that row instead of the error (mixed model, chapter 13).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from edmctl import failures
from edmctl.array_types import Array
from edmctl.dataclasses import dataclass, field
from edmctl.errors import installing

Term = tuple[tuple[str, int], ...]
"""Factors with their powers; without any it is the mean. A category has the power 1."""

MEAN: Term = ()
BLOCK = "block"
"""The factor that runs of one machine or tool share beside their settings."""
ERROR = "error"
MOST_P = 0.05
"""A product of a factor and the blocks has a row below this probability, shared among all that are tried."""
LEAST_ERROR_DOF = 3
EXACT = 1e-20
"""An error of so small a share of the sum of squares is rounding."""


@dataclass(frozen=True, slots=True)
class Settings:
    """Settings of runs by factor: numbers coded to −1 … 1, and names of categories, one value a run.

    names : all names of each category, in the order of the design; the effect of the last follows from the others
    """

    numbers: Mapping[str, ArrayLike] = field(default_factory=dict)
    categories: Mapping[str, Sequence[object]] = field(default_factory=dict)
    names: Mapping[str, Sequence[object]] = field(default_factory=dict)

    @property
    def runs(self) -> int:
        return len(np.asarray(next(iter((*self.numbers.values(), *self.categories.values())))))

    def only(self, rows: Sequence[int]) -> Settings:
        return Settings(
            {name: np.asarray(values, float)[list(rows)] for name, values in self.numbers.items()},
            {name: [values[row] for row in rows] for name, values in self.categories.items()},
            self.names,
        )

    def columns(self, factor: str, power: int) -> Array:
        """Return the columns of a factor in a term: (runs, 1), or (runs, names − 1) of a category."""
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
    """Columns (runs, columns) of a linear model, and the columns of each term."""

    columns: Array
    spans: Mapping[Term, slice]

    def dof(self, term: Term) -> int:
        span = self.spans[term]
        return int(span.stop - span.start)


def model_matrix(settings: Settings, terms: Sequence[Term]) -> ModelMatrix:
    """Return the columns of `terms` at `settings`."""
    blocks, spans, end = [], {}, 0
    for term in terms:
        block = np.ones((settings.runs, 1))
        for factor, power in term:
            columns = settings.columns(factor, power)
            block = (block[:, :, None] * columns[:, None, :]).reshape(len(block), -1)
        blocks.append(block)
        spans[term] = slice(end, end := end + block.shape[1])
    return ModelMatrix(np.hstack(blocks), spans)


def undetermined(model: ModelMatrix) -> list[Term]:
    """Return the terms with a column that the terms before them determine."""
    ranks = [int(np.linalg.matrix_rank(model.columns[:, : span.stop])) for span in model.spans.values()]
    return [
        term
        for term, before, rank in zip(model.spans, [0, *ranks], ranks, strict=False)
        if rank - before < model.dof(term)
    ]


@dataclass(frozen=True, slots=True)
class Fit:
    """A linear model fitted by statsmodels.

    ols : `statsmodels.regression.linear_model.RegressionResults`
    """

    model: ModelMatrix
    ols: Any

    @property
    def error_variance(self) -> float:
        """Variance of the error; NaN if no degrees of freedom are left to estimate it."""
        return float(self.ols.mse_resid) if self.ols.df_resid else math.nan

    @property
    def left_out_residuals(self) -> Array:
        """Measured less predicted by a model without that run; NaN if the model needs the run."""
        influence = self.ols.get_influence()
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(influence.hat_matrix_diag < 1 - 1e-9, influence.resid_press, np.nan)

    @property
    def predicted_r2(self) -> float:
        """Share of the variation that is predicted of runs left out one by one (PRESS); NaN if a run is needed."""
        left_out = self.left_out_residuals
        return 1 - float(left_out @ left_out) / float(self.ols.centered_tss)

    def adjusted_ss(self, term: Term) -> float:
        """Return what a term explains beyond all other terms (type III sum of squares)."""
        span = self.model.spans[term]
        effect = self.ols.params[span]
        return float(effect @ np.linalg.solve(self.ols.normalized_cov_params[span, span], effect))


def fit(model: ModelMatrix, response: ArrayLike) -> Fit:
    """Fit `model` to one response a run.

    Raises ValueError if the runs do not determine the terms, PreconditionError E8219 without statsmodels.
    """
    try:
        from statsmodels.regression.linear_model import OLS  # a second, and an optional extra
    except ImportError:
        raise failures.statsmodels_missing(install=installing("edmctl[study]")) from None
    if np.linalg.matrix_rank(model.columns) < model.columns.shape[1]:
        raise ValueError(f"These runs do not determine {', '.join(map(term_name, undetermined(model)))}.")
    return Fit(model, OLS(np.asarray(response, float), model.columns).fit())


@dataclass(frozen=True, slots=True)
class AnovaRow:
    """One line of the table; NaN for what the runs do not determine.

    sequential_ss : explained beyond the terms above; adjusted_ss : explained beyond all other terms
    contribution_pct : share of the total sum of squares, by the sequential one
    pure_pct : the same less what error alone would put there (Taguchi's ρ)
    against : the row that F compares with
    """

    name: str
    dof: int
    sequential_ss: float
    adjusted_ss: float
    mean_square: float
    f: float
    p: float
    contribution_pct: float
    pure_pct: float
    against: str = ERROR


@dataclass(frozen=True, slots=True)
class Anova:
    """The table: a row a term, the error and the total.

    pooled : terms that were counted as error, weakest first
    """

    rows: tuple[AnovaRow, ...]
    error: AnovaRow
    total: AnovaRow
    pooled: tuple[str, ...] = ()

    def under(self, name: str) -> AnovaRow:
        """Return the row that F of a term compares with; the error for a name that has no row."""
        rows = {row.name: row for row in self.rows}
        return rows.get(rows[name].against, self.error) if name in rows else self.error

    @property
    def by_block(self) -> tuple[AnovaRow, ...]:
        """The rows of products of a factor and the blocks."""
        names = {row.against for row in self.rows}
        return tuple(row for row in self.rows if row.name in names)


def anova(
    settings: Settings,
    terms: Sequence[Term],
    response: ArrayLike,
    pooled: Sequence[Term] = (),
    by_block: Sequence[Term] = (),
) -> Anova:
    """Return the table of `terms`; the terms of `pooled` count as error.

    by_block : products of a factor and the blocks (`differing`), rows after the others; F of such a factor is over
        its own product

    No F is given where nothing is left to estimate the error. Raises ValueError where the runs do not determine a
    term.
    """
    from scipy import special  # the state of a study needs terms, and not this

    model = model_matrix(settings, [*(term for term in terms if term not in pooled), *by_block])
    fitted = fit(model, response)
    explained = (np.linalg.qr(model.columns)[0].T @ fitted.ols.model.endog) ** 2
    total_ss, error_ss = float(fitted.ols.centered_tss), float(fitted.ols.ssr)

    def percent(ss: float) -> float:
        return 100 * ss / total_ss if total_ss else math.nan

    of_error = ERROR, int(fitted.ols.df_resid), fitted.error_variance
    compared = {
        product[:1]: (
            term_name(product),
            model.dof(product),
            fitted.adjusted_ss(product) / model.dof(product),
        )
        for product in by_block
    }
    rows = []
    for term, span in model.spans.items():
        if term == MEAN:
            continue
        against, rest_dof, rest_ms = compared.get(term, of_error)
        dof, sequential_ss, adjusted_ss = (
            model.dof(term),
            float(explained[span].sum()),
            fitted.adjusted_ss(term),
        )
        f = adjusted_ss / dof / rest_ms if rest_dof and rest_ms else math.nan
        rows.append(
            AnovaRow(
                name=term_name(term),
                dof=dof,
                sequential_ss=sequential_ss,
                adjusted_ss=adjusted_ss,
                mean_square=adjusted_ss / dof,
                f=f,
                p=float(special.fdtrc(dof, rest_dof, f)) if rest_dof else math.nan,
                contribution_pct=percent(sequential_ss),
                pure_pct=percent(sequential_ss - dof * rest_ms),
                against=against,
            )
        )
    nan, pure_pct = math.nan, 100 - sum(row.pure_pct for row in rows)
    error = AnovaRow(*of_error[:2], error_ss, error_ss, of_error[2], nan, nan, percent(error_ss), pure_pct)
    total = AnovaRow("total", len(fitted.ols.resid) - 1, total_ss, total_ss, nan, nan, nan, 100.0, 100.0)
    return Anova(tuple(rows), error, total, tuple(map(term_name, pooled)))


def differing(settings: Settings, terms: Sequence[Term], response: ArrayLike) -> list[Term]:
    """Return products of a factor and the blocks that exceed the error, the strongest first.

    They are taken one by one while the probability is below `MOST_P` over the number of factors, so that chance
    takes out of the error no more often than that, and while the error keeps `LEAST_ERROR_DOF`.
    """
    factors = [term for term in terms if len(term) == 1 and term[0][1] == 1 and term[0][0] != BLOCK]
    untried: list[Term] = [(*term, (BLOCK, 1)) for term in factors] if ((BLOCK, 1),) in terms else []
    chosen: list[Term] = []
    most_p = MOST_P / max(1, len(untried))
    before = fit(model_matrix(settings, terms), response)
    while untried and before.ols.ssr > EXACT * before.ols.centered_tss:
        tried = []
        for product in untried:
            model = model_matrix(settings, [*terms, *chosen, product])
            if len(before.ols.resid) - model.columns.shape[1] >= LEAST_ERROR_DOF and not undetermined(model):
                fitted = fit(model, response)
                tried.append((float(fitted.ols.compare_f_test(before.ols)[1]), product, fitted))
        p, product, before = min(tried, key=lambda trial: trial[0], default=(1.0, MEAN, before))
        if p >= most_p:
            break
        chosen.append(product)
        untried.remove(product)
    return chosen


def pooled_anova(
    settings: Settings, terms: Sequence[Term], response: ArrayLike, by_block: Sequence[Term] = ()
) -> Anova:
    """Return the table with the weakest terms counted as error, until that has half of the degrees of freedom.

    A factor that has a product in `by_block`, as in `anova`, is not pooled. That is Taguchi's habit. It makes F of
    the terms that stay too large, because the weakest of several were chosen: what it finds is a choice of factors
    for the confirmation run, no proof.
    """
    whole = anova(settings, terms, response, by_block=by_block)
    rows = {row.name: row for row in whole.rows}
    kept = {MEAN, *(product[:1] for product in by_block)}
    weakest_first = sorted(
        (term for term in terms if term not in kept), key=lambda term: rows[term_name(term)].mean_square
    )
    pooled: list[Term] = []
    dof = whole.error.dof
    for term in weakest_first[: None if by_block else -1]:
        if dof * 2 >= whole.total.dof:
            break
        pooled.append(term)
        dof += rows[term_name(term)].dof
    return anova(settings, terms, response, pooled, by_block)
