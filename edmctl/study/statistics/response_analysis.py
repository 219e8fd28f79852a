"""One response of a designed experiment, from its values to tables, model and intervals.

A prediction is of a new run on a new machine (block). Its interval contains what a smooth model misses: the error is
that of points left out one by one with all of their replicates. What models miss, what runs of one point and what
machines differ by have a quantile each, and their half-widths add as squares: with the degrees of freedom of a sum
of variances (Satterthwaite) a few machines that happen to be alike would make an interval narrow.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from edmctl.array_types import Array
from edmctl.dataclasses import dataclass, field, replace
from edmctl.start_up import one_blas_thread
from edmctl.study.statistics.linear_model import (
    BLOCK,
    Anova,
    Fit,
    Settings,
    Term,
    anova,
    differing,
    fit,
    model_matrix,
    pooled_anova,
    term_name,
    undetermined,
)

Better = Literal["larger", "smaller", "nominal"]

MOST_LEVELS = 8
"""Factors with more different values are a range, without means by level."""
STATED_DOF = 1_000_000
"""Degrees of freedom of a stated uncertainty."""


def signal_to_noise_db(values: ArrayLike, better: Better) -> float:
    """Return the signal-to-noise ratio of the replicates of one point, in dB; NaN where it is not defined.

    Larger is better: −10 lg mean(1/y²). Smaller is better: −10 lg mean(y²). Nominal is best: 10 lg(mean²/variance),
    for which it takes two replicates (Phadke, Quality Engineering Using Robust Design, 1989, chapter 5).
    """
    y = np.asarray(values, float)
    ratio: float | np.floating
    with np.errstate(divide="ignore", invalid="ignore"):
        if better == "larger":
            ratio = 1 / np.mean(1 / y**2)
        elif better == "smaller":
            ratio = 1 / np.mean(y**2)
        else:
            ratio = np.mean(y) ** 2 / np.var(y, ddof=1) if len(y) > 1 else np.nan
        decibel = float(10 * np.log10(ratio))
    return decibel if math.isfinite(decibel) else math.nan


@dataclass(frozen=True, slots=True)
class LevelMeans:
    """Means of a response at the levels of one factor: a row of the response table.

    rank : 1 has the largest delta
    """

    factor: str
    levels: tuple[object, ...]
    means: tuple[float, ...]
    rank: int

    @property
    def delta(self) -> float:
        return max(self.means) - min(self.means)


def response_table(
    levels: Mapping[str, Sequence[object]],
    response: ArrayLike,
    names: Mapping[str, Sequence[object]] | None = None,
) -> list[LevelMeans]:
    """Return the means of `response` by level; `levels` has, by factor, the level of each run."""
    values = np.asarray(response, float)
    table = []
    for factor, of_runs in levels.items():
        distinct = _in_order(of_runs, (names or {}).get(factor, ()))
        is_level = [np.array([level == other for other in of_runs]) for level in distinct]
        table.append(LevelMeans(factor, distinct, tuple(float(values[of].mean()) for of in is_level), 0))
    order = sorted(table, key=lambda row: -row.delta)
    return [replace(row, rank=order.index(row) + 1) for row in table]


def _in_order(levels: Sequence[object], names: Sequence[object]) -> tuple[object, ...]:
    """Return the different levels: numbers by size, others as in `names`, or as they come."""
    distinct = list(dict.fromkeys(levels))
    if all(isinstance(level, int | float) and not isinstance(level, bool) for level in distinct):
        return tuple(sorted(distinct))  # type: ignore[type-var]
    return tuple(sorted(distinct, key=list(names).index) if set(distinct) <= set(names) else distinct)


@dataclass(frozen=True, slots=True)
class Runs:
    """Runs, a row each: settings as the model takes them, plain values, and what runs have in common.

    points : equal where the settings are
    blocks : equal on one machine or tool
    others : points that no mean of a level includes: centre runs would unbalance it
    is_one_machine : whether one machine with one tool made all of them
    """

    settings: Settings
    plain: Mapping[str, Sequence[object]]
    points: Sequence[int]
    blocks: Sequence[int]
    others: frozenset[int] = frozenset()
    is_one_machine: bool = False

    def only(self, rows: Sequence[int]) -> Runs:
        return replace(
            self,
            settings=self.settings.only(rows),
            plain={name: [values[row] for row in rows] for name, values in self.plain.items()},
            points=[self.points[row] for row in rows],
            blocks=[self.blocks[row] for row in rows],
        )

    @property
    def distinct(self) -> list[int]:
        """The points, in the order of their first runs."""
        return list(dict.fromkeys(self.points))


@dataclass(frozen=True, slots=True)
class Coefficient:
    """One column of the model; `u95` is NaN where nothing is left to estimate the error."""

    name: str
    estimate: float
    u95: float
    p: float


@dataclass(frozen=True, slots=True)
class LackOfFit:
    """Comparison of what a model misses with the differences of runs at the same settings.

    f, p : ratio of the variances and its probability if the model is right; NaN without degrees of freedom
    """

    dof: int
    ss: float
    pure_dof: int
    pure_ss: float

    @property
    def f(self) -> float:
        if not self.dof or not self.pure_dof or not self.pure_ss:
            return math.nan
        return (self.ss / self.dof) / (self.pure_ss / self.pure_dof)

    @property
    def p(self) -> float:
        return float(special.fdtrc(self.dof, self.pure_dof, self.f))


@dataclass(frozen=True, slots=True)
class Scatter:
    """Variance of runs of one point on one machine, and of machines; NaN, without degrees of freedom, if unknown."""

    run_variance: float
    run_dof: int
    block_variance: float
    block_dof: int


@dataclass(frozen=True, slots=True)
class ResponseModel:
    """A fitted model with the errors of its predictions; on a logarithmic scale where `is_log`.

    names : names of each category that the fit knows, in their order
    miss_variance : of the error at a point that was left out
    replicates : mean number of runs of a point
    """

    fit: Fit
    terms: tuple[Term, ...]
    names: Mapping[str, Sequence[object]]
    is_log: bool
    miss_variance: float
    miss_dof: int
    scatter: Scatter
    replicates: float = 1.0

    def predict(self, settings: Settings) -> tuple[Array, Array, Array]:
        """Return what is expected of new runs on new machines, and the bounds of the 95 % interval of each.

        Raises ValueError for a category that the fit does not know.
        """
        # Settings name no block: a new machine is as others are on average.
        terms = [term for term in self.terms if not _is_block(term)]
        matrix = model_matrix(replace(settings, names=self.names), terms)
        columns = np.zeros((settings.runs, self.fit.model.columns.shape[1]))
        for term in terms:
            columns[:, self.fit.model.spans[term]] = matrix.columns[:, matrix.spans[term]]
        expected = columns @ self.fit.ols.params
        leverage = np.einsum("ij,jk,ik->i", columns, self.fit.ols.normalized_cov_params, columns)
        # Each miss is of a mean over the replicates of its point: the rest of a single run's error comes on top.
        scatter = self.scatter
        parts = [
            (self.miss_variance * (1 + leverage), self.miss_dof),
            (np.nan_to_num(scatter.run_variance) * (1 - 1 / self.replicates), scatter.run_dof),
            (np.nan_to_num(scatter.block_variance), scatter.block_dof),
        ]
        half = np.sqrt(sum(special.stdtrit(dof, 0.975) ** 2 * variance for variance, dof in parts if dof))
        bounds = expected, expected - half, expected + half
        return tuple(map(np.exp, bounds)) if self.is_log else bounds


@dataclass(frozen=True, slots=True)
class ResponseAnalysis:
    """All tables of one response. What the runs do not determine is None, empty or NaN, and `notes` say why.

    used : rows whose value is there; fitted, residuals : one a run of `used`, on the scale of the model
    noise_means : means of the signal-to-noise ratio by level, dB
    block_effects : by block, its deviation from the average block, on the scale of the model
    held, left_out : points whose every run is within the interval of a model without them, of how many
    scatter : None if nothing is fitted; model : None also if no point can be left out
    """

    name: str
    better: Better
    is_log: bool
    used: tuple[int, ...]
    values: tuple[float, ...]
    mean: float
    sd: float
    notes: tuple[str, ...] = ()
    anova: Anova | None = None
    pooled: Anova | None = None
    coefficients: tuple[Coefficient, ...] = ()
    r2: float = math.nan
    adjusted_r2: float = math.nan
    predicted_r2: float = math.nan
    error_sd: float = math.nan
    lack: LackOfFit | None = None
    level_means: tuple[LevelMeans, ...] = ()
    noise_means: tuple[LevelMeans, ...] = ()
    fitted: tuple[float, ...] = ()
    residuals: tuple[float, ...] = ()
    block_effects: Mapping[object, float] = field(default_factory=dict)
    held: int = 0
    left_out: int = 0
    scatter: Scatter | None = None
    model: ResponseModel | None = None

    def without_block(self, value: float, block: object) -> float:
        """Return a value corrected by the effect of its block; unchanged if the model has no such block."""
        effect = self.block_effects.get(block, 0.0)
        return value * math.exp(-effect) if self.is_log else value - effect

    def at_point(self, adjusted: ArrayLike, candidates: int) -> tuple[float, float, float] | None:
        """Return what is expected of a new run on a new machine where runs were made, by these; and its interval.

        No model of the settings is in it. The quantile of the scatter of runs is that of `candidates` points at once
        (Bonferroni), because the best of many by its mean has been lucky too; where the point's own runs differ by
        more than those of others do, that counts. None for fewer than two runs, and where the scatter of repeated
        runs is known less well than what the model misses.

        adjusted : values without the effects of their blocks, as `without_block` returns them
        """
        values = np.asarray(adjusted, float)
        values = np.log(values) if self.is_log else values
        scatter, miss_dof = self.scatter, self.model.miss_dof if self.model is not None else 0
        if scatter is None or len(values) < 2 or scatter.run_dof < max(2, miss_dof):
            return None
        mean = values.mean()
        variance = max(scatter.run_variance, float(values.var(ddof=1))) * (1 + 1 / len(values))
        square = special.stdtrit(scatter.run_dof, 1 - 0.025 / candidates) ** 2 * variance
        if scatter.block_dof:
            square += special.stdtrit(scatter.block_dof, 0.975) ** 2 * scatter.block_variance
        bounds = mean + np.array([0.0, -1.0, 1.0]) * np.sqrt(square)
        return tuple((np.exp(bounds) if self.is_log else bounds).tolist())


@one_blas_thread()
def analyse(
    name: str,
    runs: Runs,
    response: ArrayLike,
    terms: Sequence[Term],
    better: Better,
    *,
    is_log: bool = False,
    u: ArrayLike | None = None,
) -> ResponseAnalysis:
    """Analyse a response: one value a run, NaN where there is none. Nothing that the runs do not determine raises.

    u : standard uncertainties of the values; where all runs are of one machine, another one may differ by that
    """
    all_values = np.asarray(response, float)
    used = np.flatnonzero(np.isfinite(all_values)).tolist()
    values, runs = all_values[used], runs.only(used)
    notes = []
    if len(used) < len(all_values):
        notes.append(f"{len(all_values) - len(used)} of {len(all_values)} runs have no value")
    if is_log and len(values) and values.min() <= 0:
        notes.append("values at or below zero have no logarithm: the plain values are modelled")
        is_log = False
    found = ResponseAnalysis(
        name=name,
        better=better,
        is_log=is_log,
        used=tuple(used),
        values=tuple(values.tolist()),
        mean=float(values.mean()) if len(values) else math.nan,
        sd=float(values.std(ddof=1)) if len(values) > 1 else math.nan,
    )
    if len(used) < 2:
        return replace(found, notes=(*notes, "fewer than two runs have a value"))
    found = replace(found, **_level_tables(runs, values, better, notes))
    if np.ptp(values) <= 1e-12 * max(1.0, float(np.abs(values).max())):
        return replace(found, notes=(*notes, "all runs have the same value"))
    machine_variance = math.nan
    if runs.is_one_machine and u is not None:
        machine_variance = float(np.mean((np.asarray(u, float)[used] / (values if is_log else 1.0)) ** 2))
    try:
        model = _fitted(
            runs, np.log(values) if is_log else values, terms, machine_variance, notes, is_log=is_log
        )
        found = replace(found, **model)
    except ValueError as error:
        notes.append(str(error).rstrip("."))
    return replace(found, notes=tuple(notes))


def _level_tables(runs: Runs, values: Array, better: Better, notes: list[str]) -> dict[str, Any]:
    """Return means by level of the runs that are no centre runs."""
    rows = [row for row, point in enumerate(runs.points) if point not in runs.others]
    runs, values = runs.only(rows), values[rows]
    counts = {factor: len(set(map(repr, of_runs))) for factor, of_runs in runs.plain.items()}
    notes += [f"only one level of {factor} has a value" for factor, count in counts.items() if count == 1]
    levels = {factor: runs.plain[factor] for factor, count in counts.items() if 1 < count <= MOST_LEVELS}
    if not levels:
        return {}
    names, points = runs.settings.names, np.asarray(runs.points)
    ratios = [signal_to_noise_db(values[points == point], better) for point in runs.distinct]
    first = [runs.points.index(point) for point in runs.distinct]
    of_points = {factor: [of_runs[row] for row in first] for factor, of_runs in levels.items()}
    noise = response_table(of_points, ratios, names) if np.isfinite(ratios).all() else []
    return {
        "level_means": tuple(response_table(levels, values, names)),
        "noise_means": tuple(noise),
    }


def _fitted(
    runs: Runs,
    values: Array,
    terms: Sequence[Term],
    machine_variance: float,
    notes: list[str],
    *,
    is_log: bool,
) -> dict[str, Any]:
    """Return the fields of an analysis that follow from the fitted model.

    machine_variance : of the difference to another machine, if one machine made all runs
    """
    settings = _with_used_names(runs.settings)
    runs = replace(runs, settings=settings)
    terms = [term for term in terms if all(_varies(settings, factor) for factor, _ in term)]
    lost = undetermined(model_matrix(settings, terms))
    if lost:
        notes.append(f"left out, for these runs do not determine them: {', '.join(map(term_name, lost))}")
        terms = [term for term in terms if term not in lost]
    fitted = fit(model_matrix(settings, terms), values)
    by_block = differing(settings, terms, values)
    table = anova(settings, terms, values, by_block=by_block)
    pooled = pooled_anova(settings, terms, values, by_block) if len(terms) > 2 else None
    error_dof = int(fitted.ols.df_resid)
    if not error_dof:
        notes.append("nothing is left to estimate the error: no F of single terms, no interval")
    scatter = _scatter(fitted, runs, values)
    lack = None
    if scatter.run_dof:  # the error beyond what runs of one point differ by
        pure_ss = scatter.run_variance * scatter.run_dof
        missed_ss = max(0.0, float(fitted.ols.ssr) - pure_ss)
        lack = LackOfFit(error_dof - scatter.run_dof, missed_ss, scatter.run_dof, pure_ss)
    if math.isfinite(machine_variance):
        scatter = replace(scatter, block_variance=machine_variance, block_dof=STATED_DOF)
    held, left_out = _left_out_coverage(terms, runs, values)
    return {
        "anova": table,
        "pooled": pooled if pooled is not None and pooled.pooled else None,
        "coefficients": tuple(_coefficients(fitted, settings, table)),
        "r2": float(fitted.ols.rsquared),
        "adjusted_r2": float(fitted.ols.rsquared_adj) if error_dof else math.nan,
        "predicted_r2": fitted.predicted_r2,
        "error_sd": math.sqrt(table.error.mean_square) if table.error.dof else math.nan,
        "lack": lack,
        "fitted": tuple(fitted.ols.fittedvalues.tolist()),
        "residuals": tuple(fitted.ols.resid.tolist()),
        "block_effects": _block_effects(fitted, settings),
        "held": held,
        "left_out": left_out,
        "scatter": scatter,
        "model": _model(fitted, terms, runs, scatter, is_log=is_log),
    }


def _with_used_names(settings: Settings) -> Settings:
    """Return settings whose categories name only what was run: a name without runs has no effect to find."""
    names = {}
    for factor, of_runs in settings.categories.items():
        used = set(map(repr, of_runs))
        names[factor] = [name for name in settings.names[factor] if repr(name) in used]
    return replace(settings, names=names)


def _varies(settings: Settings, factor: str) -> bool:
    if factor in settings.numbers:
        return float(np.ptp(np.asarray(settings.numbers[factor], float))) > 0
    return len(settings.names.get(factor, ())) > 1


def _is_block(term: Term) -> bool:
    return any(factor == BLOCK for factor, _ in term)


def _block_effects(fitted: Fit, settings: Settings) -> dict[object, float]:
    span = fitted.model.spans.get(((BLOCK, 1),))
    if span is None:
        return {}
    effects = fitted.ols.params[span]
    return dict(zip(settings.names[BLOCK], np.append(effects, -effects.sum()).tolist(), strict=True))


def _scatter(fitted: Fit, runs: Runs, values: Array) -> Scatter:
    """Return variances within points, by a model of points and blocks, and of a new block about the mean of others.

    The variance of blocks contains what the error adds to their means. A block of a single run is left out: its
    effect has the whole error of that run.
    """
    points, blocks = np.asarray(runs.points), np.asarray(runs.blocks)
    columns = [points == point for point in runs.distinct]
    columns += [blocks == block for block in list(dict.fromkeys(runs.blocks))[1:]]
    matrix = np.column_stack(columns).astype(float)
    run_variance, run_dof = math.nan, 0
    if len(runs.distinct) < len(points):
        run_dof = len(values) - int(np.linalg.matrix_rank(matrix))
    if run_dof:
        rest = values - matrix @ np.linalg.lstsq(matrix, values, rcond=None)[0]
        run_variance = float(rest @ rest) / run_dof
    names = list(runs.settings.categories.get(BLOCK, ()))
    block_effects = _block_effects(fitted, runs.settings)
    effects = [effect for name, effect in block_effects.items() if names.count(name) > 1]
    if len(effects) < 2:
        return Scatter(run_variance, run_dof, math.nan, 0)
    block_variance = float(np.var(effects, ddof=1)) * (1 + 1 / len(effects))
    return Scatter(run_variance, run_dof, block_variance, len(effects) - 1)


def _model(
    fitted: Fit, terms: Sequence[Term], runs: Runs, scatter: Scatter, *, is_log: bool
) -> ResponseModel | None:
    """Return the model with the variance of its misses at leverage 0; None where no point can be left out."""
    columns, covariance = fitted.model.columns, fitted.ols.normalized_cov_params
    points, squares = np.asarray(runs.points), []
    for point in runs.distinct:
        rows = np.flatnonzero(points == point)
        hat = columns[rows] @ covariance @ columns[rows].T
        rest = np.eye(len(rows)) - hat
        if np.linalg.matrix_rank(rest, tol=1e-9) < len(rows):
            continue  # the model needs the point
        missed = np.linalg.solve(rest, fitted.ols.resid[rows])
        without = hat + hat @ np.linalg.solve(rest, hat)
        squares.append(float(missed.mean()) ** 2 / (1 + float(without.mean())))
    of_blocks = sum(fitted.model.dof(term) for term in fitted.model.spans if _is_block(term))
    dof = len(runs.distinct) - (columns.shape[1] - of_blocks)
    if not squares or dof < 1:
        return None
    return ResponseModel(
        fit=fitted,
        terms=tuple(terms),
        names=runs.settings.names,
        is_log=is_log,
        miss_variance=sum(squares) / len(squares),
        miss_dof=dof,
        scatter=scatter,
        replicates=len(points) / len(runs.distinct),
    )


def _left_out_coverage(terms: Sequence[Term], runs: Runs, values: Array) -> tuple[int, int]:
    """Return the number of points whose runs are within the interval of a model without them, and of all tried."""
    held = tried = 0
    points = np.asarray(runs.points)
    for point in runs.distinct:
        is_out = points == point
        rest = runs.only(np.flatnonzero(~is_out).tolist())
        try:
            fitted = fit(model_matrix(rest.settings, terms), values[~is_out])
            model = _model(fitted, terms, rest, _scatter(fitted, rest, values[~is_out]), is_log=False)
            if model is None:
                continue
            _, low, high = model.predict(runs.settings.only(np.flatnonzero(is_out).tolist()))
        except (ValueError, np.linalg.LinAlgError):
            continue
        tried += 1
        held += bool(((values[is_out] >= low) & (values[is_out] <= high)).all())
    return held, tried


def _coefficients(fitted: Fit, settings: Settings, table: Anova) -> list[Coefficient]:
    """Return the coefficients, each with the error that the table compares its term with."""
    unscaled = np.diag(fitted.ols.normalized_cov_params)
    found = []
    for term, span in fitted.model.spans.items():
        under = table.under(term_name(term))
        quantile = float(special.stdtrit(under.dof, 0.975)) if under.dof else math.nan
        names = [list(settings.names[factor])[:-1] for factor, _ in term if factor in settings.categories]
        levels = itertools.product(*names)
        for column, level in zip(range(span.start, span.stop), levels, strict=True):
            name = f"{term_name(term)} [{', '.join(map(str, level))}]" if level else term_name(term)
            estimate = float(fitted.ols.params[column])
            error = math.sqrt(unscaled[column] * under.mean_square) if under.dof else math.nan
            p = 2 * float(special.stdtr(under.dof, -abs(estimate) / error)) if error > 0 else math.nan
            found.append(Coefficient(name, estimate, quantile * error, p))
    return found
