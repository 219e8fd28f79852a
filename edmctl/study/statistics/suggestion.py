"""Where to run next, and what to recommend: the least of an objective under constraints, from few noisy runs.

Objective and constraints are Gaussian processes. Runs are suggested by expected improvement times the probability
that all constraints hold (Gardner et al., Bayesian Optimization with Inequality Constraints, ICML 2014), several at
a time by believing what is predicted (kriging believer: Ginsbourger, Le Riche and Carraro, 2010). The last third of
a known number of runs goes where one more run is expected to lower what can be recommended: to points that seem
better and allowed, but are not yet known well enough. A run that failed tells where runs fail: a process of its own
predicts that from 0 and 1 (least-squares classification, Rasmussen and Williams, 2006, section 6.5).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from edmctl.array_types import Array
from edmctl.dataclasses import dataclass, replace
from edmctl.study.statistics.gaussian_process import GaussianProcess, fit_process

Constraints = Sequence[tuple[ArrayLike, float]]

Purpose = Literal["feasibility", "improvement", "confirmation"]

BOUND = 1.645
"""Standard errors from what is expected of a constraint to its upper 95 % bound."""
CONFIRMING = 2 / 3
"""Share of the runs after which they confirm."""
TRIED = 16
"""Candidates of which the gain of running them is worked out."""
FAILURE_NOISE = 0.1
MOST_FAILING = 0.5
"""Upper bound of the probability of failure of what is recommended."""


@dataclass(frozen=True, slots=True)
class Outlook:
    """What is predicted of candidates; m is their number and c that of constraints."""

    objective: Array
    """(m,) expected."""
    objective_sd: Array
    """(m,) standard error of what is expected."""
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
        """Standard errors (m,) by which the worst upper bound is beyond its limit; none where all are within."""
        over = (self.constraints - self.limits[:, None]) / np.maximum(self.constraints_sd, 1e-300) + BOUND
        return np.asarray(np.maximum(over, 0.0).max(axis=0, initial=0.0))

    @property
    def best(self) -> int | None:
        """The candidate with the least expected objective whose upper bounds are all within; None without any."""
        safe = self.violation <= 0
        return int(np.argmin(np.where(safe, self.objective, np.inf))) if safe.any() else None


@dataclass(frozen=True, slots=True)
class Surrogates:
    """Processes of an objective, of constraints and, where runs failed, of failure, which is the last constraint."""

    objective: GaussianProcess
    constraints: tuple[GaussianProcess, ...]
    limits: tuple[float, ...]

    def outlook(self, candidates: Array) -> Outlook:
        """Return what is predicted of (m, d) candidates."""
        mean, sd = self.objective.predict(candidates)
        each = [process.predict(candidates) for process in self.constraints]
        shape = (len(self.constraints), len(candidates))
        return Outlook(
            mean,
            sd,
            np.array([one[0] for one in each]).reshape(shape),
            np.array([one[1] for one in each]).reshape(shape),
            np.array(self.limits, float),
        )

    def believing(self, point: Array) -> Surrogates:
        """Return the processes after a run at `point` that went as predicted."""
        return replace(
            self,
            objective=_believing(self.objective, point),
            constraints=tuple(_believing(process, point) for process in self.constraints),
        )


@dataclass(frozen=True, slots=True)
class Suggestion:
    """A candidate to run next."""

    candidate: int
    """Its row."""
    purpose: Purpose
    feasibility: float
    """Probability that it keeps every constraint."""


@dataclass(frozen=True, slots=True)
class Recommendation:
    """What to use in the end."""

    candidate: int | None
    """The row of the candidate; None where none is known to keep every constraint."""
    least_violating: int
    """The row of the candidate that comes nearest to keeping them; `candidate` where there is one."""
    objective: float
    """Expected of `least_violating`, as all below."""
    objective_sd: float
    constraints: tuple[float, ...]
    upper_bounds: tuple[float, ...]
    """95 % bounds of the constraints."""


def surrogates(
    points: ArrayLike,
    objective: ArrayLike,
    constraints: Constraints,
    *,
    blocks: Sequence[object] | None = None,
) -> Surrogates:
    """Fit processes to runs at (n, d) points, whose objective or constraints are NaN where the run failed.

    Raises ValueError where fewer than three runs have a response, or responses are not one a run.
    """
    at = np.asarray(points, float)
    responses = [np.asarray(values, float) for values in (objective, *(values for values, _ in constraints))]
    if any(values.shape != at.shape[:1] for values in responses):
        raise ValueError("Objective and constraints have one value a run.")
    failed = ~np.isfinite(responses).all(axis=0)
    processes, limits = [], [float(limit) for _, limit in constraints]
    for values in responses:
        kept = np.flatnonzero(np.isfinite(values)).tolist()
        own = None if blocks is None else [blocks[run] for run in kept]
        processes.append(fit_process(at[kept], values[kept], blocks=own))
    if failed.any():
        processes.append(fit_process(at, failed.astype(float), FAILURE_NOISE, trend="constant"))
        limits.append(MOST_FAILING)
    return Surrogates(processes[0], tuple(processes[1:]), tuple(limits))


def suggest(
    points: ArrayLike,
    objective: ArrayLike,
    constraints: Constraints,
    candidates: ArrayLike,
    *,
    runs: int = 1,
    pending: ArrayLike = (),
    budget: int | None = None,
    blocks: Sequence[object] | None = None,
) -> list[Suggestion]:
    """Return the next `runs` of (m, d) candidates to run; one may be run again.

    `points` (n, d) were run, coded to 0 … 1, with the objective to be minimised and of each constraint the values
    and the limit that what is expected of them may not exceed. A value is NaN where the run failed. `pending` (k, d)
    are runs whose values are to come: they are believed to come as predicted. `budget` is the
    number of runs there will be in all: the last third of them confirm. Raises ValueError as `surrogates` does.
    """
    fitted = surrogates(points, objective, constraints, blocks=blocks)
    allowed = np.asarray(candidates, float)
    for point in np.asarray(pending, float):
        fitted = fitted.believing(point)
    made, found = len(np.asarray(points)) + len(np.asarray(pending)), []
    for turn in range(runs):
        confirms = budget is not None and made + turn >= CONFIRMING * budget
        outlook = fitted.outlook(allowed)
        chosen, purpose = _next(fitted, outlook, allowed, confirms)
        found.append(Suggestion(chosen, purpose, float(outlook.feasibility[chosen])))
        fitted = fitted.believing(allowed[chosen])
    return found


def recommend(
    points: ArrayLike,
    objective: ArrayLike,
    constraints: Constraints,
    candidates: ArrayLike,
    *,
    blocks: Sequence[object] | None = None,
) -> Recommendation:
    """Return the candidate of the least expected objective whose upper 95 % bounds are all within their limits.

    Arguments and what is raised are those of `suggest`.
    """
    fitted = surrogates(points, objective, constraints, blocks=blocks)
    outlook = fitted.outlook(np.asarray(candidates, float))
    best = outlook.best
    nearest = int(np.argmin(outlook.violation)) if best is None else best
    expected, sd = outlook.constraints[:, nearest], outlook.constraints_sd[:, nearest]
    return Recommendation(
        best,
        nearest,
        float(outlook.objective[nearest]),
        float(outlook.objective_sd[nearest]),
        tuple(expected[: len(constraints)].tolist()),
        tuple((expected + BOUND * sd)[: len(constraints)].tolist()),
    )


def expected_improvement(mean: Array, sd: Array, incumbent: float) -> Array:
    """Return how far values of a mean and a standard deviation are expected to fall below the incumbent (Močkus)."""
    sd = np.maximum(sd, 1e-300)
    off = (incumbent - mean) / sd
    density = np.exp(-(np.clip(off, -40, 40) ** 2) / 2) / np.sqrt(2 * np.pi)
    return np.asarray(np.maximum(sd * (off * special.ndtr(off) + density), 0.0))


def _next(fitted: Surrogates, outlook: Outlook, candidates: Array, confirms: bool) -> tuple[int, Purpose]:
    """Return the candidate to run next, and what for."""
    best = outlook.best
    if best is None:
        return int(np.argmax(outlook.feasibility)), "feasibility"
    incumbent = float(outlook.objective[best])
    score = expected_improvement(outlook.objective, outlook.objective_sd, incumbent) * outlook.feasibility
    if not confirms:
        return int(np.argmax(score)), "improvement"
    promising = (outlook.objective < incumbent) & (outlook.constraints <= outlook.limits[:, None]).all(axis=0)
    aims = np.flatnonzero(promising)
    if not len(aims):
        return best, "confirmation"
    tried = [best, *aims[np.argsort(-score[aims], kind="stable")[:TRIED]].tolist()]
    reached = [_reached(fitted.believing(candidates[one]), candidates[aims], incumbent) for one in tried]
    if min(reached) >= incumbent:
        return int(np.argmax(score)), "confirmation"
    return tried[int(np.argmin(reached))], "confirmation"


def _reached(believed: Surrogates, aims: Array, incumbent: float) -> float:
    """Return the objective that could be recommended."""
    outlook = believed.outlook(aims)
    return incumbent if outlook.best is None else min(incumbent, float(outlook.objective[outlook.best]))


def _believing(process: GaussianProcess, point: Array) -> GaussianProcess:
    return process.with_runs(point, process.predict(point)[0])
