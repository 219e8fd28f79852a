"""Few runs find a fast setting that keeps its limit, on problems like those of an erosion process."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy.stats import qmc

from edmctl.study.statistics.suggestion import expected_improvement, recommend, suggest, surrogates
from tests.tiers import tiers

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Values = NDArray[np.float64]

LIMIT = float(np.log(0.05))


@dataclass
class Erosion:
    """Time falls with reference down, duty up and longer pulses; arcs rise like an exponential, up to all of them.

    Factors are coded so that each speeds up. Time and share of arcs are logarithms; where `fails`, there are no
    responses with more than half of the pulses arcs.
    """

    seed: int
    fails: bool = False
    rng: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        self.fall, self.curve = self.rng.uniform(0.3, 1.4, 3), self.rng.uniform(0, 0.2, 3)
        load = self.rng.uniform(0.4, 1, 3)
        self.load, self.mix, self.square = (
            load / load.sum(),
            self.rng.uniform(-0.7, 0.7),
            self.rng.uniform(-0.2, 0.2, 3),
        )
        self.steep, self.onset = self.rng.uniform(7, 13), self.rng.uniform(0.4, 0.6)
        self.noise = self.rng.uniform(0.1, 0.2)

    def arcs(self, x: Values) -> Values:
        """Logarithm of the expected share of arcs."""
        load = x @ self.load + self.mix * (x[:, 0] - 0.5) * (x[:, 1] - 0.5) + (x - 0.5) ** 2 @ self.square
        rise = self.steep * (load - self.onset) + np.log(0.04 / 0.95)
        made: Values = np.log(0.01 + 0.99 / (1 + np.exp(-rise)))
        return made

    def time(self, x: Values) -> Values:
        """Logarithm of the expected time."""
        made: Values = 3 - x @ self.fall + x**2 @ self.curve + 0.2 * x[:, 0] * x[:, 2]
        return made

    def run(self, x: Values) -> tuple[Values, Values]:
        """Return noisy logarithms of time and share of arcs."""
        lost = (self.arcs(x) > np.log(0.5)) & self.fails
        time = self.time(x) + self.rng.normal(0, 0.04, len(x))
        arcs = self.arcs(x) + self.rng.normal(0, self.noise, len(x))
        return np.where(lost, np.nan, time), np.where(lost, np.nan, arcs)


def candidates(count: int) -> Values:
    return np.asarray(qmc.Sobol(3, scramble=True, rng=np.random.default_rng(5)).random(count))


def study(problem: Erosion, repeat: int, allowed: Values, budget: int = 24) -> tuple[bool, float, str]:
    """Return whether what is recommended breaks the limit, its regret and what the runs were for."""
    problem.rng = np.random.default_rng([problem.seed, repeat])
    points = np.asarray(qmc.LatinHypercube(3, optimization="random-cd", rng=problem.rng).random(10))
    time, arcs = problem.run(points)
    purposes = ""
    while len(points) < budget:
        (one,) = suggest(points, time, [(arcs, LIMIT)], allowed, budget=budget)
        more = allowed[[one.candidate]]
        new_time, new_arcs = problem.run(more)
        points, time, arcs = np.vstack([points, more]), np.append(time, new_time), np.append(arcs, new_arcs)
        purposes += one.purpose[0]
    found = recommend(points, time, [(arcs, LIMIT)], allowed)
    true_time, true_arcs = problem.time(allowed), problem.arcs(allowed)
    at = found.least_violating
    regret = np.exp(true_time[at] - true_time[true_arcs <= LIMIT].min()) - 1
    return bool(true_arcs[at] > LIMIT), float(regret), purposes


def test_a_study_ends_at_a_fast_setting_that_keeps_the_limit() -> None:
    broken, regret, purposes = study(Erosion(1, fails=True), 0, candidates(256), budget=18)
    assert not broken
    assert regret < 0.15
    assert purposes.lstrip("f") == "i" * (len(purposes.lstrip("f")) - 6) + "c" * 6


@pytest.mark.parametrize("seed", tiers(slow=[2], full=[3]))
def test_what_is_recommended_is_safe_and_fast(seed: int) -> None:
    allowed, problem = candidates(256), Erosion(seed, fails=seed % 2 == 1)
    made = [study(problem, repeat, allowed) for repeat in range(8)]
    broken, regret = sum(one[0] for one in made), float(np.median([one[1] for one in made if not one[0]]))
    print(f"problem {seed}: {broken} of 8 break the limit, median regret {regret:.3f}")
    assert broken <= 1
    assert regret <= 0.1


def start(problem: Erosion, count: int = 12) -> tuple[Values, Values, Values]:
    points = np.asarray(qmc.LatinHypercube(3, rng=np.random.default_rng(problem.seed)).random(count))
    return points, *problem.run(points)


def test_runs_of_a_batch_are_spread_and_the_same_again() -> None:
    points, time, arcs = start(Erosion(4))
    allowed = candidates(128)
    batch = suggest(points, time, [(arcs, LIMIT)], allowed, runs=4)
    assert len({one.candidate for one in batch}) >= 2
    assert batch == suggest(points, time, [(arcs, LIMIT)], allowed, runs=4)
    assert batch[0] == suggest(points, time, [(arcs, LIMIT)], allowed)[0]


def test_nothing_feasible_is_said_and_sought() -> None:
    points, time, arcs = start(Erosion(5))
    allowed = candidates(128)
    limit = float(arcs.min()) - 5
    found = recommend(points, time, [(arcs, limit)], allowed)
    assert found.candidate is None
    assert found.upper_bounds[0] > limit
    assert found.constraints[0] < np.median(arcs)
    (one,) = suggest(points, time, [(arcs, limit)], allowed)
    assert one.purpose == "feasibility"
    outlook = surrogates(points, time, [(arcs, limit)]).outlook(allowed)
    assert one.feasibility == outlook.feasibility.max()


def test_what_is_recommended_keeps_every_upper_bound() -> None:
    points, time, arcs = start(Erosion(6), 20)
    wear = points[:, 2] + np.random.default_rng(0).normal(0, 0.02, 20)
    allowed = candidates(128)
    both = recommend(points, time, [(arcs, LIMIT), (wear, 0.3)], allowed)
    alone = recommend(points, time, [(arcs, LIMIT)], allowed)
    assert both.candidate == both.least_violating
    assert both.upper_bounds[0] <= LIMIT
    assert both.upper_bounds[1] <= 0.3
    assert allowed[both.least_violating, 2] < 0.3
    assert both.objective >= alone.objective - 0.1


def test_without_constraints_the_least_is_found() -> None:
    points = np.random.default_rng(1).uniform(0, 1, (16, 2))
    values = ((points - 0.6) ** 2).sum(axis=1)
    grid = np.stack(np.meshgrid(*[np.linspace(0, 1, 11)] * 2), -1).reshape(-1, 2)
    found = recommend(points, values, [], grid)
    assert np.abs(grid[found.least_violating] - 0.6).max() < 0.11
    assert suggest(points, values, [], grid)[0].feasibility == 1


def test_where_runs_fail_none_is_recommended() -> None:
    points = np.random.default_rng(2).uniform(0, 1, (24, 2))
    values = np.where(points[:, 0] > 0.7, np.nan, -points[:, 0])
    grid = np.stack(np.meshgrid(*[np.linspace(0, 1, 11)] * 2), -1).reshape(-1, 2)
    fitted = surrogates(points, values, [])
    feasibility = fitted.outlook(grid).feasibility
    assert feasibility[grid[:, 0] > 0.85].max() < 0.3
    assert feasibility[grid[:, 0] < 0.4].min() > 0.7
    assert grid[recommend(points, values, [], grid).least_violating, 0] < 0.75


def test_expected_improvement_in_closed_form() -> None:
    draws = np.random.default_rng(3).normal(1.0, 0.5, 400_000)
    wanted = np.maximum(0.8 - draws, 0).mean()
    assert expected_improvement(np.array([1.0, 0.0]), np.array([0.5, 0.0]), 0.8) == pytest.approx(
        [wanted, 0.8], rel=0.02
    )


def test_what_cannot_be_is_refused() -> None:
    points, time, arcs = start(Erosion(7))
    with pytest.raises(ValueError, match="one value a run"):
        suggest(points, time, [(arcs[:4], LIMIT)], candidates(8))
    with pytest.raises(ValueError, match="at least 3 runs"):
        suggest(points, np.full(12, np.nan), [(arcs, LIMIT)], candidates(8))
