"""Every waveform starts where the actuator rests, keeps the slew limit and loses no turning point."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edmctl.actuator import waveforms
from edmctl.actuator.waveforms import (
    FIGURE_NAMES,
    Leg,
    Waveform,
    calibration_legs,
    calibration_waveform,
    figure_command,
    readings,
    sampled,
    slow_legs,
)


def test_the_slow_legs_span_the_range_in_296_s_and_hold_for_the_creep_to_be_seen() -> None:
    legs = slow_legs(150.0)
    assert sum(leg.duration_s for leg in legs) == pytest.approx(296.0, abs=0.5)
    _, u_v = sampled(legs, 200.0)
    assert (u_v[0], u_v[-1], u_v.min(), u_v.max()) == (0.0, 0.0, 0.0, 150.0)
    holds = [(a.u_v, b.duration_s) for a, b in pairwise(legs) if a.u_v == b.u_v]
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


RATE_HZ = 1000.0


def read(figure: str, error_um: np.ndarray, model_um: np.ndarray | None = None) -> dict[str, float]:
    u_v = figure_command(figure, RATE_HZ)
    found = readings(figure, u_v, error_um, u_v if model_um is None else model_um, RATE_HZ)
    return {reading.what: reading.ours_um for reading in found}


def peak(figure: str, at_s: float, height_um: float) -> np.ndarray:
    """An error of 1 µm everywhere but at one instant."""
    error_um = np.full(len(figure_command(figure, RATE_HZ)), 1.0)
    error_um[round(at_s * RATE_HZ)] = height_um
    return error_um


@pytest.mark.parametrize(
    ("figure", "at_s", "what"),
    [
        ("fig3a", 0.0, "first trough"),
        ("fig3a", 100.0, "later troughs"),
        ("fig3a", 50.0, "away from the troughs"),
        ("fig3b", 2.5, "crests"),
        ("fig4", 0.12, "as the voltage arrives"),
        ("fig4", 20.0 + 0.12 + 0.1, "0.1 s later"),
        ("fig4", 5.62, "5 to 6 s later"),
        ("fig5", 5.0, "rising ramps, the first"),
        ("fig5", 15.0, "rising ramps, later ones"),
        ("fig5", 10.7, "retracted, from 0.1 s on"),
    ],
)
def test_each_reading_is_taken_where_it_says(figure: str, at_s: float, what: str) -> None:
    found = read(figure, peak(figure, at_s, -30.0))
    assert found[what] == 30.0
    others = {name: value for name, value in found.items() if name != what}
    assert others.get("as the voltage arrives", 1.0) in (1.0, 30.0)
    assert all(value == 1.0 for name, value in others.items() if name != "as the voltage arrives")


def test_nothing_is_read_right_after_a_retract_and_the_stroke_of_the_first_cycle_of_the_loop() -> None:
    assert max(read("fig5", peak("fig5", 10.05, 30.0)).values()) == 1.0
    u_v = figure_command("loop", RATE_HZ)
    assert read("loop", np.zeros(len(u_v)), 3.0 * u_v) == {"stroke at 150 V": pytest.approx(450.0)}


def test_the_papers_own_figures_stand_beside_ours() -> None:
    for figure in FIGURE_NAMES:
        u_v = figure_command(figure, RATE_HZ)
        for reading in readings(figure, u_v, u_v, u_v, RATE_HZ):
            assert math.isnan(reading.paper_low_um) == (reading.paper in ("–", "small"))
            assert not reading.paper_low_um > reading.paper_high_um
    with pytest.raises(KeyError):
        readings("fig7", np.zeros(3), np.zeros(3), np.zeros(3), RATE_HZ)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_bias_that_is_left_is_on_the_side_of_the_error_that_it_is_left_of(sign: float) -> None:
    u_v = figure_command("fig4", RATE_HZ)
    arrival = np.flatnonzero(np.diff(u_v) > 0.0)[-1] + 1
    error_um = np.zeros(len(u_v))
    error_um[arrival : arrival + round(RATE_HZ)] = 30.0 * sign
    error_um[arrival + round(5.5 * RATE_HZ)] = -2.0 * sign
    found = {one.what: one for one in readings("fig4", u_v, error_um, u_v, RATE_HZ)}
    assert found["5 to 6 s later"].ours_um == 2.0
    assert found["5 to 6 s later"].paper_side == found["as the voltage arrives"].paper_side == sign
