"""Least squares and analysis of variance: what each factor contributes to the variation of a response.

Blocks are machines or tools, which are drawn at random. If a factor acts differently in them, that interaction has a
row of its own, and the factor is compared with that row instead of the error (mixed model; Montgomery, Design and
Analysis of Experiments, 2017, chapter 13).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from edmctl import failures
from edmctl.array_types import Array
from edmctl.dataclasses import dataclass
from edmctl.errors import installing
from edmctl.study.statistics.linear_model import (
    MEAN,
    ModelMatrix,
    Settings,
    Term,
    model_matrix,
    term_name,
    undetermined,
)


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
        return float(self.ols.mse_resid) if self.ols.df_resid else float("nan")

    @property
    def predicted_r2(self) -> float:
        """Share of the variation that is predicted of runs left out one by one (PRESS); NaN if a run is needed."""
        left_out = self.left_out_residuals
        return 1 - float(left_out @ left_out) / float(self.ols.centered_tss)

    @property
    def left_out_residuals(self) -> Array:
        """Measured less predicted by a model without that run; NaN if the model needs the run."""
        influence = self.ols.get_influence()
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(influence.hat_matrix_diag < 1 - 1e-9, influence.resid_press, np.nan)

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
class LackOfFit:
    """Whether a model misses more than runs at the same settings differ."""

    dof: int
    ss: float
    pure_dof: int
    pure_ss: float

    @property
    def f(self) -> float:
        """Ratio of the variances; NaN where either has no degrees of freedom."""
        if not self.dof or not self.pure_dof or not self.pure_ss:
            return float("nan")
        return (self.ss / self.dof) / (self.pure_ss / self.pure_dof)

    @property
    def p(self) -> float:
        """Probability of such a ratio where the model is right."""
        return float(special.fdtrc(self.dof, self.pure_dof, self.f))


ERROR = "error"
STANDS_OUT = 0.05
"""What a factor does differently in blocks has a row below this probability, shared among all that are tried."""
LEAST_ERROR_DOF = 3
EXACT = 1e-20
"""An error of so small a share of the sum of squares is rounding."""


@dataclass(frozen=True, slots=True)
class AnovaRow:
    """One line of the table. Of what cannot be said, NaN."""

    name: str
    dof: int
    sequential_ss: float
    """Explained beyond the terms above."""
    adjusted_ss: float
    """Explained beyond all other terms."""
    mean_square: float
    f: float
    p: float
    contribution_pct: float
    """Share of the total sum of squares, by the sequential one."""
    pure_pct: float
    """The same less what error alone would put there (Taguchi's ρ)."""
    against: str = ERROR
    """The row that F compares with."""


@dataclass(frozen=True, slots=True)
class Anova:
    """The table: a row a term, the error and the total."""

    rows: tuple[AnovaRow, ...]
    error: AnovaRow
    total: AnovaRow
    pooled: tuple[str, ...] = ()
    """Terms that were counted as error, weakest first."""

    def under(self, name: str) -> AnovaRow:
        """Return the row that F of a term compares with; the error for a name that has no row."""
        rows = {row.name: row for row in self.rows}
        return rows.get(rows[name].against, self.error) if name in rows else self.error

    @property
    def by_block(self) -> tuple[AnovaRow, ...]:
        """Return the rows of what a factor does differently from block to block."""
        names = {row.against for row in self.rows}
        return tuple(row for row in self.rows if row.name in names)


def anova(
    settings: Settings,
    terms: Sequence[Term],
    response: ArrayLike,
    pooled: Sequence[Term] = (),
    by_block: Sequence[Term] = (),
) -> Anova:
    """Return the table of `terms`; those of `pooled` count as error.

    by_block : products of a factor and the blocks (`differing`), rows after the others; F of such a factor is over
        its own product

    No F is given where nothing is left to estimate the error. Raises ValueError where the runs do not determine a
    term.
    """
    kept = [*(term for term in terms if term not in pooled), *by_block]
    model = model_matrix(settings, kept)
    fitted = fit(model, response)
    explained = (np.linalg.qr(model.columns)[0].T @ fitted.ols.model.endog) ** 2
    total_ss, error_ms = float(fitted.ols.centered_tss), fitted.error_variance
    error_dof = int(fitted.ols.df_resid)
    under = {}
    for product in by_block:
        dof = model.spans[product].stop - model.spans[product].start
        under[product[:1]] = (term_name(product), dof, fitted.adjusted_ss(product) / dof)
    rows = []
    for term, span in model.spans.items():
        if term == MEAN:
            continue
        dof, sequential, adjusted = (
            span.stop - span.start,
            float(explained[span].sum()),
            fitted.adjusted_ss(term),
        )
        against, rest_dof, rest_ms = under.get(term, (ERROR, error_dof, error_ms))
        f = adjusted / dof / rest_ms if rest_dof and rest_ms else float("nan")
        p = float(special.fdtrc(dof, rest_dof, f)) if rest_dof else float("nan")
        shares = _shares(sequential, dof, rest_ms, total_ss)
        rows.append(
            AnovaRow(term_name(term), dof, sequential, adjusted, adjusted / dof, f, p, *shares, against)
        )
    nan = float("nan")
    all_dof = len(fitted.ols.resid) - 1
    error_ss = float(fitted.ols.ssr)
    rest = 100 - sum(row.pure_pct for row in rows)
    error_pct = 100 * error_ss / total_ss if total_ss else nan
    error = AnovaRow(ERROR, error_dof, error_ss, error_ss, error_ms, nan, nan, error_pct, rest)
    total = AnovaRow("total", all_dof, total_ss, total_ss, nan, nan, nan, 100.0, 100.0)
    return Anova(tuple(rows), error, total, tuple(term_name(term) for term in pooled))


def differing(settings: Settings, terms: Sequence[Term], response: ArrayLike, block: str) -> list[Term]:
    """Return products of a factor and the blocks that stand out of the error, the strongest first.

    One is taken after the other while its probability is below `STANDS_OUT` over the number of factors, so that
    chance takes out of the error no more often than that, and while the error keeps `LEAST_ERROR_DOF`.
    """
    factors = [term for term in terms if len(term) == 1 and term[0][1] == 1 and term[0][0] != block]
    left: list[Term] = [(*term, (block, 1)) for term in factors] if ((block, 1),) in terms else []
    found: list[Term] = []
    most_p = STANDS_OUT / max(1, len(left))
    before = fit(model_matrix(settings, terms), response)
    while left and before.ols.ssr > EXACT * before.ols.centered_tss:
        tried = []
        for product in left:
            model = model_matrix(settings, [*terms, *found, product])
            if len(before.ols.resid) - model.columns.shape[1] >= LEAST_ERROR_DOF and not undetermined(model):
                with_it = fit(model, response)
                tried.append((float(with_it.ols.compare_f_test(before.ols)[1]), product, with_it))
        p, product, with_it = min(tried, key=lambda one: one[0], default=(1.0, MEAN, before))
        if p >= most_p:
            break
        found.append(product)
        left.remove(product)
        before = with_it
    return found


def pooled_anova(
    settings: Settings, terms: Sequence[Term], response: ArrayLike, by_block: Sequence[Term] = ()
) -> Anova:
    """Return the table with the weakest terms counted as error, until that has half of the degrees of freedom.

    A factor that has a product in `by_block`, as in `anova`, is not pooled. That is Taguchi's habit. It makes F of
    the terms that stay too large, because the weakest of several were chosen: what it finds is a choice of factors
    for the confirmation run, no proof.
    """
    whole = anova(settings, terms, response, by_block=by_block)
    spans = model_matrix(settings, terms).spans
    strength = {row.name: row.adjusted_ss / row.dof for row in whole.rows}
    held = {MEAN, *(product[:1] for product in by_block)}
    weakest_first = sorted(
        (term for term in terms if term not in held), key=lambda term: strength[term_name(term)]
    )
    pooled: list[Term] = []
    dof = whole.error.dof
    for term in weakest_first[: None if by_block else -1]:
        if dof * 2 >= whole.total.dof:
            break
        pooled.append(term)
        dof += spans[term].stop - spans[term].start
    return anova(settings, terms, response, pooled, by_block)


def _shares(ss: float, dof: int, error_ms: float, total_ss: float) -> tuple[float, float]:
    if not total_ss:
        return float("nan"), float("nan")
    return 100 * ss / total_ss, 100 * (ss - dof * error_ms) / total_ss
