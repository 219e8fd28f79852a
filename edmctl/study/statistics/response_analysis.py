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
from typing import Literal

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
    LackOfFit,
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
        decibel = 10 * np.log10(ratio)
    return float(decibel) if np.isfinite(decibel) else float("nan")


@dataclass(frozen=True, slots=True)
class LevelMeans:
    """Means of a response at the levels of one factor: a row of the response table."""

    factor: str
    levels: tuple[object, ...]
    means: tuple[float, ...]
    rank: int
    """1 has the largest delta."""

    @property
    def delta(self) -> float:
        """Largest less smallest mean."""
        return max(self.means) - min(self.means)


def response_table(levels: Mapping[str, Sequence[object]], response: ArrayLike) -> list[LevelMeans]:
    """Return the means of `response` by level; `levels` has, by factor, the level of each run."""
    values = np.asarray(response, float)
    means = {}
    for factor, of_runs in levels.items():
        found = np.asarray(of_runs)
        distinct = np.unique(found).tolist() if found.dtype.kind in "iuf" else list(dict.fromkeys(of_runs))
        means[factor] = (tuple(distinct), tuple(float(values[found == level].mean()) for level in distinct))
    spread = {factor: max(m) - min(m) for factor, (_, m) in means.items()}
    order = sorted(spread, key=lambda factor: -spread[factor])
    return [LevelMeans(factor, *means[factor], order.index(factor) + 1) for factor in levels]


MOST_LEVELS = 8
"""Factors with more different values are a range, without means by level."""
MOST_PAIRS = 15
MANY = 1_000_000
"""Degrees of freedom of what is stated, not estimated."""


@dataclass(frozen=True, slots=True)
class Runs:
    """What was run, a row a run: settings as the model takes them, plain values, and what runs have in common.

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
        """Return some of the runs."""
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
class Interaction:
    """Means of a response at the levels of two factors: (levels of one, levels of other), NaN where none was run."""

    one: str
    other: str
    one_levels: tuple[object, ...]
    other_levels: tuple[object, ...]
    means: tuple[tuple[float, ...], ...]


@dataclass(frozen=True, slots=True)
class Coefficient:
    """One column of the model; `u95` is NaN where nothing is left to estimate the error."""

    name: str
    estimate: float
    u95: float
    p: float


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
        own = [term for term in self.terms if not _is_block(term)]
        matrix = model_matrix(replace(settings, names=self.names), own)
        columns = np.zeros((settings.runs, self.fit.model.columns.shape[1]))
        for term in own:
            columns[:, self.fit.model.spans[term]] = matrix.columns[:, matrix.spans[term]]
        expected = columns @ self.fit.ols.params
        leverage = np.einsum("ij,jk,ik->i", columns, self.fit.ols.normalized_cov_params, columns)
        # Each miss is of a mean over the replicates of its point: the rest of a single run's error comes on top.
        scatter, rest = self.scatter, 1 - 1 / self.replicates
        parts = [
            (self.miss_variance * (1 + leverage), self.miss_dof),
            (np.full(len(leverage), np.nan_to_num(scatter.run_variance) * rest), scatter.run_dof),
            (np.full(len(leverage), np.nan_to_num(scatter.block_variance)), scatter.block_dof),
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
    interactions: tuple[Interaction, ...] = ()
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
        half = special.stdtrit(scatter.run_dof, 1 - 0.025 / candidates) ** 2 * variance
        if scatter.block_dof:
            half += special.stdtrit(scatter.block_dof, 0.975) ** 2 * scatter.block_variance
        bounds = np.array([mean, mean - np.sqrt(half), mean + np.sqrt(half)])
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
    values = all_values[used]
    notes: list[str] = []
    if len(used) < len(all_values):
        notes.append(f"{len(all_values) - len(used)} of {len(all_values)} runs have no value")
    if is_log and len(values) and values.min() <= 0:
        notes.append("values at or below zero have no logarithm: the plain values are modelled")
        is_log = False
    base = ResponseAnalysis(
        name=name,
        better=better,
        is_log=is_log,
        used=tuple(used),
        values=tuple(values.tolist()),
        mean=float(values.mean()) if len(values) else math.nan,
        sd=float(values.std(ddof=1)) if len(values) > 1 else math.nan,
    )
    if len(used) < 2:
        return replace(base, notes=(*notes, "fewer than two runs have a value"))
    mine = runs.only(used)
    base, of_levels = _with_level_means(base, mine, values)
    notes += of_levels
    if np.ptp(values) <= 1e-12 * max(1.0, float(np.abs(values).max())):
        return replace(base, notes=(*notes, "all runs have the same value"))
    own = np.full(len(values), math.nan) if u is None else np.asarray(u, float)[used]
    alone = own / values if is_log else own
    alone_variance = float(np.mean(alone**2)) if mine.is_one_machine else math.nan
    logs = np.log(values) if is_log else values
    return _with_model(replace(base, notes=tuple(notes)), mine, logs, list(terms), alone_variance)


def _with_level_means(
    base: ResponseAnalysis, runs: Runs, values: Array
) -> tuple[ResponseAnalysis, list[str]]:
    """Add means by level of the runs that are no centre runs; return what there is to note too."""
    rows = [row for row, point in enumerate(runs.points) if point not in runs.others]
    designed, values = runs.only(rows), values[rows]
    counted = {factor: len(set(map(repr, of_runs))) for factor, of_runs in designed.plain.items()}
    notes = [f"only one level of {factor} has a value" for factor, many in counted.items() if many == 1]
    levels = {
        factor: of_runs for factor, of_runs in designed.plain.items() if 1 < counted[factor] <= MOST_LEVELS
    }
    if not levels:
        return base, notes
    points = designed.distinct
    of_point = np.asarray(designed.points)
    ratios = [signal_to_noise_db(values[of_point == point], base.better) for point in points]
    noise = []
    if np.isfinite(ratios).all():
        first = [designed.points.index(point) for point in points]
        noise = response_table({name: [of[row] for row in first] for name, of in levels.items()}, ratios)
    found = replace(
        base,
        level_means=tuple(response_table(levels, values)),
        noise_means=tuple(noise),
        interactions=_interactions(levels, values),
    )
    return found, notes


def _with_model(
    base: ResponseAnalysis, runs: Runs, values: Array, terms: list[Term], alone_variance: float
) -> ResponseAnalysis:
    notes = list(base.notes)
    settings = _named_by(runs.settings)
    runs = replace(runs, settings=settings)
    terms = [term for term in terms if all(_varies(settings, factor) for factor, _ in term)]
    lost = undetermined(model_matrix(settings, terms))
    if lost:
        notes.append(f"left out, for these runs do not determine them: {', '.join(map(term_name, lost))}")
        terms = [term for term in terms if term not in lost]
    try:
        fitted = fit(model_matrix(settings, terms), values)
        by_block = differing(settings, terms, values)
        table = anova(settings, terms, values, by_block=by_block)
        pooled = pooled_anova(settings, terms, values, by_block) if len(terms) > 2 else None
    except ValueError as error:
        return replace(base, notes=(*notes, str(error).rstrip(".")))
    if not fitted.ols.df_resid:
        notes.append("nothing is left to estimate the error: no F of single terms, no interval")
    scatter = _scatter(fitted, runs, values)
    if math.isfinite(alone_variance):
        scatter = replace(scatter, block_variance=alone_variance, block_dof=MANY)
    held, left_out = _left_out_coverage(terms, runs, values)
    return replace(
        base,
        anova=table,
        pooled=pooled if pooled is not None and pooled.pooled else None,
        coefficients=tuple(_coefficients(fitted, settings, table)),
        r2=float(fitted.ols.rsquared),
        adjusted_r2=float(fitted.ols.rsquared_adj) if fitted.ols.df_resid else math.nan,
        predicted_r2=fitted.predicted_r2,
        error_sd=math.sqrt(table.error.mean_square) if table.error.dof else math.nan,
        lack=_lack(fitted, scatter),
        fitted=tuple(fitted.ols.fittedvalues.tolist()),
        residuals=tuple(fitted.ols.resid.tolist()),
        block_effects=_block_effects(fitted, settings),
        held=held,
        left_out=left_out,
        scatter=scatter,
        model=_model(fitted, terms, runs, scatter, is_log=base.is_log),
        notes=tuple(notes),
    )


def _block_effects(fitted: Fit, settings: Settings) -> dict[object, float]:
    span = fitted.model.spans.get(((BLOCK, 1),))
    if span is None:
        return {}
    effects = fitted.ols.params[span]
    return dict(zip(settings.names[BLOCK], np.append(effects, -effects.sum()).tolist(), strict=True))


def _lack(fitted: Fit, scatter: Scatter) -> LackOfFit | None:
    """Split the error into what runs of one point differ by beyond their blocks, and what the model misses."""
    if not scatter.run_dof:
        return None
    pure_ss = scatter.run_variance * scatter.run_dof
    dof = int(fitted.ols.df_resid) - scatter.run_dof
    return LackOfFit(dof, max(0.0, float(fitted.ols.ssr) - pure_ss), scatter.run_dof, pure_ss)


def _named_by(settings: Settings) -> Settings:
    """Settings whose categories name what is there alone: a name without runs has no effect to find."""
    names = {}
    for factor, of_runs in settings.categories.items():
        there = set(map(repr, of_runs))
        names[factor] = [name for name in settings.names[factor] if repr(name) in there]
    return replace(settings, names=names)


def _varies(settings: Settings, factor: str) -> bool:
    if factor in settings.numbers:
        return float(np.ptp(np.asarray(settings.numbers[factor], float))) > 0
    return len(settings.names.get(factor, ())) > 1


def _is_block(term: Term) -> bool:
    return any(factor == BLOCK for factor, _ in term)


def _scatter(fitted: Fit, runs: Runs, values: Array) -> Scatter:
    """Variances within points, by a model of points and blocks, and of a new block about the mean of the others.

    The variance of blocks contains what the error adds to their means. A block of a single run is left out: its
    effect has the whole error of that run.
    """
    points, blocks = np.asarray(runs.points), np.asarray(runs.blocks)
    columns = [points == one for one in runs.distinct]
    columns += [blocks == one for one in list(dict.fromkeys(runs.blocks))[1:]]
    matrix = np.column_stack(columns).astype(float)
    run_variance, run_dof = math.nan, len(values) - int(np.linalg.matrix_rank(matrix))
    if len(runs.distinct) == len(points):
        run_dof = 0
    if run_dof:
        rest = values - matrix @ np.linalg.lstsq(matrix, values, rcond=None)[0]
        run_variance = float(rest @ rest) / run_dof
    named = list(runs.settings.categories.get(BLOCK, ()))
    of_blocks = _block_effects(fitted, runs.settings)
    effects = [effect for name, effect in of_blocks.items() if named.count(name) > 1]
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
        own = columns[rows]
        hat = own @ covariance @ own.T
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
    """Points whose runs are within the interval of a model without them, and how many could be left out."""
    held = tried = 0
    points = np.asarray(runs.points)
    for point in runs.distinct:
        own = points == point
        rest = runs.only(np.flatnonzero(~own).tolist())
        try:
            fitted = fit(model_matrix(rest.settings, terms), values[~own])
            model = _model(fitted, terms, rest, _scatter(fitted, rest, values[~own]), is_log=False)
            if model is None:
                continue
            _, low, high = model.predict(runs.settings.only(np.flatnonzero(own).tolist()))
        except (ValueError, np.linalg.LinAlgError):
            continue
        tried += 1
        held += bool(((values[own] >= low) & (values[own] <= high)).all())
    return held, tried


def _coefficients(fitted: Fit, settings: Settings, table: Anova) -> list[Coefficient]:
    """Coefficients, each with the error that the table compares its term with."""
    unscaled = np.diag(fitted.ols.normalized_cov_params)
    found = []
    for term, span in fitted.model.spans.items():
        under = table.under(term_name(term))
        errors = np.sqrt(unscaled * under.mean_square) if under.dof else np.full(len(unscaled), math.nan)
        quantile = float(special.stdtrit(under.dof, 0.975)) if under.dof else math.nan
        names = [list(settings.names[factor])[:-1] for factor, _ in term if factor in settings.categories]
        levels = list(itertools.product(*names))
        for n, column in enumerate(range(span.start, span.stop)):
            name, estimate = term_name(term), float(fitted.ols.params[column])
            if names:
                name += f" [{', '.join(map(str, levels[n]))}]"
            error = float(errors[column])
            ratio = abs(estimate) / error if error else math.nan
            p = 2 * float(special.stdtr(under.dof, -ratio)) if math.isfinite(ratio) else math.nan
            found.append(Coefficient(name, estimate, quantile * error, p))
    return found


def _interactions(levels: Mapping[str, Sequence[object]], values: Array) -> tuple[Interaction, ...]:
    found = []
    for one, other in list(itertools.combinations(levels, 2))[:MOST_PAIRS]:
        first, second = (_ordered(levels[name]) for name in (one, other))
        cells: dict[tuple[object, object], list[float]] = {}
        for pair, value in zip(zip(levels[one], levels[other], strict=True), values, strict=True):
            cells.setdefault(pair, []).append(value)
        means = tuple(tuple(float(np.mean(cells.get((a, b), [math.nan]))) for b in second) for a in first)
        found.append(Interaction(one, other, first, second, means))
    return tuple(found)


def _ordered(values: Sequence[object]) -> tuple[object, ...]:
    distinct = list(dict.fromkeys(values))
    if all(isinstance(value, int | float) and not isinstance(value, bool) for value in distinct):
        return tuple(sorted(distinct, key=lambda value: float(value)))  # type: ignore[arg-type]
    return tuple(distinct)
