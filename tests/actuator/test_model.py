import dataclasses
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edmctl.actuator.inverse import Inverse
from edmctl.actuator.model import ActuatorModel, ActuatorState, Estimator
from tests.actuator.models import HIGH_V, LOW_V, clock, driven, make_model, models, voltages


@given(models, voltages, st.integers(2, 9))
@settings(max_examples=60, deadline=None)
def test_without_creep_only_turning_points_matter(
    model: ActuatorModel, turns: list[float], pieces: int
) -> None:
    model = dataclasses.replace(model, creep_um_per_v=np.zeros_like(model.creep_um_per_v))
    fine = np.concatenate(
        [np.linspace(a, b, pieces, endpoint=False) for a, b in pairwise(turns)] + [np.array(turns[-1:])]
    )
    start = ActuatorState.conditioned(model, turns[0])
    coarse_um = model.predict(clock(len(turns)), np.array(turns), start)
    fine_um = model.predict(clock(len(fine)), fine, start)
    np.testing.assert_allclose(fine_um[::pieces], coarse_um, atol=1e-9)


@given(models, voltages, st.floats(LOW_V, HIGH_V))
@settings(max_examples=60, deadline=None)
def test_a_closed_minor_loop_is_forgotten(model: ActuatorModel, history: list[float], away_v: float) -> None:
    model = dataclasses.replace(model, creep_um_per_v=np.zeros_like(model.creep_um_per_v))
    state = driven(model, clock(len(history)), np.array(history))
    low_v, high_v = min(history[-1], away_v), max(history[-1], away_v)
    loop = np.array([low_v, high_v, low_v, high_v])
    _, before_um, _, after_um = model.predict(clock(4) + state.t_s, loop, state)
    assert after_um == pytest.approx(before_um, abs=1e-9)


def minor_loop_um(model: ActuatorModel, low_v: float) -> float:
    """Opening in the middle of a loop of 40 V above `low_v`, reached from below."""
    loop = low_v + np.array([0.0, 40.0, 0.0, 20.0, 40.0, 20.0])
    y_um = model.predict(clock(len(loop)), loop, ActuatorState.conditioned(model))
    return float(y_um[5] - y_um[3])


def test_loops_are_alike_at_every_bias_with_one_hinge_only() -> None:
    plain = make_model(hinges=1, creep=0.0)
    bent = make_model(hinges=3, creep=0.0)
    assert minor_loop_um(plain, 10.0) == pytest.approx(minor_loop_um(plain, 90.0), abs=1e-9)
    assert abs(minor_loop_um(bent, 10.0) - minor_loop_um(bent, 90.0)) > 0.2


@given(models, voltages, st.floats(LOW_V, HIGH_V), st.floats(0.0, 50.0))
@settings(max_examples=100, deadline=None)
def test_more_voltage_is_more_displacement(
    model: ActuatorModel, history: list[float], u_v: float, more_v: float
) -> None:
    state = driven(model, clock(len(history)), np.array(history))
    at = np.array([state.t_s + 0.01])
    low_um = model.predict(at, np.array([u_v]), state)[0]
    high_um = model.predict(at, np.array([u_v + more_v]), state)[0]
    assert high_um - low_um >= model.slopes_um_per_v[0].min() * more_v - 1e-9


def test_a_step_creeps_by_gamma_per_decade() -> None:
    model = make_model(creep=0.05)
    state = ActuatorState.conditioned(model)
    times_s = np.array([0.0, 0.1, 10.0])
    zero_um = model.predict(np.array([0.0]), np.array([LOW_V]), state)[0]
    y_um = model.predict(times_s, np.full(3, HIGH_V), state) - zero_um
    assert (y_um[2] - y_um[1]) / y_um[1] / 2.0 == pytest.approx(model.gamma_per_decade, rel=0.02)


def test_after_a_long_rest_creep_has_come_to_its_end() -> None:
    model = make_model()
    state = ActuatorState.conditioned(model)
    model.advance(state, np.array([0.0]), np.array([100.0]))
    rested = state.copy()
    model.advance(rested, np.array([1e5]), np.array([100.0]))
    final_um = model.creep_um_per_v.sum(axis=1) @ rested.plays_v[model.creep_plays]
    assert np.sum(model.creep_um_per_v * rested.lags_v) == pytest.approx(final_um)
    assert rested.t_s == 1e5
    np.testing.assert_array_equal(rested.plays_v, state.plays_v)


def test_a_record_may_be_sampled_at_any_rate() -> None:
    model = make_model(creep=0.05)
    fine_s = clock(2001, 0.001)
    fine_v = np.interp(fine_s, [0.0, 0.5, 1.0, 1.5, 2.0], [0.0, 140.0, 20.0, 90.0, 90.0])
    fine_um = model.predict(fine_s, fine_v)
    # What is left: a play that starts to move within a step does not move in a straight line.
    np.testing.assert_allclose(model.predict(fine_s[::10], fine_v[::10]), fine_um[::10], atol=0.02)


def test_a_delay_shows_the_displacement_of_before() -> None:
    sharp, late = make_model(), make_model(delay_s=0.025)
    t_s = clock(400)
    u_v = 75.0 - 75.0 * np.cos(2.0 * np.pi * t_s)
    shifted_um = np.interp(t_s - 0.025, t_s, sharp.predict(t_s, u_v))
    np.testing.assert_allclose(late.predict(t_s, u_v), shifted_um, atol=1e-9)


def test_virgin_and_conditioned_part_by_half_the_loop_at_the_trough() -> None:
    model = make_model(hinges=1, plays=10, creep=0.0)
    back = np.array([0.0, 120.0, 0.0])
    y_um = model.predict(clock(3), back, ActuatorState.virgin(model))
    remnant_um = y_um[2] - y_um[0]
    settled = model.predict(clock(5), np.array([60.0, 120.0, 60.0, 0.0, 60.0]), ActuatorState.virgin(model))
    assert remnant_um >= 0.5 * (settled[2] - settled[4])


def test_conditioned_comes_from_the_end_that_the_first_move_leaves() -> None:
    model = make_model()
    t_s = clock(50)
    rising = model.starting_state(t_s, np.linspace(60.0, 150.0, 50))
    falling = model.starting_state(t_s, np.linspace(60.0, 0.0, 50))
    assert (rising.plays_v <= falling.plays_v).all()
    assert (rising.plays_v < falling.plays_v).any()


def test_a_jump_leaves_the_plays_where_it_dragged_them() -> None:
    model = make_model()
    state = ActuatorState.after_jump(model, 80.0, 20.0)
    expected_v = np.maximum(20.0 - model.thresholds_v, np.minimum(20.0 + model.thresholds_v, 80.0))
    np.testing.assert_allclose(state.plays_v, expected_v)
    assert state.u_v == 20.0


def test_no_loop_runs_on_a_state_of_another_model() -> None:
    model, other = make_model(plays=6), ActuatorState.conditioned(make_model(plays=4))
    t_s, u_v = clock(3), np.array([0.0, 1.0, 2.0])
    for use in (
        lambda: model.predict(t_s, u_v, other),
        lambda: Estimator(model, other),
        lambda: Inverse(model, other),
        lambda: model.advance(other, t_s, u_v),
    ):
        with pytest.raises(ValueError, match="a state of shape"):
            use()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"slopes_um_per_v": np.full((6, 3), -0.1)}, "slopes are not negative"),
        ({"slopes_um_per_v": np.zeros((6, 3))}, "positive slopes"),
        ({"thresholds_v": np.arange(1.0, 7.0)}, "thresholds ascend from 0"),
        ({"creep_um_per_v": np.full((2, 6), -0.1)}, "creep is not negative"),
        ({"slopes_um_per_v": np.ones((5, 3))}, "do not fit each other"),
        ({"zero_um": float("nan")}, "not finite"),
        ({"delay_s": -0.1}, "the delay is not negative"),
        ({"creep_plays": np.array([0, 9])}, "plays of the model"),
        ({"low_v": 150.0}, "low_v lies below high_v"),
    ],
)
def test_a_model_that_could_not_work_is_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(make_model(), **change)  # type: ignore[arg-type]


def test_creep_of_a_model_with_a_lag_is_that_behind_it() -> None:
    plain = make_model(creep=0.01)
    lagging = replace(plain, lag_s=0.005)
    assert lagging.gamma_per_decade == pytest.approx(plain.gamma_per_decade, rel=1e-12)
