"""Analysis of variance: what each factor contributes to the variation of a response, and how sure that is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import special

from edmctl.doe.linear_model import MEAN, fit, model_matrix, term_name

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

    from edmctl.doe.linear_model import Settings, Term


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


@dataclass(frozen=True, slots=True)
class Anova:
    """The table: a row a term, the error and the total."""

    rows: tuple[AnovaRow, ...]
    error: AnovaRow
    total: AnovaRow
    pooled: tuple[str, ...] = ()
    """Terms that were counted as error, weakest first."""


def anova(
    settings: Settings, terms: Sequence[Term], response: ArrayLike, pooled: Sequence[Term] = ()
) -> Anova:
    """Return the table of `terms`; those of `pooled` count as error.

    No F is given where nothing is left to estimate the error. Raises ValueError where the runs do not determine a
    term.
    """
    kept = [term for term in terms if term not in pooled]
    model = model_matrix(settings, kept)
    fitted = fit(model, response)
    explained = (np.linalg.qr(model.columns)[0].T @ fitted.response) ** 2
    total_ss, error_dof, error_ms = fitted.total_ss, fitted.error_dof, fitted.error_variance
    rows = []
    for term, span in model.spans.items():
        if term == MEAN:
            continue
        dof, sequential, adjusted = (
            span.stop - span.start,
            float(explained[span].sum()),
            fitted.adjusted_ss(term),
        )
        f = adjusted / dof / error_ms if error_dof and error_ms else float("nan")
        p = float(special.fdtrc(dof, error_dof, f)) if error_dof else float("nan")
        shares = _shares(sequential, dof, error_ms, total_ss)
        rows.append(AnovaRow(term_name(term), dof, sequential, adjusted, adjusted / dof, f, p, *shares))
    nan = float("nan")
    all_dof = len(fitted.response) - 1
    error_ss = fitted.error_ss
    rest = 100 - sum(row.pure_pct for row in rows)
    error_pct = 100 * error_ss / total_ss if total_ss else nan
    error = AnovaRow("error", error_dof, error_ss, error_ss, error_ms, nan, nan, error_pct, rest)
    total = AnovaRow("total", all_dof, total_ss, total_ss, nan, nan, nan, 100.0, 100.0)
    return Anova(tuple(rows), error, total, tuple(term_name(term) for term in pooled))


def pooled_anova(settings: Settings, terms: Sequence[Term], response: ArrayLike) -> Anova:
    """Return the table with the weakest terms counted as error, until that has half of the degrees of freedom.

    That is Taguchi's habit. It makes F of the terms that stay too large, because the weakest of several were chosen:
    what it finds is a choice of factors for the confirmation run, no proof.
    """
    whole = anova(settings, terms, response)
    spans = model_matrix(settings, terms).spans
    strength = {row.name: row.adjusted_ss / row.dof for row in whole.rows}
    weakest_first = sorted(
        (term for term in terms if term != MEAN), key=lambda term: strength[term_name(term)]
    )
    pooled: list[Term] = []
    dof = whole.error.dof
    for term in weakest_first[:-1]:
        if dof * 2 >= whole.total.dof:
            break
        pooled.append(term)
        dof += spans[term].stop - spans[term].start
    return anova(settings, terms, response, pooled)


def _shares(ss: float, dof: int, error_ms: float, total_ss: float) -> tuple[float, float]:
    if not total_ss:
        return float("nan"), float("nan")
    return 100 * ss / total_ss, 100 * (ss - dof * error_ms) / total_ss
