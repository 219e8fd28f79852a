"""Rounded plays and the amplifier's lag: closed forms against their equations, and what a model promises."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from edmctl.actuator.inverse import Inverse
from edmctl.actuator.model import ActuatorModel, ActuatorState, Estimator, rounded_table
from edmctl.actuator.operators import place_of
from edmctl.core.library import library
from edmctl.procedures.servo.limits import stroke_left_um
from tests.actuator.models import Array, clock, driven, make_model, voltages


def rounded_model(
    limits_v: tuple[float, float] = (20.0, 28.0),
    sharpness: float = 0.5,
    unloading: float = 0.6,
    lag_s: float = 0.0,
) -> ActuatorModel:
    """A model with a rounded play that creeps, of half the slope."""
    plain = make_model(creep=0.01)
    return replace(
        plain,
        rounded_limits_v=np.array([limits_v]),
        rounded_sharpness=np.array([sharpness]),
        rounded_unloading=np.array([unloading]),
        rounded_um_per_v=np.array([0.5]),
        creep_plays=np.append(plain.creep_plays, 6),
        creep_um_per_v=np.vstack([plain.creep_um_per_v, plain.creep_um_per_v[:1]]),
        lag_s=lag_s,
    )


rounded_models = st.builds(
    rounded_model,
    limits_v=st.tuples(st.floats(1.0, 75.0), st.floats(1.0, 75.0)),
    sharpness=st.floats(0.0, 1.0),
    unloading=st.floats(0.0, 2.0),
    lag_s=st.sampled_from([0.0, 0.002, 0.02]),
)


def stop(row: Array, move_v: float, stop_v: float) -> float:
    """Where the stop of a rounded play is after a monotone move."""
    stops_v, turns_v = np.array([stop_v]), np.array([0.0, move_v])
    library().turned_stops(1, place_of(row), 2, place_of(turns_v), place_of(stops_v))
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
def test_a_stop_moves_as_its_equation_says(
    sharpness: float, unloading: float, move_v: float, stop_v: float
) -> None:
    row = rounded_table(np.array([[20.0, 28.0]]), np.array([sharpness]), np.array([unloading]))[0]
    assert stop(row, move_v, stop_v) == pytest.approx(integrated(row, move_v, stop_v), abs=1e-3)
    halves = stop(row, 0.5 * move_v, stop(row, 0.5 * move_v, stop_v))
    assert halves == pytest.approx(stop(row, move_v, stop_v), abs=1e-9)


@settings(max_examples=40, deadline=None)
@given(model=rounded_models, volts=voltages, more_v=st.floats(0.01, 20.0))
def test_displacement_rises_with_the_voltage_from_any_state(
    model: ActuatorModel, volts: list[float], more_v: float
) -> None:
    u_v = np.array(volts)
    t_s = clock(len(u_v))
    state = driven(model, t_s, u_v)
    after_s = t_s[-1:] + 0.01
    low_um, high_um = (
        model.advance(state.copy(), after_s, np.array([end_v]))[0] for end_v in (u_v[-1], u_v[-1] + more_v)
    )
    floor = float(model.slopes_um_per_v[0].min())
    passed = 1.0 if not model.lag_s else 1.0 + model.lag_s / 0.01 * math.expm1(-0.01 / model.lag_s)
    assert high_um - low_um >= 0.999 * floor * passed * more_v


@settings(max_examples=30, deadline=None)
@example(model=rounded_model((1.0, 21.0), 1.0, 1.0, 0.02), volts=[24.0, 0.0])  # steep: rounding is coarser
@given(model=rounded_models, volts=voltages)
def test_the_inverse_gives_back_the_voltage(model: ActuatorModel, volts: list[float]) -> None:
    u_v = np.array(volts)
    t_s = clock(len(u_v))
    start = ActuatorState.conditioned(model, float(u_v[0]))
    y_um = model.predict(t_s, u_v, start)
    found_v, beyond = Inverse(model, start).solve(t_s, y_um)
    again_um = model.predict(t_s, found_v, start)
    np.testing.assert_allclose(again_um, y_um, atol=1e-9)
    assert not beyond[1:].any()


def test_small_swings_let_a_rounded_play_slide_and_leave_a_sharp_one() -> None:
    model, t_s = rounded_model(), clock(4001)
    u_v = 75.0 + 4.0 * np.sin(0.5 * t_s * 2.0 * math.pi)
    start = ActuatorState.after_jump(replace(model, creep_um_per_v=0.0 * model.creep_um_per_v), 0.0, 75.0)
    at_middle = [0, 2000, 4000]
    creepless = replace(model, creep_um_per_v=0.0 * model.creep_um_per_v)
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


def test_ticks_come_to_what_a_batch_does() -> None:
    model, t_s = rounded_model(lag_s=0.004), clock(200)
    u_v = 60.0 + 55.0 * np.sin(9.0 * t_s)
    start = ActuatorState.conditioned(model, float(u_v[0]))
    ticking = Estimator(model, start)
    ticks_um = [ticking.tick(float(volts), 0.0 if k == 0 else 0.01) for k, volts in enumerate(u_v)]
    np.testing.assert_allclose(ticks_um, model.predict(t_s, u_v, start), rtol=1e-12)


@pytest.mark.parametrize(
    ("change", "words"),
    [
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
