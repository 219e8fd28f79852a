"""Rounded plays and the amplifier's lag: closed forms against their equations, and what a model promises."""

from __future__ import annotations

import copy
import gc
import math
import pickle
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edmctl.actuator.inverse import Inverse
from edmctl.actuator.model import ActuatorModel, ActuatorState, Bank, Estimator, address_of, rounded_table
from edmctl.actuator.paper_model import ElectromechanicalModel, MaxwellModel, MaxwellState
from edmctl.core.library import library
from edmctl.procedures.servo.limits import stroke_left_um
from tests.actuator.models import (
    HIGH_V,
    LOW_V,
    Array,
    clock,
    driven,
    make_model,
    models,
    rounded_model,
    rounded_models,
    voltages,
)


@given(models, voltages, st.integers(2, 9))
@settings(max_examples=60, deadline=None)
def test_creepless_models_know_only_turns(model: ActuatorModel, turns: list[float], pieces: int) -> None:
    model = replace(model, creep_um_per_v=np.zeros_like(model.creep_um_per_v))
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
    model = replace(model, creep_um_per_v=np.zeros_like(model.creep_um_per_v))
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


@given(models | rounded_models, voltages, st.floats(LOW_V, HIGH_V), st.floats(0.0, 50.0))
@settings(max_examples=100, deadline=None)
def test_displacement_rises(model: ActuatorModel, history: list[float], u_v: float, more_v: float) -> None:
    state = driven(model, clock(len(history)), np.array(history))
    at = np.array([state.t_s + 0.01])
    low_um, high_um = (model.predict(at, np.array([end_v]), state)[0] for end_v in (u_v, u_v + more_v))
    passed = 1.0 if not model.lag_s else 1.0 + model.lag_s / 0.01 * math.expm1(-0.01 / model.lag_s)
    assert high_um - low_um >= 0.999 * model.slopes_um_per_v[0].min() * passed * more_v - 1e-9


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
    y_um = model.predict(clock(3), np.array([0.0, 120.0, 0.0]), ActuatorState.virgin(model))
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


def test_creep_of_a_model_with_a_lag_is_that_behind_it() -> None:
    plain = make_model(creep=0.01)
    lagging = replace(plain, lag_s=0.005)
    assert lagging.gamma_per_decade == pytest.approx(plain.gamma_per_decade, rel=1e-12)


def stop(row: Array, move_v: float, stop_v: float) -> float:
    """Where the stop of a rounded play is after a monotone move."""
    stops_v, turns_v = np.array([stop_v]), np.array([0.0, move_v])
    library().turned_stops(1, address_of(row), 2, address_of(turns_v), address_of(stops_v))
    return float(stops_v[0])


def integrated(row: Array, move_v: float, stop_v: float) -> float:
    """The same stop by small steps of its equation (midpoint)."""
    limit = row[0] if move_v > 0.0 else -row[1]
    c, unloading = row[2], row[3]

    def slope(at: float) -> float:
        if at >= 0.0:
            return float((1.0 - at) * (1.0 + c * at))
        return float(1.0 + unloading * ((1.0 - c) * abs(at) + c * at * at))

    at, steps = stop_v / limit, 20_000
    width = move_v / limit / steps
    for _ in range(steps):
        at += width * slope(at + 0.5 * width * slope(at))
    return float(limit * at)


@pytest.mark.parametrize("sharpness", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("unloading", [0.0, 0.2, 1.7])
@pytest.mark.parametrize(("move_v", "stop_v"), [(60.0, -25.0), (-50.0, 18.0), (3.0, -19.0), (7.0, 5.0)])
def test_a_stop_obeys_its_equation(sharpness: float, unloading: float, move_v: float, stop_v: float) -> None:
    row = rounded_table(np.array([[20.0, 28.0]]), np.array([sharpness]), np.array([unloading]))[0]
    assert stop(row, move_v, stop_v) == pytest.approx(integrated(row, move_v, stop_v), abs=1e-3)
    halves = stop(row, 0.5 * move_v, stop(row, 0.5 * move_v, stop_v))
    assert halves == pytest.approx(stop(row, move_v, stop_v), abs=1e-9)


def test_small_swings_let_a_rounded_play_slide_and_leave_a_sharp_one() -> None:
    model, t_s, at_middle = rounded_model(), clock(4001), [0, 2000, 4000]
    u_v = 75.0 + 4.0 * np.sin(0.5 * t_s * 2.0 * math.pi)
    creepless = replace(model, creep_um_per_v=0.0 * model.creep_um_per_v)
    start = ActuatorState.after_jump(creepless, 0.0, 75.0)
    slid_um = np.diff(creepless.predict(t_s, u_v, start)[at_middle])
    sharp = replace(creepless, rounded_um_per_v=np.zeros(1))
    assert abs(slid_um[0]) > 1.0
    assert abs(np.diff(sharp.predict(t_s, u_v, start)[at_middle])[1]) < 1e-9


def test_a_lag_turns_where_it_crosses_the_voltage() -> None:
    model = rounded_model(lag_s=0.03)
    coarse_s = np.array([0.0, 0.1, 0.2, 0.35])
    coarse_v = np.array([20.0, 90.0, 40.0, 60.0])
    fine_s = np.linspace(0.0, 0.35, 35_001)
    fine_v = np.interp(fine_s, coarse_s, coarse_v)
    start = ActuatorState.after_jump(model, 0.0, 20.0)
    whole_um = model.predict(coarse_s, coarse_v, start)
    fine_um = model.predict(fine_s, fine_v, start)
    np.testing.assert_allclose(whole_um[1:], np.interp(coarse_s[1:], fine_s, fine_um), rtol=3e-3)
    late = fine_v[0] + np.zeros(len(fine_s))
    for k in range(1, len(fine_s)):
        late[k] = late[k - 1] + 1e-5 / 0.03 * (fine_v[k - 1] - late[k - 1])
    lagless = replace(model, lag_s=0.0)
    np.testing.assert_allclose(lagless.predict(fine_s, late, start)[-1], whole_um[-1], rtol=1e-3)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"slopes_um_per_v": np.full((6, 3), -0.1)}, "slopes are not negative"),
        ({"slopes_um_per_v": np.zeros((6, 3))}, "positive slopes"),
        ({"thresholds_v": np.arange(1.0, 7.0)}, "thresholds ascend from 0"),
        ({"creep_um_per_v": np.full((3, 6), -0.1)}, "creep is not negative"),
        ({"slopes_um_per_v": np.ones((5, 3))}, "do not fit each other"),
        ({"zero_um": float("nan")}, "not finite"),
        ({"delay_s": -0.1}, "the delay is not negative"),
        ({"creep_plays": np.array([0, 9, 6])}, "plays of the model"),
        ({"low_v": 150.0}, "low_v lies below high_v"),
        ({"rounded_limits_v": np.array([[0.0, 5.0]])}, "limits"),
        ({"rounded_sharpness": np.array([1.2])}, "sharpness"),
        ({"rounded_um_per_v": np.array([-0.1])}, "rounded"),
        ({"rounded_unloading": np.zeros(2)}, "do not fit"),
        ({"lag_s": -0.001}, "lag"),
        ({"lag_s": math.nan}, "finite"),
    ],
)
def test_what_could_not_be_inverted_is_refused(change: dict[str, object], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        replace(rounded_model(), **change)  # type: ignore[arg-type]


@pytest.mark.parametrize("lag_s", [0.0, 0.0009, 0.03])
def test_the_stroke_that_is_left_is_that_behind_the_lag(lag_s: float) -> None:
    model = make_model()
    ways_um = []
    for one in (model, replace(model, lag_s=lag_s)):
        estimator = Estimator(one)
        estimator.advance(clock(400), np.linspace(0.0, 90.0, 400))
        estimator.advance(clock(400) + 4.0, np.full(400, 90.0))
        ways_um.append(stroke_left_um(estimator, 120.0))
    assert ways_um[0] > 10.0
    assert ways_um[1] == pytest.approx(ways_um[0], rel=1e-3)


T_S = clock(50)
U_V: Array = 60.0 + 50.0 * np.sin(9.0 * T_S)


def predicted(model: ActuatorModel) -> Array:
    return model.predict(T_S, U_V, ActuatorState.conditioned(model, 60.0))


@pytest.mark.parametrize("change", ["cut", "float32", "fortran", "read only"])
def test_c_writes_only_arrays_that_are_the_state_s(change: str) -> None:
    model = make_model()
    state = ActuatorState.conditioned(model)
    wide = np.zeros((2, 12))
    lags: dict[str, Any] = {
        "cut": state.lags_v[:, :-1],
        "float32": state.lags_v.astype(np.float32),
        "fortran": np.asfortranarray(state.lags_v),
        "read only": np.broadcast_to(wide[:, :6], (2, 6)),
    }
    state.lags_v = lags[change]
    for call in (model.advance, lambda state, *record: Inverse(model, state).solve(*record)):
        with pytest.raises(ValueError, match="state"):
            call(state, T_S, U_V)
    with pytest.raises(ValueError, match="state"):
        Estimator(model, state)
    assert not wide.any()
    assert state.t_s == 0.0


def test_parameters_may_lie_in_memory_as_they_like() -> None:
    model = make_model()
    scattered = replace(
        model,
        slopes_um_per_v=np.asfortranarray(model.slopes_um_per_v),
        knots_v=np.repeat(model.knots_v, 2, axis=1)[:, ::2],
        creep_um_per_v=np.asfortranarray(model.creep_um_per_v),
        creep_plays=model.creep_plays.astype(np.int32),
        time_constants_s=np.repeat(model.time_constants_s, 3)[::3],
    )
    np.testing.assert_array_equal(predicted(scattered), predicted(model))
    state = ActuatorState.conditioned(model, 60.0)
    both = np.column_stack([T_S, U_V])
    np.testing.assert_array_equal(model.predict(both[:, 0], both[:, 1], state), predicted(model))


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))])
def test_a_copy_of_a_model_in_use_has_arrays_of_its_own(copied: object) -> None:
    model = make_model()
    expected = predicted(model)
    other = copied(model)  # type: ignore[operator]
    del model
    gc.collect()
    np.testing.assert_array_equal(predicted(other), expected)


def test_a_bank_has_no_creep_behind_a_play_that_it_has_not() -> None:
    one, rounded = np.ones(1), (np.empty((0, 5)), np.empty(0))
    with pytest.raises(ValueError, match="fit"):
        Bank(one, np.ones((1, 2)), np.ones((1, 1)), *rounded, np.array([1]), one, np.ones((1, 1)), 0.0)


def test_elements_of_another_model_are_refused() -> None:
    maxwell = MaxwellModel.from_plays([0.0, 10.0, 20.0], [0.1, 0.1, 0.1])
    with pytest.raises(ValueError, match="2 elements"):
        maxwell.voltage(U_V, MaxwellState(0.0, np.zeros(1)))
    electromechanical = ElectromechanicalModel.from_maxwell(maxwell)
    state = replace(electromechanical.virgin(), stops_c=np.zeros(3))
    with pytest.raises(ValueError, match="2 elements"):
        electromechanical.simulate(U_V, 0.01, state=state)
