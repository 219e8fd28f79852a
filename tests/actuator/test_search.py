"""What is added to plays: where it predicts better, and nowhere else."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edmctl.actuator.fitting import _minimise, choose_design, nnls
from edmctl.actuator.identification import identify
from edmctl.actuator.model import ActuatorModel, ActuatorState
from edmctl.actuator.record import Record
from edmctl.actuator.search import Rows, extended, nnls_of_normal, simplex_search
from edmctl.actuator.waveforms import fast_legs, sampled
from tests.actuator.models import Array, clock, make_model
from tests.tiers import tiers


def scipy_nnls(matrix: Array, target: Array) -> tuple[Array, float]:
    from scipy.optimize import nnls

    x, residual = nnls(matrix, target)
    return x, float(residual)


def path_v(seed: int = 1, swings: int = 80) -> Array:
    """Swings of 1 s between voltages that do not repeat, at 50 Hz; in between, small ones."""
    rng = np.random.default_rng(seed)
    ends_v = np.concatenate([[0.0, 150.0, 0.0], rng.uniform(0.0, 150.0, swings)])
    slow_v = np.interp(np.arange(25 * len(ends_v)) / 25.0, np.arange(len(ends_v)), ends_v)
    slow_v[len(slow_v) // 2 :] = 70.0 + 5.0 * np.sin(np.arange(len(slow_v) - len(slow_v) // 2) / 3.0)
    clipped_v: Array = np.clip(slow_v, 0.0, 150.0)
    return clipped_v


def bouc_wen_um(u_v: Array) -> Array:
    """A loop by the equation itself, in small steps: dh/du = 1 - |h/20|^1.4 (0.4 + 0.6 sgn(h du))."""
    h_v, y_um = 0.0, np.empty(len(u_v))
    before_v = u_v[0]
    for k, volts in enumerate(u_v):
        steps = 1 + int(abs(volts - before_v) / 0.2)
        step_v = (volts - before_v) / steps
        for _ in range(steps):
            h_v += step_v * 0.6 * (1.0 - abs(h_v / 20.0) ** 1.4 * (0.4 + math.copysign(0.6, h_v * step_v)))
        before_v = volts
        y_um[k] = 3.0 * (volts - h_v)
    return y_um


def searched(record: Record) -> tuple[int, float]:
    design = choose_design([record])
    used = [np.ones(len(record.t_s), dtype=np.bool_)]
    found, _ = extended(design, [record], used, 0.0, is_fixed=False)
    return len(found.rounded), found.lag_s


def test_a_loop_that_forgets_by_its_way_gets_a_rounded_play() -> None:
    u_v = path_v()
    noise_um = 0.05 * np.random.default_rng(2).standard_normal(len(u_v))
    record = Record(clock(len(u_v), 0.02), u_v, bouc_wen_um(u_v) + noise_um, 0.0)
    assert searched(record) == (1, 0.0)


def test_an_actuator_of_the_plays_gets_none() -> None:
    u_v = path_v()
    t_s = clock(len(u_v), 0.02)
    truth = make_model(creep=0.01, hinges=4, plays=10)
    y_um = truth.predict(t_s, u_v, ActuatorState.after_jump(truth, 0.0, 0.0))
    noise_um = 0.3 * np.random.default_rng(2).standard_normal(len(u_v))
    record = Record(t_s, u_v, y_um + noise_um, 0.0)
    assert searched(record) == (0, 0.0)
    assert identify([record], resamples=0, delay_s=0.0).model.knots_v.shape[1] == 5


@pytest.mark.parametrize("lag_s", tiers(0.003, slow=(0.0,)))
def test_a_lag_is_told_from_a_delay_by_fast_swings(lag_s: float) -> None:
    wave = sampled(fast_legs(150.0), 1000.0)
    slow_s = wave.t_s[-1] + 0.02 * np.arange(1, 1501)
    slow_v = 75.0 - 75.0 * np.cos(0.4 * (slow_s - slow_s[0]))
    t_s, u_v = np.append(wave.t_s, slow_s), np.append(wave.u_v, slow_v)
    truth: ActuatorModel = replace(make_model(creep=0.01), lag_s=lag_s, delay_s=0.001)
    y_um = truth.predict(t_s, u_v, ActuatorState.after_jump(truth, 0.0, 0.0))
    noise_um = 0.1 * np.random.default_rng(4).standard_normal(len(t_s))
    found = identify([Record(t_s, u_v, y_um + noise_um, 0.0)], resamples=0).model
    assert found.lag_s + found.delay_s == pytest.approx(lag_s + 0.001, abs=4e-4)
    if lag_s:
        assert found.lag_s == pytest.approx(lag_s, abs=1.2e-3)


def test_a_voltage_that_steps_between_two_samples_takes_no_delay_from_a_parabola() -> None:
    """Between whole samples the step is missed by half its height; a delay of 2 of 5 ms was found, and a knock."""
    t_s = clock(2000, 0.02)
    u_v = 75.0 + 40.0 * np.sin(0.9 * t_s)
    u_v[1000:] += 35.0
    y_um = 3.0 * np.append(u_v[:1], u_v[:-1])
    record = Record(t_s, u_v, y_um + 0.05 * np.random.default_rng(3).standard_normal(len(t_s)))
    found_s = Rows([record], [np.ones(len(t_s), dtype=np.bool_)]).best_delay(choose_design([record]), 0.0)
    assert found_s == pytest.approx(0.02, abs=1e-12)


def test_normal_equations_are_solved_as_scipy_does() -> None:
    rng = np.random.default_rng(6)
    for _ in range(20):
        matrix, target = rng.normal(size=(40, 12)), rng.normal(size=40)
        start = np.maximum(rng.normal(size=12), 0.0)
        found = nnls_of_normal(matrix.T @ matrix, matrix.T @ target, start)
        np.testing.assert_allclose(found, scipy_nnls(matrix, target)[0], atol=1e-6)


def test_the_simplex_finds_a_valley() -> None:
    at = simplex_search(
        lambda p: float((p[0] - 1.0) ** 2 + 5.0 * (p[1] + 2.0 * p[0]) ** 2), np.zeros(2), np.ones(2), 120
    )
    np.testing.assert_allclose(at, (1.0, -2.0), atol=0.02)


@settings(max_examples=60)
@given(st.integers(1, 15), st.integers(0, 2**32 - 1))
def test_it_agrees_with_scipy(columns: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(40, columns))
    target = matrix @ np.maximum(rng.normal(size=columns), 0.0) + rng.normal(size=40)
    np.testing.assert_allclose(nnls(matrix, target), scipy_nnls(matrix, target)[0], rtol=0, atol=1e-9)


def test_nearly_equal_columns_fit_as_well_as_scipy() -> None:
    rng = np.random.default_rng(1)
    base = rng.normal(size=(200, 1))
    matrix = base + 1e-3 * rng.normal(size=(200, 8))
    target = base[:, 0] + 1e-2 * rng.normal(size=200)
    found = nnls(matrix, target)
    assert (found >= 0.0).all()
    assert np.linalg.norm(matrix @ found - target) == pytest.approx(scipy_nnls(matrix, target)[1], rel=1e-9)


def test_a_target_that_needs_negative_weights_gets_none() -> None:
    np.testing.assert_array_equal(nnls(np.eye(3), np.array([1.0, -2.0, 3.0])), [1.0, 0.0, 3.0])
    np.testing.assert_array_equal(nnls(np.eye(2), np.array([-1.0, -1.0])), [0.0, 0.0])


def test_a_column_that_is_worth_nothing_is_fixed_where_it_stands() -> None:
    with np.errstate(invalid="raise"):
        x = _minimise(np.eye(2), np.array([1.0, 0.0]), np.array([0.5, 0.0]), np.array([True, True]))
    assert x.tolist() == [1.0, 0.0]
