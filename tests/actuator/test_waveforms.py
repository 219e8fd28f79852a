"""Every waveform starts where the actuator rests, keeps the slew limit and loses no turning point."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edmctl.actuator import waveforms
from edmctl.actuator.waveforms import (
    Leg,
    Waveform,
    calibration_legs,
    calibration_waveform,
    sampled,
    slow_legs,
)


def test_the_slow_legs_last_296_s() -> None:
    assert sum(leg.duration_s for leg in slow_legs(150.0)) == pytest.approx(296.0, abs=0.5)


def test_the_slow_legs_span_the_range_from_0_back_to_0() -> None:
    _, u_v = sampled(slow_legs(150.0), 200.0)
    assert (u_v[0], u_v[-1], u_v.min(), u_v.max()) == (0.0, 0.0, 0.0, 150.0)


def test_the_slow_legs_hold_for_the_creep_to_be_seen() -> None:
    holds = [
        (a.u_v, b.duration_s)
        for a, b in zip(slow_legs(150.0), slow_legs(150.0)[1:], strict=False)
        if a.u_v == b.u_v
    ]
    assert holds == [(0.0, 10.0), (120.0, 60.0), (60.0, 40.0), (0.0, 40.0)]


def test_a_calibration_is_sampled_slowly_but_for_its_fast_legs() -> None:
    (t_s, u_v), is_kept = calibration_waveform(150.0, 1000.0, 5)
    slow, fast, use = calibration_legs(150.0)
    ends = np.cumsum([0.0, *(sum(leg.duration_s for leg in legs) for legs in (slow, fast, use))])
    assert t_s[-1] == pytest.approx(ends[-1], abs=0.1)
    assert u_v[-1] == 0.0
    for first_s, end_s, step_s in zip(ends, ends[1:], (0.005, 0.001, 0.005), strict=False):
        inside = is_kept & (t_s > first_s + 0.2) & (t_s < end_s - 0.2)
        assert np.allclose(np.diff(t_s[inside]), step_s)


@pytest.mark.parametrize("slew_v_s", [20.0, 200.0, 1000.0])
def test_no_leg_of_the_slow_legs_is_steeper_than_the_slew_limit(slew_v_s: float) -> None:
    assert steepest_v_s(sampled(slow_legs(150.0, slew_v_s), 1000.0)) <= slew_v_s * (1 + 1e-9)


@given(
    st.lists(st.tuples(st.floats(-20.0, 150.0), st.floats(0.0, 3.0)), min_size=1, max_size=10),
    st.floats(1.0, 1000.0),
)
def test_every_leg_ends_on_a_sample(points: list[tuple[float, float]], rate_hz: float) -> None:
    t_s, u_v = sampled([Leg(*point) for point in points], rate_hz, 5.0)
    visited = iter(u_v.tolist())
    assert all(target in visited for target, _ in points)
    assert u_v[0] == 5.0
    assert t_s[-1] >= sum(duration for _, duration in points) - 1e-5


@pytest.mark.parametrize(
    "waveform",
    [
        waveforms.sine(10.0, 120.0, 1.0, 3, 1000.0),
        waveforms.triangle(10.0, 120.0, 1.0, 3, 1000.0),
        waveforms.square(10.0, 120.0, 0.1, 2, 1000.0),
        waveforms.jump_train(10.0, 120.0, 1000.0),
        waveforms.servo_dither(10.0, 120.0, 1000.0),
    ],
    ids=["sine", "triangle", "square", "jump train", "servo"],
)
def test_waveforms_start_low_reach_high_and_keep_the_slew_limit(waveform: Waveform) -> None:
    t_s, u_v = waveform
    assert t_s.dtype == u_v.dtype == np.float64
    assert (t_s[0], u_v[0], u_v.min()) == (0.0, 10.0, 10.0)
    assert u_v.max() == pytest.approx(120.0)
    assert steepest_v_s(waveform) <= waveforms.SLEW_V_S * (1 + 1e-9)


def test_a_sine_starts_level() -> None:
    u_v = waveforms.sine(0.0, 120.0, 0.01, 1, 100.0).u_v
    assert u_v[1] < 1e-4
    assert u_v[5000] == pytest.approx(120.0)


def test_a_square_wave_keeps_its_period_with_ramps_in_it() -> None:
    t_s, u_v = waveforms.square(0.0, 120.0, 0.05, 2, 1000.0)
    assert t_s[-1] == pytest.approx(40.0)
    assert u_v[[200, 9999, 10200, 19999, 20200]].tolist() == pytest.approx([120.0, 120.0, 0.0, 0.0, 120.0])


def test_a_jump_returns_to_where_the_feed_was() -> None:
    _, u_v = waveforms.jump_train(0.0, 120.0, 1000.0, jumps=4, interval_s=10.0, away_s=1.0)
    returns = np.flatnonzero((u_v[1:-1] == 0.0) & (u_v[2:] > 0.5)) + 1
    before_v = [u_v[k - 1200 : k].max() for k in returns]
    back_v = [u_v[k + round(level_v)] for k, level_v in zip(returns, before_v, strict=True)]
    assert before_v == pytest.approx([30.0, 60.0, 90.0, 120.0])
    assert back_v == pytest.approx(before_v)


def test_the_servo_dithers_within_its_swing_on_a_steady_feed() -> None:
    t_s, u_v = waveforms.servo_dither(0.0, 120.0, 100.0, duration_s=200.0, swing_v=3.0)
    feed_v = np.interp(t_s, [0.0, 10.0, 200.0], [0.0, 24.0, 120.0])
    assert t_s[-1] == pytest.approx(200.0)
    assert np.abs(u_v - feed_v).max() < 3.5
    assert np.count_nonzero(np.diff(np.sign(np.diff(u_v)))) > 300


def steepest_v_s(waveform: Waveform) -> float:
    return float(np.abs(np.diff(waveform.u_v) / np.diff(waveform.t_s)).max())
