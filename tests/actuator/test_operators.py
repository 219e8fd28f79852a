"""What play and creep are known for."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from edmctl.actuator.estimator import TIME_CONSTANTS_S
from edmctl.actuator.operators import BankKernel, BankShape, BankState, advance_bank, compiled_bank
from tests.actuator.truth import play

Array = NDArray[np.float64]

SHAPE = BankShape(np.array([0.0, 2.0, 9.0, 40.0]), np.array([0, 2]), np.array([0.1, 0.5, 2.5]))
WITHOUT_CREEP = BankShape(SHAPE.thresholds_v, np.array([], dtype=np.int64), np.array([1.0]))
WEIGHTS = np.array([1.5, 0.3, 0.4, 0.2])

volts = st.floats(0.0, 150.0)
histories = st.lists(volts, min_size=1, max_size=30).map(np.array)


def run(
    shape: BankShape, state: BankState, time_s: Array, actuator_v: Array, kernel: BankKernel = advance_bank
) -> tuple[Array, Array]:
    features = np.empty((len(time_s), shape.features))
    output = np.empty(len(time_s))
    weights = np.resize(WEIGHTS, shape.features)
    kernel(
        time_s,
        actuator_v,
        state.time_s,
        shape.thresholds_v,
        shape.creeping,
        shape.time_constants_s,
        state.plays_v,
        state.creep_v,
        weights,
        features,
        output,
    )
    state.time_s = float(time_s[-1])
    return features, output


def seconds(samples: int, step_s: float = 1.0) -> Array:
    return step_s * np.arange(samples, dtype=np.float64)


def output_without_creep(actuator_v: Array) -> Array:
    state = BankState.at_rest(WITHOUT_CREEP, 0.0, 0.0)
    return run(WITHOUT_CREEP, state, seconds(len(actuator_v)), actuator_v)[1]


def test_compiled_and_plain_give_the_same_bits() -> None:
    rng = np.random.default_rng(3)
    time_s = np.cumsum(rng.uniform(0.001, 0.1, 2000))
    actuator_v = 75.0 + 75.0 * np.sin(time_s) * rng.uniform(0.5, 1.0, 2000)
    plain, compiled = (BankState.at_rest(SHAPE, 0.0, 0.0) for _ in range(2))
    expected = run(SHAPE, plain, time_s, actuator_v)
    found = run(SHAPE, compiled, time_s, actuator_v, compiled_bank())
    for one, other in zip(expected, found, strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(plain.plays_v, compiled.plays_v)
    np.testing.assert_array_equal(plain.creep_v, compiled.creep_v)


@given(histories)
def test_each_play_is_the_textbook_operator(actuator_v: Array) -> None:
    state = BankState.at_rest(WITHOUT_CREEP, float(actuator_v[0]), 0.0)
    features, _ = run(WITHOUT_CREEP, state, seconds(len(actuator_v)), actuator_v)
    for column, threshold_v in zip(features.T, SHAPE.thresholds_v, strict=True):
        np.testing.assert_array_equal(column, play(actuator_v, threshold_v))


@given(histories, st.integers(1, 7))
def test_samples_between_turning_points_do_not_matter(corners_v: Array, between: int) -> None:
    k = np.arange((len(corners_v) - 1) * between + 1) / between
    fine_v = np.interp(k, np.arange(len(corners_v)), corners_v)
    fine_v[::between] = corners_v
    np.testing.assert_allclose(
        output_without_creep(fine_v)[::between], output_without_creep(corners_v), rtol=0, atol=1e-9
    )


@given(histories, volts, st.floats(0.0, 1.0))
def test_a_closed_minor_loop_is_forgotten(history_v: Array, start_v: float, share: float) -> None:
    peak_v = 150.0
    inner_v = start_v + share * (peak_v - start_v)
    state = BankState.at_rest(WITHOUT_CREEP, 0.0, 0.0)
    to_start_v = np.concatenate([history_v, [peak_v, start_v]])
    before, _ = run(WITHOUT_CREEP, state, seconds(len(to_start_v)), to_start_v)
    after, _ = run(WITHOUT_CREEP, state, state.time_s + np.array([1.0, 2.0]), np.array([inner_v, start_v]))
    np.testing.assert_allclose(after[-1], before[-1], rtol=0, atol=1e-12)


@given(st.floats(5.0, 75.0), st.floats(0.0, 75.0), st.floats(0.0, 75.0))
def test_equal_minor_loops_are_congruent(width_v: float, one_v: float, other_v: float) -> None:
    def loop(bias_v: float) -> Array:
        top_v, middle_v = bias_v + width_v, bias_v + width_v / 2
        out_um = output_without_creep(np.array([0.0, 150.0, bias_v, top_v, bias_v, middle_v, bias_v]))
        shape_um: Array = out_um[3:] - out_um[2]
        return shape_um

    np.testing.assert_allclose(loop(one_v), loop(other_v), rtol=0, atol=1e-9)


@given(histories, volts, volts)
def test_more_voltage_never_retracts(history_v: Array, one_v: float, other_v: float) -> None:
    state = BankState.at_rest(SHAPE, 0.0, 0.0)
    run(SHAPE, state, seconds(len(history_v), 0.1), history_v)
    later_s = np.array([state.time_s + 0.1])
    low_v, high_v = sorted((one_v, other_v))
    low = run(SHAPE, state.copy(), later_s, np.array([low_v]))[1][0]
    high = run(SHAPE, state.copy(), later_s, np.array([high_v]))[1][0]
    assert high - low >= WEIGHTS[0] * (high_v - low_v) - 1e-9


@settings(max_examples=30)
@given(st.lists(st.integers(1, 40), min_size=1, max_size=10))
def test_the_size_of_blocks_leaves_no_trace(sizes: list[int]) -> None:
    total = sum(sizes)
    time_s = seconds(total, 0.01)
    actuator_v = 75.0 * (1.0 - np.cos(0.2 * time_s))
    whole, pieces = (BankState.at_rest(SHAPE, 0.0, 0.0) for _ in range(2))
    expected = run(SHAPE, whole, time_s, actuator_v)[1]
    ends = np.cumsum(sizes)
    found = [
        run(SHAPE, pieces, time_s[end - size : end], actuator_v[end - size : end])[1]
        for end, size in zip(ends, sizes, strict=True)
    ]
    np.testing.assert_array_equal(np.concatenate(found), expected)


def test_creep_relaxes_exponentially_whatever_the_steps() -> None:
    held_v = 100.0
    for steps in (1, 10, 1000):
        state = BankState.at_rest(SHAPE, 0.0, 0.0)
        run(SHAPE, state, np.array([0.0]), np.array([held_v]))
        run(SHAPE, state, np.linspace(0.0, 2.0, steps + 1)[1:], np.full(steps, held_v))
        for tau_s, lagged_v in zip(SHAPE.time_constants_s, state.creep_v[0], strict=True):
            assert lagged_v == pytest.approx(held_v * (1.0 - math.exp(-2.0 / tau_s)), rel=1e-12)


def test_lags_in_steps_of_five_creep_with_the_logarithm_of_time() -> None:
    taus_s = np.array(TIME_CONSTANTS_S)
    shape = BankShape(np.array([0.0]), np.array([0]), taus_s)
    state = BankState.at_rest(shape, 0.0, 0.0)
    run(shape, state, np.array([0.0]), np.array([1.0]))
    decades_s = np.array([0.2, 2.0, 20.0, 200.0])
    sums = run(shape, state, decades_s, np.ones(4))[0][:, 1]
    per_decade = 1.0 / math.log10(5.0)
    np.testing.assert_allclose(np.diff(sums), per_decade, rtol=0.05)


def test_a_copy_of_a_state_is_independent() -> None:
    state = BankState.at_rest(SHAPE, 0.0, 0.0)
    kept = state.copy()
    run(SHAPE, state, np.array([1.0]), np.array([120.0]))
    assert kept.time_s == 0.0
    assert not kept.plays_v.any()
    assert not kept.creep_v.any()
