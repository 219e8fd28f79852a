"""Analysis of variance: what each factor contributes to the variation of a response, and how sure that is.

Blocks are machines or tools, which are drawn at random. What a factor does differently in them is no error of the
others: it has a row of its own where it stands out, and the factor is compared with that (mixed model; Montgomery,
Design and Analysis of Experiments, 2017, chapter 13).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from edmctl.dataclasses import dataclass
from edmctl.study.statistics.linear_model import (
    MEAN,
    Settings,
    Term,
    fit,
    model_matrix,
    term_name,
    undetermined,
)

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
    from scipy import special

    kept = [*(term for term in terms if term not in pooled), *by_block]
    model = model_matrix(settings, kept)
    fitted = fit(model, response)
    explained = (np.linalg.qr(model.columns)[0].T @ fitted.response) ** 2
    total_ss, error_dof, error_ms = fitted.total_ss, fitted.error_dof, fitted.error_variance
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
    all_dof = len(fitted.response) - 1
    error_ss = fitted.error_ss
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
    from scipy import special

    factors = [term for term in terms if len(term) == 1 and term[0][1] == 1 and term[0][0] != block]
    left: list[Term] = [(*term, (block, 1)) for term in factors] if ((block, 1),) in terms else []
    found: list[Term] = []
    most_p = STANDS_OUT / max(1, len(left))
    before = fit(model_matrix(settings, terms), response)
    while left and before.error_ss > EXACT * before.total_ss:
        tried = []
        for product in left:
            model = model_matrix(settings, [*terms, *found, product])
            if len(before.response) - model.columns.shape[1] >= LEAST_ERROR_DOF and not undetermined(model):
                with_it = fit(model, response)
                dof = before.error_dof - with_it.error_dof
                f = (before.error_ss - with_it.error_ss) / dof / with_it.error_variance
                tried.append((float(special.fdtrc(dof, with_it.error_dof, f)), product, with_it))
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
