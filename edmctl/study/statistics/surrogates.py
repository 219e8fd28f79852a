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

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg, optimize, special

from edmctl.array_types import Array
from edmctl.dataclasses import dataclass, field, replace
from edmctl.start_up import one_blas_thread

FEWEST_RUNS = 3
MEDIAN_LENGTH = 0.3
"""Of one factor's length scale, in its range."""
MEDIAN_SIGNAL, MEDIAN_NOISE, MEDIAN_BLOCK = 1.0, float(np.exp(-2)), float(np.exp(-2))
"""Standard deviations of the smooth deviation, of noise and of block effects. All logarithms have a spread of 1."""
SD_OF_MEAN, SD_OF_SLOPE = 10.0, 5.0
"""Of the trend's coefficients, where factors go from −½ to ½."""
SMALLEST_NOISE = 1e-3
DRAWS = 48
WIDER = 1.3
"""Standard deviation of the draws to that of the normal approximation at the maximum."""
STARTS = ((0.0, 0.0, 0.0), (-1.0, 0.5, -0.5), (1.0, -0.5, 1.5))
"""Of length scales, signal and noise, from the medians of their priors."""


@dataclass(slots=True)
class Prior:
    """Covariances of n runs, by the logarithms of d length scales, of signal, noise and, with blocks, block effect.

    points : (n, d)
    blocks : number of the block of each run; None if runs are in none
    least_noise : in the unit of standardised values
    """

    points: Array
    blocks: NDArray[np.int64] | None
    least_noise: float

    def covariance(self, logs: Array) -> Array:
        """Return the covariances (k, n, n) of the runs with logarithms (k, parameters)."""
        return np.asarray(self._parts(logs).sum(axis=0) + self._known())

    def _known(self) -> Array:
        """Return the covariance (n, n) of trend and least noise."""
        trend = self.trend(self.points)
        return trend @ trend.T + self.least_noise**2 * np.eye(len(trend))

    def _parts(self, logs: Array) -> Array:
        """Return the covariances (parts, k, n, n) of smooth deviation, noise and block effects."""
        factors = self.points.shape[1]
        parts = [self.smooth(self.points, logs)]
        parts.append(np.exp(2 * logs[:, factors + 1])[:, None, None] * np.eye(len(self.points)))
        if self.blocks is not None:
            same_block = self.blocks[:, None] == self.blocks
            parts.append(np.exp(2 * logs[:, factors + 2])[:, None, None] * same_block)
        return np.array(parts)

    def smooth(self, at: Array, logs: Array) -> Array:
        """Return the covariances (k, m, n) of the smooth deviation between (m, d) points and the runs."""
        distance = self._distance(at, logs)
        matern = (1 + distance + distance**2 / 3) * np.exp(-distance)
        return np.asarray(np.exp(2 * logs[:, self.points.shape[1]])[:, None, None] * matern)

    def _squares(self, at: Array) -> Array:
        """Return squared distances by factor: (d, m, n)."""
        return np.asarray((at.T[:, :, None] - self.points.T[:, None, :]) ** 2)

    def _distance(self, at: Array, logs: Array) -> Array:
        """Return root 5 times the distances in length scales: (k, m, n)."""
        inverse = np.exp(-2 * logs[:, : at.shape[1]])
        return np.asarray(np.sqrt(5 * np.tensordot(inverse, self._squares(at), 1)))

    def derivatives(self, logs: Array) -> tuple[Array, Array]:
        """Return the covariance (n, n), and its derivatives by the logarithms (parameters, n, n)."""
        factors = self.points.shape[1]
        parts = self._parts(logs[None])[:, 0]
        distance = self._distance(self.points, logs[None])[0]
        slope = 5 / 3 * np.exp(2 * logs[factors]) * (1 + distance) * np.exp(-distance)
        by_length = slope * np.exp(-2 * logs[:factors])[:, None, None] * self._squares(self.points)
        return parts.sum(axis=0) + self._known(), np.concatenate([by_length, 2 * parts])

    def trend(self, points: Array) -> Array:
        """Return columns of the trend (n, terms), each scaled by the prior standard deviation of its coefficient."""
        return np.hstack([np.full((len(points), 1), SD_OF_MEAN), SD_OF_SLOPE * (points - 0.5)])

    @property
    def medians(self) -> Array:
        """Medians of the logarithms (parameters,)."""
        factors = self.points.shape[1]
        medians = [MEDIAN_LENGTH * factors**0.5] * factors + [MEDIAN_SIGNAL, MEDIAN_NOISE]
        return np.log(medians + ([] if self.blocks is None else [MEDIAN_BLOCK]))

    def loss(self, logs: Array, values: Array) -> tuple[float, Array]:
        """Return the negative logarithm of the posterior density of `logs`, without constants, and its gradient."""
        whole, by_parameter = self.derivatives(logs)
        factor = linalg.cholesky(whole, lower=True, check_finite=False)
        inverse = linalg.cho_solve((factor, True), np.eye(len(factor)), check_finite=False)
        solved = inverse @ values
        off = logs - self.medians
        loss = values @ solved / 2 + np.log(np.diag(factor)).sum() + off @ off / 2
        gradient = np.tensordot(by_parameter, inverse - np.outer(solved, solved), 2) / 2 + off
        return float(loss), gradient

    def draws(self, values: Array) -> tuple[Array, Array]:
        """Return draws (k, parameters) of the posterior about its best maximum, and their weights."""
        medians = self.medians
        factors, size = self.points.shape[1], len(medians)
        found = []
        for length, signal, noise in STARTS:
            start = medians + np.array([length] * factors + [signal, noise, 0.0][: size - factors])
            bounds = optimize.Bounds(medians - 8.0, medians + 8.0)
            found.append(
                optimize.minimize(self.loss, start, (values,), jac=True, method="L-BFGS-B", bounds=bounds)
            )
        best = found[0]
        for other in found[1:]:
            best = other if other.fun < best.fun - 1e-9 else best
        whole, by_parameter = self.derivatives(best.x)
        solved = np.linalg.solve(whole, by_parameter)
        information = np.einsum("iab,jba->ij", solved, solved) / 2 + np.eye(size)
        normal = _normal_sequence(DRAWS // 2, size)
        normal = WIDER * np.vstack([normal, -normal])
        draws = best.x + normal @ np.linalg.cholesky(np.linalg.inv(information)).T
        surplus = (normal**2).sum(axis=1) / 2 / WIDER**2 - [self.loss(one, values)[0] for one in draws]
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


@dataclass(slots=True)
class GaussianProcess:
    """A process fitted by `fit_process`, over k draws of hyperparameters and n runs.

    centre, scale : mean and standard deviation that standardise the values
    logs : (k, parameters) draws of the logarithms of hyperparameters; weights : (k,), their sum is 1
    """

    prior: Prior
    values: Array
    centre: float
    scale: float
    logs: Array
    weights: Array
    _whitening: Array = field(init=False)
    """(k, n, n): inverse Cholesky factors of the covariance of the runs."""
    _solved: Array = field(init=False)
    """(k, n): inverse covariance times standardised values."""

    def __post_init__(self) -> None:
        self._whitening = np.linalg.inv(np.linalg.cholesky(self.prior.covariance(self.logs)))
        white = self._whitening @ ((self.values - self.centre) / self.scale)
        self._solved = np.einsum("kij,ki->kj", self._whitening, white)

    @property
    def noise_sd(self) -> float:
        """Standard deviation of a single run about the expected response of its block."""
        factors = self.prior.points.shape[1]
        variance = self.weights @ np.exp(2 * self.logs[:, factors + 1]) + self.prior.least_noise**2
        return self.scale * float(np.sqrt(variance))

    @property
    def block_sd(self) -> float:
        """Standard deviation of the effect of a block; 0 where runs are in none."""
        if self.prior.blocks is None:
            return 0.0
        return self.scale * float(np.sqrt(self.weights @ np.exp(2 * self.logs[:, -1])))

    @one_blas_thread()
    def predict(self, points: ArrayLike) -> tuple[Array, Array]:
        """Return the expected response at (m, d) points and its standard error, of a new block on average.

        Neither contains the noise of a run nor the effect of the new block: see `noise_sd` and `block_sd`.
        """
        at = np.asarray(points, float).reshape(-1, self.prior.points.shape[1])
        trend = self.prior.trend(at)
        across = self.prior.smooth(at, self.logs) + trend @ self.prior.trend(self.prior.points).T
        means = np.einsum("kmn,kn->km", across, self._solved)
        explained = ((across @ self._whitening.swapaxes(1, 2)) ** 2).sum(axis=2)
        signal = np.exp(2 * self.logs[:, at.shape[1]])
        variance = signal[:, None] + (trend**2).sum(axis=1) - explained
        mean = self.weights @ means
        variance = self.weights @ (np.maximum(variance, 0.0) + (means - mean) ** 2)
        return self.centre + self.scale * mean, self.scale * np.sqrt(variance)

    @one_blas_thread()
    def believing(self, points: ArrayLike) -> GaussianProcess:
        """Return the process after runs at (m, d) points that came out as predicted, each in a block of its own.

        Hyperparameters stay.
        """
        more = np.asarray(points, float).reshape(-1, self.prior.points.shape[1])
        blocks = self.prior.blocks
        if blocks is not None:
            blocks = np.hstack([blocks, blocks.max() + 1 + np.arange(len(more))])
        prior = replace(self.prior, points=np.vstack([self.prior.points, more]), blocks=blocks)
        return replace(self, prior=prior, values=np.hstack([self.values, self.predict(more)[0]]))


@one_blas_thread()
def fit_process(
    points: ArrayLike,
    values: ArrayLike,
    noise_floor: float = 0.0,
    *,
    blocks: Sequence[object] | None = None,
) -> GaussianProcess:
    """Fit a process to one value at each of (n, d) points.

    noise_floor : least standard deviation of a run, in the unit of the values
    blocks : of each run the machine, tool or day that it shares with others

    Raises ValueError below three runs, or where a point or value is not finite.
    """
    at, measured = np.asarray(points, float), np.asarray(values, float)
    if len(at) < FEWEST_RUNS:
        raise ValueError(f"A process needs at least {FEWEST_RUNS} runs, not {len(at)}.")
    if not (np.isfinite(at).all() and np.isfinite(measured).all()):
        raise ValueError("A process needs finite points and values: take runs out that failed.")
    numbers = np.unique(list(map(str, blocks)), return_inverse=True)[1] if blocks else None
    centre, spread = float(measured.mean()), float(measured.std(ddof=1))
    least = 1e-9 * max(1.0, abs(centre))  # values that are all equal are expected everywhere
    scale = spread if spread > least else max(noise_floor, least)
    prior = Prior(at, numbers, max(noise_floor / scale, SMALLEST_NOISE))
    return GaussianProcess(prior, measured, centre, scale, *prior.draws((measured - centre) / scale))


BOUND = 1.645
"""Standard errors from what is expected of a constraint to its upper 95 % bound."""
FAILURE_NOISE = 0.1
MOST_FAILING = 0.5
"""Upper bound of the probability of failure of what is recommended."""


@dataclass(frozen=True, slots=True)
class Outlook:
    """Predictions of m candidates under c constraints, each with its standard error.

    objective, objective_sd : (m,); constraints, constraints_sd : (c, m); limits : (c,)
    """

    objective: Array
    objective_sd: Array
    constraints: Array
    constraints_sd: Array
    limits: Array

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
        is_safe = self.violation <= 0
        return int(np.argmin(np.where(is_safe, self.objective, np.inf))) if is_safe.any() else None

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

    @classmethod
    def fit(
        cls,
        points: ArrayLike,
        objective: ArrayLike,
        constraints: Sequence[tuple[ArrayLike, float]],
        blocks: Sequence[object] | None = None,
    ) -> Surrogates:
        """Fit processes to runs at (n, d) points, whose objective or constraints are NaN where the run failed.

        constraints : values of each, and the limit that their expectation may not exceed

        Raises ValueError where fewer than three runs have a response.
        """
        at = np.asarray(points, float)
        responses = np.array([objective, *(values for values, _ in constraints)], float)
        processes, limits = [], [float(limit) for _, limit in constraints]
        for values in responses:
            kept = np.flatnonzero(np.isfinite(values)).tolist()
            of_kept = None if blocks is None else [blocks[run] for run in kept]
            processes.append(fit_process(at[kept], values[kept], blocks=of_kept))
        failed = ~np.isfinite(responses).all(axis=0)
        if failed.any():
            processes.append(fit_process(at, failed, FAILURE_NOISE))
            limits.append(MOST_FAILING)
        return cls(processes[0], tuple(processes[1:]), tuple(limits))

    def outlook(self, candidates: ArrayLike) -> Outlook:
        """Return the predictions of (m, d) candidates."""
        mean, sd = self.objective.predict(candidates)
        each = np.array([process.predict(candidates) for process in self.constraints])
        each = each.reshape(len(self.constraints), 2, len(mean))  # without constraints (0, 2, m)
        return Outlook(mean, sd, each[:, 0], each[:, 1], np.array(self.limits, float))

    def believing(self, point: ArrayLike) -> Surrogates:
        """Return the processes after a run at `point` that came out as predicted."""
        constraints = tuple(process.believing(point) for process in self.constraints)
        return Surrogates(self.objective.believing(point), constraints, self.limits)

    def suggest(self, candidates: ArrayLike, runs: int = 1, pending: ArrayLike = ()) -> list[int]:
        """Return the next `runs` of (m, d) candidates, one of them perhaps again.

        pending : (k, d) runs whose values are still to come
        """
        fitted, at = self, np.asarray(candidates, float)
        for point in np.asarray(pending, float):
            fitted = fitted.believing(point)
        found = []
        for _ in range(runs):
            outlook = fitted.outlook(at)
            value = outlook.feasibility
            if outlook.best is not None:
                incumbent = float(outlook.objective[outlook.best])
                value = value * expected_improvement(outlook.objective, outlook.objective_sd, incumbent)
            found.append(int(np.argmax(value)))
            fitted = fitted.believing(at[found[-1]])
        return found


def expected_improvement(mean: Array, sd: Array, incumbent: float) -> Array:
    """Return how far values of a mean and a standard deviation are expected to fall below the incumbent (Močkus)."""
    sd = np.maximum(sd, 1e-300)
    off = (incumbent - mean) / sd
    density = np.exp(-(np.clip(off, -40, 40) ** 2) / 2) / np.sqrt(2 * np.pi)
    return np.asarray(np.maximum(sd * (off * special.ndtr(off) + density), 0.0))
