"""Gaussian processes of 3 to 60 noisy runs over up to eight factors coded to 0 … 1, and where to run next.

A process has a linear trend, a smooth deviation (Matérn 5/2, a length scale a factor), noise, and where runs come in
blocks an effect of each block. Wide normal priors of the trend are generalised least squares that also holds where
runs do not determine a coefficient (Rasmussen and Williams, Gaussian Processes for Machine Learning, 2006, section
2.7). Predictions are averages over draws about the maximum of the posterior, weighted by truncated importance
(Ionides, J. Comput. Graph. Stat. 17, 2008). The draws are a fixed sequence: the same runs give the same process.

Priors are log-normal, over values standardised to a standard deviation of 1. As in Hvarfner, Hellsten and Nardi
(ICML 2024, arXiv:2402.02229) length scales grow with the root of the number of factors, and the variance of the
noise has a median of exp(−4). Length scales are shorter and less spread than there, because the trend takes what is
long: with theirs, intervals of 95 % held 91 % of functions like those of the tests.

Runs are chosen by expected improvement times the probability that all constraints hold (Gardner et al., ICML 2014),
several at a time by assuming that each comes out as predicted (kriging believer: Ginsbourger, Le Riche and Carraro,
2010). A process over 0 and 1 predicts where runs fail (least-squares classification, Rasmussen and Williams, 6.5).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg, optimize, special

from edmctl.array_types import Array
from edmctl.dataclasses import dataclass, field, replace
from edmctl.start_up import one_blas_thread

Trend = Literal["constant", "linear"]
Purpose = Literal["feasibility", "improvement", "confirmation"]
Constraints = Sequence[tuple[ArrayLike, float]]
"""Values of each constraint, and the limit that what is expected of them may not exceed."""

FEWEST_RUNS = 3
MEDIAN_LENGTH, SPREAD_OF_LENGTH = 0.3, 1.0
"""Of one factor's length scale, in its range, and of the logarithm of the length scale."""
MEDIAN_SIGNAL, SPREAD_OF_SIGNAL = 1.0, 1.0
MEDIAN_NOISE, SPREAD_OF_NOISE = float(np.exp(-2)), 1.0
MEDIAN_BLOCK, SPREAD_OF_BLOCK = float(np.exp(-2)), 1.0
SD_OF_MEAN, SD_OF_SLOPE = 10.0, 5.0
"""Of the trend's coefficients, where factors go from −½ to ½."""
SMALLEST_NOISE = 1e-3
DRAWS = 48
WIDER = 1.3
"""Standard deviation of the draws to that of the normal approximation at the maximum."""
STARTS = ((0.0, 0.0, 0.0), (-1.0, 0.5, -0.5), (1.0, -0.5, 1.5))
"""Of length scales, signal and noise, in spreads of their priors."""
CHUNK = 512
"""Points predicted at a time."""


@dataclass(slots=True)
class GaussianProcess:
    """A process fitted by `fit_process`, over k draws of hyperparameters, n runs and d factors."""

    points: Array
    """(n, d)."""
    values: Array
    blocks: NDArray[np.int64]
    """Number of the block of each run; empty where runs are in none."""
    trend: Trend
    centre: float
    scale: float
    """Mean and standard deviation that standardise the values and the hyperparameters below."""
    weights: Array
    """(k,), their sum is 1."""
    lengths: Array
    """(k, d)."""
    signals: Array
    noises: Array
    block_effects: Array
    """(k,) standard deviations."""
    _whitening: Array = field(init=False)
    """(k, n, n): inverse Cholesky factors of the covariance of the runs."""
    _solved: Array = field(init=False)
    """(k, n): inverse covariance times standardised values."""

    def __post_init__(self) -> None:
        columns = _trend(self.points, self.trend)
        smooth = _matern(_squares(self.points, self.points), self.lengths)
        whole = self.signals[:, None, None] ** 2 * smooth + columns @ columns.T
        whole = whole + self.noises[:, None, None] ** 2 * np.eye(len(columns))
        if len(self.blocks):
            same = self.blocks[:, None] == self.blocks
            whole = whole + self.block_effects[:, None, None] ** 2 * same
        self._whitening = np.linalg.inv(np.linalg.cholesky(whole))
        white = self._whitening @ ((self.values - self.centre) / self.scale)
        self._solved = np.einsum("kij,ki->kj", self._whitening, white)

    @property
    def noise_sd(self) -> float:
        """Standard deviation of a single run about the expected response of its block."""
        return self.scale * float(np.sqrt(self.weights @ self.noises**2))

    @property
    def block_sd(self) -> float:
        """Standard deviation of the effect of a block; 0 where runs are in none."""
        return self.scale * float(np.sqrt(self.weights @ self.block_effects**2))

    @one_blas_thread()
    def predict(self, points: ArrayLike) -> tuple[Array, Array]:
        """Return the expected response at (m, d) points and its standard error, of a new block on average.

        Neither contains the noise of a run nor the effect of the new block: see `noise_sd` and `block_sd`.
        """
        at = np.asarray(points, float).reshape(-1, self.points.shape[1])
        chunks = [self._moments(at[start : start + CHUNK]) for start in range(0, len(at), CHUNK)]
        if not chunks:
            return np.empty(0), np.empty(0)
        mean, sd = np.hstack([np.vstack(chunk) for chunk in chunks])
        return mean, sd

    @one_blas_thread()
    def believing(self, points: ArrayLike) -> GaussianProcess:
        """Return the process after runs at (m, d) points that came out as predicted, each in a block of its own.

        Hyperparameters stay.
        """
        more = np.asarray(points, float).reshape(-1, self.points.shape[1])
        blocks = self.blocks
        if len(blocks):
            blocks = np.hstack([blocks, blocks.max() + 1 + np.arange(len(more))])
        values = np.hstack([self.values, self.predict(more)[0]])
        return replace(self, points=np.vstack([self.points, more]), values=values, blocks=blocks)

    def _moments(self, at: Array) -> tuple[Array, Array]:
        trend, own = _trend(at, self.trend), _trend(self.points, self.trend)
        smooth = _matern(_squares(at, self.points), self.lengths)
        across = self.signals[:, None, None] ** 2 * smooth + trend @ own.T
        means = np.einsum("kmn,kn->km", across, self._solved)
        explained = ((across @ self._whitening.swapaxes(1, 2)) ** 2).sum(axis=2)
        prior = self.signals[:, None] ** 2 + (trend**2).sum(axis=1)
        mean = self.weights @ means
        variance = self.weights @ (np.maximum(prior - explained, 0.0) + (means - mean) ** 2)
        return self.centre + self.scale * mean, self.scale * np.sqrt(variance)


@one_blas_thread()
def fit_process(
    points: ArrayLike,
    values: ArrayLike,
    noise_floor: float = 0.0,
    *,
    blocks: Sequence[object] | None = None,
    trend: Trend = "linear",
) -> GaussianProcess:
    """Fit a process to one value at each of (n, d) points.

    noise_floor : least standard deviation of a run, in the unit of the values
    blocks : of each run the machine, tool or day that it shares with others

    Raises ValueError below three runs, where a point or value is not finite, or where points, values and blocks are
    not as many.
    """
    at = np.asarray(points, float)
    measured = np.asarray(values, float)
    if at.ndim != 2 or measured.shape != at.shape[:1] or (blocks is not None and len(blocks) != len(at)):
        raise ValueError("Points are (runs, factors), with one value and at most one block a run.")
    if len(at) < FEWEST_RUNS:
        raise ValueError(f"A process needs at least {FEWEST_RUNS} runs, not {len(at)}.")
    if not (np.isfinite(at).all() and np.isfinite(measured).all()):
        raise ValueError("A process needs finite points and values: take runs out that failed.")
    names = list(dict.fromkeys(blocks or ()))
    numbers = np.array([names.index(one) for one in blocks or ()], np.int64)
    centre, spread = float(measured.mean()), float(measured.std(ddof=1))
    least = 1e-9 * max(1.0, abs(centre))  # values that are all equal are expected everywhere
    scale = spread if spread > least else max(noise_floor, least)
    posterior = _Posterior.of(at, (measured - centre) / scale, numbers, trend, noise_floor / scale)
    draws, weights = _draws(posterior)
    factors = at.shape[1]
    return GaussianProcess(
        points=at,
        values=measured,
        blocks=numbers,
        trend=trend,
        centre=centre,
        scale=scale,
        weights=weights,
        lengths=np.exp(draws[:, :factors]),
        signals=np.exp(draws[:, factors]),
        noises=np.sqrt(np.exp(2 * draws[:, factors + 1]) + posterior.least_noise**2),
        block_effects=np.exp(draws[:, factors + 2]) if len(numbers) else np.zeros(len(draws)),
    )


@dataclass(frozen=True, slots=True)
class _Posterior:
    """Density of the logarithms of length scales, signal, noise and, with blocks, the effect of a block."""

    squares: Array
    """(d, n, n) squared distances by factor."""
    of_trend: Array
    """(n, n) covariance."""
    same_block: Array | None
    values: Array
    least_noise: float
    centres: Array
    spreads: Array
    """Of the priors."""

    @classmethod
    def of(
        cls, points: Array, values: Array, blocks: NDArray[np.int64], trend: Trend, noise_floor: float
    ) -> _Posterior:
        """Return the posterior density given standardised values."""
        factors, columns = points.shape[1], _trend(points, trend)
        medians = [MEDIAN_LENGTH * np.sqrt(factors)] * factors + [MEDIAN_SIGNAL, MEDIAN_NOISE, MEDIAN_BLOCK]
        spreads = [SPREAD_OF_LENGTH] * factors + [SPREAD_OF_SIGNAL, SPREAD_OF_NOISE, SPREAD_OF_BLOCK]
        size = factors + (3 if len(blocks) else 2)
        return cls(
            _squares(points, points),
            columns @ columns.T,
            (blocks[:, None] == blocks).astype(float) if len(blocks) else None,
            values,
            max(noise_floor, SMALLEST_NOISE),
            np.log(medians[:size]),
            np.array(spreads[:size]),
        )

    def covariance(self, logs: Array) -> tuple[Array, Array]:
        """Return the covariance (n, n) of the runs, and its derivatives by the logarithms (parameters, n, n)."""
        factors, same = len(self.squares), np.eye(len(self.values))
        inverse = np.exp(-2 * logs[:factors])
        signal, noise = np.exp(2 * logs[factors]), np.exp(2 * logs[factors + 1])
        distance = np.sqrt(5 * np.tensordot(inverse, self.squares, 1))
        decay = signal * np.exp(-distance)
        smooth = decay * (1 + distance + distance**2 / 3)
        by_length = (5 / 3 * decay * (1 + distance)) * (inverse[:, None, None] * self.squares)
        parts = [by_length, 2 * smooth[None], 2 * noise * same[None]]
        whole = smooth + self.of_trend + (noise + self.least_noise**2) * same
        if self.same_block is not None:
            block = np.exp(2 * logs[factors + 2]) * self.same_block
            whole = whole + block
            parts.append(2 * block[None])
        return whole, np.concatenate(parts)

    def loss(self, logs: Array) -> tuple[float, Array]:
        """Return the negative logarithm of the density, without constants, and its gradient."""
        whole, by_parameter = self.covariance(logs)
        factor = linalg.cholesky(whole, lower=True, check_finite=False)
        inverse = linalg.cho_solve((factor, True), np.eye(len(factor)), check_finite=False)
        solved = inverse @ self.values
        off = (logs - self.centres) / self.spreads
        loss = self.values @ solved / 2 + np.log(np.diag(factor)).sum() + off @ off / 2
        gradient = np.tensordot(by_parameter, inverse - np.outer(solved, solved), 2) / 2 + off / self.spreads
        return float(loss), gradient

    def information(self, logs: Array) -> Array:
        """Return the expected information (parameters, parameters) of runs and priors."""
        whole, by_parameter = self.covariance(logs)
        solved = np.linalg.solve(whole, by_parameter)
        return np.asarray(np.einsum("iab,jba->ij", solved, solved) / 2 + np.diag(self.spreads**-2))


def _draws(posterior: _Posterior) -> tuple[Array, Array]:
    """Return draws (k, parameters) about the best maximum, and their weights."""
    factors, size = len(posterior.squares), len(posterior.centres)
    best = None
    for length, signal, noise in STARTS:
        off = np.array([length] * factors + [signal, noise, 0.0][: size - factors])
        start = posterior.centres + off * posterior.spreads
        bounds = list(zip(posterior.centres - 8.0, posterior.centres + 8.0, strict=True))
        found = optimize.minimize(posterior.loss, start, jac=True, method="L-BFGS-B", bounds=bounds)
        if best is None or found.fun < best.fun - 1e-9:
            best = found
    assert best is not None
    root = np.linalg.cholesky(np.linalg.inv(posterior.information(best.x)))
    normal = _normal_sequence(DRAWS // 2, size)
    normal = WIDER * np.vstack([normal, -normal])
    draws = best.x + normal @ root.T
    surplus = np.array([-posterior.loss(one)[0] for one in draws]) + (normal**2).sum(axis=1) / 2 / WIDER**2
    importance = np.exp(surplus - surplus.max())
    weights = np.minimum(importance, importance.mean() * np.sqrt(len(importance)))
    return draws, weights / weights.sum()


def _normal_sequence(length: int, factors: int) -> Array:
    """Return (length, factors) standard normal values of an additive recurrence (Roberts, 2018)."""
    ratio = 2.0
    for _ in range(60):
        ratio = (1 + ratio) ** (1 / (factors + 1))
    steps = ratio ** -np.arange(1.0, factors + 1)
    return np.asarray(special.ndtri((0.5 + np.arange(1, length + 1)[:, None] * steps) % 1))


def _trend(points: Array, trend: Trend) -> Array:
    """Return columns of the trend (n, terms), each scaled by the prior standard deviation of its coefficient."""
    mean = np.full((len(points), 1), SD_OF_MEAN)
    return np.hstack([mean, SD_OF_SLOPE * (points - 0.5)]) if trend == "linear" else mean


def _squares(a: Array, b: Array) -> Array:
    """Return squared distances by factor: (d, a, b)."""
    return np.asarray((a.T[:, :, None] - b.T[:, None, :]) ** 2)


def _matern(squares: Array, lengths: Array) -> Array:
    """Return Matérn 5/2 correlations (k, a, b) of squared distances (d, a, b), with length scales (k, d)."""
    distance = np.sqrt(5 * np.tensordot(lengths**-2.0, squares, 1))
    return np.asarray((1 + distance + distance**2 / 3) * np.exp(-distance))


BOUND = 1.645
"""Standard errors from what is expected of a constraint to its upper 95 % bound."""
CONFIRMING = 2 / 3
"""Share of the budget after which runs go where they are expected to lower what can be recommended."""
TRIED = 16
"""Candidates whose gain is computed."""
FAILURE_NOISE = 0.1
MOST_FAILING = 0.5
"""Upper bound of the probability of failure of what is recommended."""


@dataclass(frozen=True, slots=True)
class Outlook:
    """Predictions of m candidates under c constraints, each with its standard error."""

    objective: Array
    """(m,) expected."""
    objective_sd: Array
    constraints: Array
    """(c, m) expected."""
    constraints_sd: Array
    limits: Array
    """(c,)."""

    @property
    def feasibility(self) -> Array:
        """Probability (m,) that every expected constraint is within its limit."""
        margin = self.limits[:, None] - self.constraints
        return np.asarray(special.ndtr(margin / np.maximum(self.constraints_sd, 1e-300)).prod(axis=0))

    @property
    def violation(self) -> Array:
        """Standard errors (m,) by which the worst upper bound is beyond its limit; 0 where all are within."""
        over = (self.constraints - self.limits[:, None]) / np.maximum(self.constraints_sd, 1e-300) + BOUND
        return np.asarray(np.maximum(over, 0.0).max(axis=0, initial=0.0))

    @property
    def best(self) -> int | None:
        """The candidate with the least expected objective whose upper bounds are all within; None without any."""
        safe = self.violation <= 0
        return int(np.argmin(np.where(safe, self.objective, np.inf))) if safe.any() else None

    @property
    def nearest(self) -> int:
        """The best candidate, or without one the candidate that comes nearest to keeping the constraints."""
        best = self.best
        return int(np.argmin(self.violation)) if best is None else best


@dataclass(frozen=True, slots=True)
class Surrogates:
    """Processes of an objective, of constraints and, where runs failed, of failure, which is the last constraint."""

    objective: GaussianProcess
    constraints: tuple[GaussianProcess, ...]
    limits: tuple[float, ...]
    runs: int
    """That were made, failed ones among them, or are assumed."""

    @classmethod
    def fit(
        cls,
        points: ArrayLike,
        objective: ArrayLike,
        constraints: Constraints,
        blocks: Sequence[object] | None = None,
    ) -> Surrogates:
        """Fit processes to runs at (n, d) points, whose objective or constraints are NaN where the run failed.

        Raises ValueError where fewer than three runs have a response, or responses are not one a run.
        """
        at = np.asarray(points, float)
        responses = [
            np.asarray(values, float) for values in (objective, *(values for values, _ in constraints))
        ]
        if any(values.shape != at.shape[:1] for values in responses):
            raise ValueError("Objective and constraints have one value a run.")
        processes, limits = [], [float(limit) for _, limit in constraints]
        for values in responses:
            kept = np.flatnonzero(np.isfinite(values)).tolist()
            own = None if blocks is None else [blocks[run] for run in kept]
            processes.append(fit_process(at[kept], values[kept], blocks=own))
        failed = ~np.isfinite(responses).all(axis=0)
        if failed.any():
            processes.append(fit_process(at, failed.astype(float), FAILURE_NOISE, trend="constant"))
            limits.append(MOST_FAILING)
        return cls(processes[0], tuple(processes[1:]), tuple(limits), len(at))

    def outlook(self, candidates: ArrayLike) -> Outlook:
        """Return what is predicted of (m, d) candidates."""
        at = np.asarray(candidates, float)
        mean, sd = self.objective.predict(at)
        each = [process.predict(at) for process in self.constraints]
        means, errors = (
            np.array([one[n] for one in each]).reshape(len(each), len(at)) for n in (0, 1)
        )  # without constraints (0, m)
        return Outlook(mean, sd, means, errors, np.array(self.limits, float))

    def believing(self, point: ArrayLike) -> Surrogates:
        """Return the processes after a run at `point` that came out as predicted."""
        constraints = tuple(process.believing(point) for process in self.constraints)
        return Surrogates(self.objective.believing(point), constraints, self.limits, self.runs + 1)

    def suggest(
        self, candidates: ArrayLike, runs: int = 1, pending: ArrayLike = (), budget: int | None = None
    ) -> list[tuple[int, Purpose]]:
        """Return the next `runs` of (m, d) candidates, one of them perhaps again, and the purpose of each.

        pending : (k, d) runs whose values are still to come
        budget : number of runs in all; the last third of them confirm
        """
        fitted, allowed = self, np.asarray(candidates, float)
        for point in np.asarray(pending, float):
            fitted = fitted.believing(point)
        found = []
        for _ in range(runs):
            confirms = budget is not None and fitted.runs >= CONFIRMING * budget
            found.append(fitted._next(allowed, confirms))
            fitted = fitted.believing(allowed[found[-1][0]])
        return found

    def _next(self, candidates: Array, confirms: bool) -> tuple[int, Purpose]:
        outlook = self.outlook(candidates)
        best = outlook.best
        if best is None:
            return int(np.argmax(outlook.feasibility)), "feasibility"
        incumbent = float(outlook.objective[best])
        gain = expected_improvement(outlook.objective, outlook.objective_sd, incumbent) * outlook.feasibility
        if not confirms:
            return int(np.argmax(gain)), "improvement"
        within = (outlook.constraints <= outlook.limits[:, None]).all(axis=0)
        aims = np.flatnonzero((outlook.objective < incumbent) & within)
        if not len(aims):
            return best, "confirmation"
        tried = [best, *aims[np.argsort(-gain[aims], kind="stable")[:TRIED]].tolist()]
        reached = []
        for one in tried:
            after = self.believing(candidates[one]).outlook(candidates[aims])
            reached.append(incumbent if after.best is None else min(incumbent, after.objective[after.best]))
        if min(reached) >= incumbent:
            return int(np.argmax(gain)), "confirmation"
        return tried[int(np.argmin(reached))], "confirmation"


def expected_improvement(mean: Array, sd: Array, incumbent: float) -> Array:
    """Return how far values of a mean and a standard deviation are expected to fall below the incumbent (Močkus)."""
    sd = np.maximum(sd, 1e-300)
    off = (incumbent - mean) / sd
    density = np.exp(-(np.clip(off, -40, 40) ** 2) / 2) / np.sqrt(2 * np.pi)
    return np.asarray(np.maximum(sd * (off * special.ndtr(off) + density), 0.0))
