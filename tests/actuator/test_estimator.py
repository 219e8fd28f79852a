"""Ramps and jumps solved beforehand end where they were meant to."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from edmctl.actuator.correction import GAIN_SD_BETWEEN_DAYS, SlowCorrection
from edmctl.actuator.inverse import Inverse, Solution, jump_volts, ramp_by, travel_by
from edmctl.actuator.model import ActuatorModel, Estimator
from tests.actuator.models import (
    HIGH_V,
    LOW_V,
    clock,
    make_model,
    models,
    rounded_model,
    rounded_models,
    voltages,
)


@given(models | rounded_models, voltages, st.sampled_from([0.0, 0.004, 0.03]))
@settings(max_examples=60, deadline=None)
def test_ticks_and_blocks_agree(model: ActuatorModel, u_v: list[float], delay_s: float) -> None:
    model = replace(model, delay_s=delay_s)
    estimator, blocks = Estimator(model), Estimator(model)
    ticked = [estimator.tick(u, 0.01) for u in u_v]
    np.testing.assert_allclose(ticked, blocks.advance(clock(len(u_v)) + 0.01, np.array(u_v)), atol=1e-9)


@given(voltages, st.integers(1, 39))
@settings(max_examples=40, deadline=None)
def test_blocks_may_be_cut_anywhere(u_v: list[float], cut: int) -> None:
    model = make_model(delay_s=0.025)
    t_s = clock(len(u_v)) + 0.01
    whole, parts = Estimator(model), Estimator(model)
    joined = np.concatenate(
        [parts.advance(t_s[:cut], np.array(u_v[:cut])), parts.advance(t_s[cut:], np.array(u_v[cut:]))]
    )
    np.testing.assert_allclose(whole.advance(t_s, np.array(u_v)), joined, atol=1e-12)


def test_ticks_and_blocks_may_be_mixed() -> None:
    model = make_model(delay_s=0.004)
    mixed, ticked = Estimator(model), Estimator(model)
    u_v = 75.0 + 70.0 * np.sin(np.arange(60) / 5.0)
    expected_um = [ticked.tick(u, 0.01) for u in u_v]
    for u in u_v[:20]:
        mixed.tick(u, 0.01)
    mixed.advance(clock(20) + 0.21, u_v[20:40])
    assert [mixed.tick(u, 0.01) for u in u_v[40:]] == pytest.approx(expected_um[40:])


def test_gain_and_offset_correct_what_comes_out() -> None:
    plain, corrected = Estimator(make_model()), Estimator(make_model())
    corrected.correct(1.02, -4.0)
    assert corrected.tick(80.0, 0.01) == pytest.approx(1.02 * plain.tick(80.0, 0.01) - 4.0)
    with pytest.raises(ValueError, match="a gain is positive"):
        corrected.correct(0.0, 0.0)


def test_out_of_reach_is_said_and_the_very_ends_are_not() -> None:
    model = make_model()
    inverse = Inverse(model)
    low_um, high_um = (
        model.predict(np.array([0.0]), np.array([u_v]), inverse.state)[0] for u_v in (LOW_V, HIGH_V)
    )
    assert Inverse(model).tick(low_um, 0.0) == Solution(LOW_V, saturated=False)
    assert Inverse(model).tick(high_um, 0.0) == Solution(HIGH_V, saturated=False)
    assert Inverse(model).tick(low_um - 0.01, 0.0) == Solution(LOW_V, saturated=True)
    assert Inverse(model).tick(high_um + 0.01, 0.0) == Solution(HIGH_V, saturated=True)


@given(models | rounded_models, voltages)
@example(rounded_model((1.0, 21.0), 1.0, 1.0, 0.02), [24.0, 0.0])  # steep: rounding is coarser
@settings(max_examples=80, deadline=None)
def test_the_inverse_undoes_the_model(model: ActuatorModel, u_v: list[float]) -> None:
    t_s = clock(len(u_v)) + 0.01
    y_um = model.predict(t_s, np.array(u_v), Inverse(model).state)
    found_v, saturated = Inverse(model).solve(t_s, y_um)
    assert not saturated.any()
    np.testing.assert_allclose(model.predict(t_s, found_v, Inverse(model).state), y_um, rtol=0.0, atol=1e-9)
    if not len(model.rounded_um_per_v):
        np.testing.assert_allclose(found_v, np.array(u_v), atol=1e-9)


def test_the_inverse_goes_on_after_saturation() -> None:
    model = make_model()
    inverse, estimator = Inverse(model), Estimator(model)
    for y_um in (100.0, 5000.0, 150.0, -100.0, 120.0):
        found = inverse.tick(y_um, 0.01)
        reached_um = estimator.tick(found.u_v, 0.01)
        assert found.saturated is (y_um in (5000.0, -100.0))
        if not found.saturated:
            assert reached_um == pytest.approx(y_um, abs=1e-9)


@pytest.mark.parametrize(
    ("t_s", "u_v"),
    [
        ([0.0, 1.0, 2.0], [0.0, 1.0]),
        ([0.0, 1.0], [0.0, 1.0, 2.0]),
        ([[0.0], [1.0]], [[0.0], [1.0]]),
        ([0.0, np.nan], [0.0, 1.0]),
        ([0.0, 1.0], [0.0, np.inf]),
        ([1.0, 0.0], [0.0, 1.0]),
    ],
)
def test_samples_that_cannot_be_are_refused(t_s: object, u_v: object) -> None:
    model = make_model()
    with pytest.raises(ValueError, match=r"times|time runs"):
        model.predict(t_s, u_v)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"times|time runs"):
        Inverse(model).solve(t_s, u_v)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("u_v", "dt_s"), [(np.nan, 0.01), (np.inf, 0.01), (10.0, -0.01), (10.0, np.nan), (10.0, np.inf)]
)
def test_a_tick_that_cannot_be_changes_nothing(u_v: float, dt_s: float) -> None:
    estimator, untouched = Estimator(make_model()), Estimator(make_model())
    estimator.tick(50.0, 0.01)
    untouched.tick(50.0, 0.01)
    with pytest.raises(ValueError, match=r"finite numbers|time runs forwards"):
        estimator.tick(u_v, dt_s)
    assert estimator.tick(60.0, 0.01) == untouched.tick(60.0, 0.01)


def test_a_block_before_the_last_one_changes_nothing() -> None:
    estimator = Estimator(make_model())
    estimator.advance(clock(10) + 5.0, np.full(10, 50.0))
    with pytest.raises(ValueError, match="time runs forwards"):
        estimator.advance(clock(10), np.full(10, 60.0))
    assert estimator.state.u_v == 50.0


def test_lists_and_other_numbers_are_taken_as_they_are() -> None:
    model, none = make_model(delay_s=0.02), np.empty(0)
    assert model.predict(none, none).shape == Estimator(model).advance(none, none).shape == (0,)
    assert Inverse(model).solve(none, none)[0].shape == (0,)
    expected = model.predict(np.array([0.0, 1.0]), np.array([10.0, 120.0]))
    assert (model.predict([0, 1], [10, 120]) == expected).all()  # type: ignore[arg-type]
    bytes_v = np.array([10, 120], dtype=np.int8)
    assert (model.predict(np.arange(2), bytes_v) == expected).all()  # type: ignore[arg-type]


INVERSE_RATE_HZ = 1000.0


def lowered(model: ActuatorModel, to_v: float = 60.0) -> Estimator:
    """An estimator that came up from 0 V at 20 V/s and has rested a second."""
    estimator = Estimator(model)
    go(estimator, to_v, to_v / 20.0)
    go(estimator, to_v, 1.0)
    return estimator


def go(estimator: Estimator, to_v: float, duration_s: float) -> float:
    """Ramp in time; the displacement at the end."""
    steps = round(duration_s * INVERSE_RATE_HZ)
    share = np.arange(1, steps + 1) / steps
    state = estimator.state
    u_v = state.u_v + (to_v - state.u_v) * share
    return float(estimator.advance(state.t_s + duration_s * share, u_v)[-1])


def here_um(estimator: Estimator) -> float:
    return estimator.tick(estimator.state.u_v, 0.0)


@pytest.mark.parametrize("distance_um", [100.0, 20.0, -60.0])
def test_a_ramp_ends_at_its_distance_with_creep_on_the_way(distance_um: float) -> None:
    estimator = lowered(make_model())
    estimator.correct(1.02, 7.0)
    start_um, start_v = here_um(estimator), estimator.state.u_v
    goal_v = ramp_by(estimator, distance_um, 60.0)
    assert estimator.state.u_v == start_v
    reached_um = go(estimator, goal_v, abs(goal_v - start_v) / 60.0) - start_um
    assert reached_um == pytest.approx(distance_um, rel=5e-3)


def test_at_once_is_too_much_for_a_ramp() -> None:
    """What the path is for: the voltage that is right at once leaves 2 % more by the end of a slow ramp."""
    estimator = lowered(make_model())
    start_um, start_v = here_um(estimator), estimator.state.u_v
    at_once_v = Inverse(estimator.model, estimator.state).tick(start_um + 100.0, 0.0).u_v
    assert travel_by(estimator, 100.0, 1.0) < travel_by(estimator, 100.0, 50.0) - 0.5
    reached_um = go(estimator, at_once_v, (at_once_v - start_v) / 60.0) - start_um
    assert reached_um > 102.0


def test_a_jump_is_up_at_the_end_of_its_dwell_and_back_to_its_clearance() -> None:
    estimator = lowered(make_model())
    start_um, start_v = here_um(estimator), estimator.state.u_v
    volts = jump_volts(estimator, 60.0, 5.0, travel_s=0.03, dwell_s=0.02)
    go(estimator, start_v - volts.height_v, 0.03)
    top_um = go(estimator, start_v - volts.height_v, 0.02)
    assert start_um - top_um == pytest.approx(60.0, rel=5e-3)
    back_um = go(estimator, start_v - volts.clearance_v, 0.03)
    assert start_um - back_um == pytest.approx(5.0, abs=0.5)
    assert volts.height_v > 60.0 / 2.967  # more than the mean gain says


def test_a_jump_beyond_0_v_goes_as_far_as_the_voltage_does() -> None:
    estimator = lowered(make_model(), 10.0)
    volts = jump_volts(estimator, 300.0, 5.0, travel_s=0.1, dwell_s=0.02)
    assert volts.height_v == 10.0
    assert 0.0 <= volts.clearance_v <= volts.height_v


LOW_UM, HIGH_UM = 20.0, 350.0


def test_two_heights_give_gain_and_zero() -> None:
    correction = SlowCorrection()
    for time_s, y_um in enumerate((LOW_UM, HIGH_UM) * 3):
        correction.observe(float(time_s), y_um, 1.02 * y_um - 35.0, 0.05)
    assert correction.gain == pytest.approx(1.02, abs=2e-4)
    assert correction.offset_um == pytest.approx(-35.0, abs=0.05)
    assert correction.sd_um(200.0) < 0.1


def test_one_height_moves_the_zero_and_leaves_the_gain() -> None:
    correction = SlowCorrection()
    correction.observe(0.0, 0.0, 12.0, 0.1)
    assert correction.gain == 1.0
    assert correction.offset_um == pytest.approx(12.0, abs=1e-4)
    assert correction.gain_sd == GAIN_SD_BETWEEN_DAYS


def test_it_is_the_least_squares_line_where_nothing_walks() -> None:
    rng = np.random.default_rng(1)
    y_um = rng.uniform(LOW_UM, HIGH_UM, 40)
    z_um = 0.99 * y_um + 3.0 + 0.3 * rng.standard_normal(40)
    correction = SlowCorrection()
    for y, z in zip(y_um, z_um, strict=True):
        correction.observe(0.0, float(y), float(z), 0.3)
    zero_um, gain = np.polynomial.polynomial.polyfit(y_um, z_um, 1)
    assert correction.gain == pytest.approx(gain, abs=2e-5)
    assert correction.offset_um == pytest.approx(zero_um, abs=5e-3)


def test_after_an_hour_a_new_reading_counts_for_more_than_the_old_ones() -> None:
    old, now = 0.0, 3600.0
    correction = SlowCorrection()
    for y_um in (LOW_UM, HIGH_UM):
        correction.observe(old, y_um, y_um, 0.1)
    correction.observe(now, 100.0, 103.0, 0.1)
    assert correction.gain * 100.0 + correction.offset_um == pytest.approx(103.0, abs=0.02)
    assert correction.offset_um > 2.0  # the zero has walked 2.4 µm by then, the gain 0.5 % of 100 µm


def test_uncertainty_grows_with_time_as_stated() -> None:
    """0.5 % of gain in an hour, 1 µm of zero in ten minutes, beside a reading that says nothing."""
    correction = SlowCorrection(gain_sd=1e-9)
    correction.observe(0.0, 0.0, 0.0, 1e-6)
    correction.observe(600.0, 0.0, 0.0, 1e9)
    assert correction.sd_um(0.0) == pytest.approx(1.0, rel=1e-6)
    correction.observe(3600.0, 0.0, 0.0, 1e9)
    assert correction.gain_sd == pytest.approx(0.005, rel=1e-6)
    assert correction.sd_um(0.0) == pytest.approx(math.sqrt(6.0), rel=1e-6)


def test_readings_come_in_order_with_a_positive_spread() -> None:
    correction = SlowCorrection(10.0)
    with pytest.raises(ValueError, match="after the last one"):
        correction.observe(9.0, 0.0, 0.0, 0.1)
    with pytest.raises(ValueError, match="standard deviation"):
        correction.observe(11.0, 0.0, 0.0, 0.0)
