"""What a process predicts holds on functions it did not see, and agrees with what is known in closed form."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from edmctl.study.statistics.gaussian_process import (
    GaussianProcess,
    Trend,
    _conditioned,
    _Posterior,
    fit_process,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Values = NDArray[np.float64]


def smooth_function(rng: np.random.Generator, factors: int) -> Callable[[Values], Values]:
    """A linear part, an interaction and waves of one to several radians over the range of a factor."""
    waves = rng.normal(0, 1, (4, factors)) * rng.choice([1.5, 3, 5])
    phases, heights = rng.uniform(0, 2 * np.pi, 4), rng.normal(0, 0.5, 4)
    slopes, twist = rng.normal(0, 2, factors), rng.normal(0, 2)

    def function(x: Values) -> Values:
        made: Values = x @ slopes + twist * x[:, 0] * x[:, 1] + np.sin(x @ waves.T + phases) @ heights
        return made

    return function


def held(seed: int) -> tuple[float, float, float]:
    """Shares of points within and beyond the 95 % interval and above its one-sided bound, for one function."""
    rng = np.random.default_rng(seed)
    factors, runs = 2 + seed % 2, int(rng.integers(12, 25))
    function = smooth_function(rng, factors)
    points, new = rng.uniform(0, 1, (runs, factors)), rng.uniform(0, 1, (200, factors))
    true = function(new)
    noise = true.std() * rng.choice([0.02, 0.1, 0.3])
    mean, sd = fit_process(points, function(points) + rng.normal(0, noise, runs)).predict(new)
    return (
        float((np.abs(true - mean) <= 1.96 * sd).mean()),
        float((true > mean + 1.645 * sd).mean()),
        float(np.sqrt(((mean - true) ** 2).mean()) / true.std()),
    )


def test_intervals_hold_on_functions_not_seen() -> None:
    within, above, error = np.mean([held(seed) for seed in range(16)], axis=0)
    assert within >= 0.9
    assert above <= 0.08
    assert error < 0.45


@pytest.mark.slow
def test_intervals_hold_on_many_functions_not_seen() -> None:
    rows = np.array([held(seed) for seed in range(100, 180)])
    within, above, error = rows.mean(axis=0)
    print(f"within 95 %: {within:.3f}, above one-sided 95 %: {above:.3f}, error {error:.3f} of the spread")
    assert within >= 0.93
    assert above <= 0.06
    assert np.quantile(rows[:, 0], 0.1) >= 0.8


def runs_of(seed: int, factors: int = 2, count: int = 14) -> tuple[Values, Values]:
    rng = np.random.default_rng(seed)
    points = rng.uniform(0, 1, (count, factors))
    return points, 5 + 3 * smooth_function(rng, factors)(points) + rng.normal(0, 0.3, count)


@pytest.mark.parametrize("trend", ["constant", "linear", "quadratic"])
@pytest.mark.parametrize("blocks", [[], [0, 1] * 7])
def test_the_gradient_is_that_of_the_loss(trend: Trend, blocks: list[int]) -> None:
    points, values = runs_of(1)
    posterior = _Posterior.of(points, (values - 5) / 3, np.array(blocks, np.int64), trend, 0.01)
    logs = posterior.centres + np.linspace(-0.4, 0.6, len(posterior.centres))
    numeric = np.array(
        [(posterior.loss(logs + h)[0] - posterior.loss(logs - h)[0]) / 2e-5 for h in 1e-5 * np.eye(len(logs))]
    )
    assert posterior.loss(logs)[1] == pytest.approx(numeric, rel=1e-4, abs=1e-5)


def test_a_plane_is_found_and_its_noise() -> None:
    rng = np.random.default_rng(3)
    points = rng.uniform(0, 1, (40, 2))
    process = fit_process(points, 100 + points @ [20.0, -5.0] + rng.normal(0, 0.5, 40))
    mean, sd = process.predict([[0.5, 0.5], [1.0, 0.0]])
    assert (np.abs(mean - [107.5, 120.0]) < 3 * sd).all()
    assert (sd < 0.5).all()
    assert process.noise_sd == pytest.approx(0.5, rel=0.3)
    assert process.block_sd == 0


def test_the_same_runs_give_the_same_bits() -> None:
    points, values = runs_of(4)
    one, other = (fit_process(points, values).predict(points + 0.01) for _ in range(2))
    assert (one[0] == other[0]).all()
    assert (one[1] == other[1]).all()


def test_units_and_offsets_pass_through() -> None:
    points, values = runs_of(5)
    mean, sd = fit_process(points, values).predict(points)
    scaled_mean, scaled_sd = fit_process(points, 1000 - 4 * values).predict(points)
    assert scaled_mean == pytest.approx(1000 - 4 * mean, rel=1e-4)
    assert scaled_sd == pytest.approx(4 * sd, rel=1e-2)


def test_far_from_runs_less_is_known() -> None:
    points, values = runs_of(6)
    process = fit_process(points * 0.4, values)
    near, far = process.predict([[0.2, 0.2], [1.0, 1.0]])[1]
    assert far > 3 * near


@pytest.mark.parametrize("trend", ["constant", "linear", "quadratic"])
def test_runs_left_out_are_predicted_by_the_others(trend: Trend) -> None:
    points, values = runs_of(7)
    process = fit_process(points, values, trend=trend)
    mean, sd = process.left_out([run // 2 for run in range(14)])
    again = fit_process(points, values, trend=trend).with_runs(points[:1], values[:1])
    assert (np.abs(mean - values) < 4 * np.hypot(sd, process.noise_sd)).all()
    assert (sd > process.predict(points)[1]).all()
    assert again.predict(points[:1])[1] < process.predict(points[:1])[1]
    assert len(again.values) == 15


def test_what_is_left_out_has_no_say() -> None:
    points, values = runs_of(8)
    process = fit_process(points, values)
    groups = ["first"] * 3 + list(range(11))
    moved = _conditioned(replace(process, values=np.hstack([values[:3] + 100, values[3:]])))
    assert moved.left_out(groups)[0][:3] == pytest.approx(process.left_out(groups)[0][:3], rel=1e-9)
    assert moved.left_out(groups)[0][3] != pytest.approx(process.left_out(groups)[0][3], rel=1e-3)


def test_machines_that_differ_are_told_from_noise() -> None:
    rng = np.random.default_rng(9)
    points, machines = rng.uniform(0, 1, (36, 2)), np.repeat(np.arange(6), 6)
    effects = rng.normal(0, 2.0, 6)
    values = points @ [6.0, -4.0] + effects[machines] + rng.normal(0, 0.3, 36)
    process = fit_process(points, values, blocks=[f"machine {one}" for one in machines])
    blind = fit_process(points, values)
    assert process.noise_sd == pytest.approx(0.3, rel=0.5)
    assert process.block_sd == pytest.approx(effects.std(ddof=1), rel=0.5)
    assert blind.noise_sd > 1
    mean, sd = process.predict([[0.0, 0.5], [1.0, 0.5]])
    assert mean[1] - mean[0] == pytest.approx(6, abs=0.8)
    assert (sd > process.block_sd / 6**0.5 * 0.7).all()
    out = process.left_out(machines.tolist())
    assert (np.abs(out[0] - points @ [6.0, -4.0]) < 3 * out[1]).all()


def test_categories_and_replicates_need_no_care() -> None:
    rng = np.random.default_rng(10)
    oil = np.eye(3)[np.repeat([0, 1, 2], 5)]
    current = np.tile([0.0, 0.0, 0.5, 1.0, 1.0], 3)
    process = fit_process(
        np.column_stack([oil, current]), oil @ [1.0, 4, 9] + current + rng.normal(0, 0.05, 15)
    )
    mean, sd = process.predict(np.column_stack([np.eye(3), [0.5] * 3]))
    assert mean == pytest.approx([1.5, 4.5, 9.5], abs=0.25)
    assert (sd < 0.4).all()


def test_five_runs_over_eight_factors_say_little() -> None:
    rng = np.random.default_rng(11)
    process = fit_process(rng.uniform(0, 1, (5, 8)), rng.normal(0, 1, 5))
    sd = process.predict(rng.uniform(0, 1, (20, 8)))[1]
    assert np.isfinite(sd).all()
    assert sd.min() > 0.3


def test_values_that_do_not_differ() -> None:
    process = fit_process(np.linspace(0, 1, 6)[:, None], np.full(6, 7.0), noise_floor=0.5)
    mean, sd = process.predict([[0.3]])
    assert mean == pytest.approx(7, abs=1e-6)
    assert 0 < sd[0] < 1
    assert process.noise_sd >= 0.5


def test_predictions_of_many_points_are_those_of_each() -> None:
    process: GaussianProcess = fit_process(*runs_of(12))
    points = np.random.default_rng(0).uniform(0, 1, (1100, 2))
    whole, part = process.predict(points)[0], process.predict(points[700:702])[0]
    assert whole[700:702] == pytest.approx(part, rel=1e-12)
    assert process.predict(np.empty((0, 2)))[0].shape == (0,)


def test_what_cannot_be_is_refused() -> None:
    points, values = runs_of(13)
    with pytest.raises(ValueError, match="at least 3 runs, not 2"):
        fit_process(points[:2], values[:2])
    with pytest.raises(ValueError, match="take runs out that failed"):
        fit_process(points, np.where(values > values.min(), values, np.nan))
    with pytest.raises(ValueError, match="one value"):
        fit_process(points, values[:5])
    with pytest.raises(ValueError, match="one value and at most one block"):
        fit_process(points, values, blocks=[1, 2])
    process = fit_process(points, values)
    with pytest.raises(ValueError, match="2 groups of 14 runs"):
        process.left_out([1, 2])
    with pytest.raises(ValueError, match="none is left"):
        process.left_out([0] * 14)
