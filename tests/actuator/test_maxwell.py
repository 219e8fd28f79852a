"""Plays and Maxwell slip are two faces of one hysteresis."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from edmctl.actuator.maxwell import TABLE_1, MaxwellModel
from tests.actuator.truth import play

Array = NDArray[np.float64]
Plays = tuple[Array, Array]

THRESHOLDS_V = np.array([0.0, 2.0, 9.0, 25.0, 50.0])
WEIGHTS = np.array([1.5, 0.3, 0.4, 0.0, 0.2])
MODEL = MaxwellModel.from_plays(THRESHOLDS_V, WEIGHTS)

histories = st.lists(st.floats(-150.0, 150.0), min_size=1, max_size=40).map(np.array)


@st.composite
def plays(draw: st.DrawFn) -> Plays:
    count = draw(st.integers(0, 10))
    gaps = draw(st.lists(st.floats(0.5, 15.0), min_size=count, max_size=count))
    weights = draw(st.lists(st.floats(0.0, 2.0), min_size=count, max_size=count))
    return np.cumsum([0.0, *gaps]), np.array([draw(st.floats(0.2, 3.0)), *weights])


@given(plays(), histories)
def test_the_maxwell_form_inverts_the_plays(bank: Plays, u_v: Array) -> None:
    thresholds_v, weights = bank
    path = np.concatenate([[0.0], u_v])
    y_um = sum(w * play(path, r) for r, w in zip(thresholds_v, weights, strict=True))
    back_v = MaxwellModel.from_plays(*bank).voltage(np.asarray(y_um))
    assert np.abs(back_v - path).max() <= 1e-9


@given(plays(), histories)
def test_the_maxwell_form_moves_as_the_plays(bank: Plays, u_v: Array) -> None:
    path = np.concatenate([[0.0], u_v])
    y_um = sum(w * play(path, r) for r, w in zip(*bank, strict=True))
    assert np.abs(MaxwellModel.from_plays(*bank).displacement(path) - y_um).max() <= 1e-9


@given(plays(), histories)
def test_a_displacement_is_reached_by_the_voltage_for_it(bank: Plays, y_um: Array) -> None:
    model = MaxwellModel.from_plays(*bank)
    assert np.abs(model.displacement(model.voltage(y_um)) - y_um).max() <= 1e-9


def test_limits_are_the_initial_loading_curve() -> None:
    loading_um = MODEL.displacement(THRESHOLDS_V[1:])
    assert MODEL.limits_um == pytest.approx(loading_um, abs=1e-12)


@given(histories, st.integers(2, 9))
def test_only_turning_points_matter(u_v: Array, parts: int) -> None:
    path = np.concatenate([[0.0], u_v])
    fine = np.interp(np.arange(parts * (len(path) - 1) + 1) / parts, np.arange(len(path)), path)
    assert np.abs(MODEL.displacement(fine)[::parts] - MODEL.displacement(path)).max() <= 1e-9


@given(histories, st.floats(0.0, 150.0), st.floats(0.0, 150.0))
def test_a_closed_minor_loop_is_wiped_out(u_v: Array, first_v: float, second_v: float) -> None:
    state = MODEL.virgin()
    MODEL.displacement(u_v, state)
    low_v, high_v = sorted((first_v, second_v))
    opened_um = MODEL.displacement(np.array([high_v, low_v, high_v]), state)
    stops_um = state.stops_um.copy()
    closed_um = MODEL.displacement(np.array([low_v, high_v]), state)
    assert closed_um[-1] == pytest.approx(opened_um[-1], abs=1e-9)
    assert state.stops_um == pytest.approx(stops_um, abs=1e-9)


@given(st.floats(0.0, 100.0), st.floats(0.0, 100.0), st.floats(1.0, 50.0))
def test_minor_loops_of_one_size_are_the_same_everywhere(
    bias_v: float, other_v: float, span_v: float
) -> None:
    shapes = []
    for low_v in (bias_v, other_v):
        state = MODEL.virgin()
        turns = np.array([low_v, low_v + span_v, low_v])
        MODEL.displacement(turns, state)
        path = np.linspace(low_v, low_v + span_v, 20)
        loop_um = MODEL.displacement(np.concatenate([path, path[::-1]]), state)
        shapes.append(loop_um - loop_um[0])
    assert np.abs(shapes[0] - shapes[1]).max() <= 1e-9


@given(histories, st.floats(-150.0, 150.0), st.floats(0.0, 50.0))
def test_more_voltage_never_means_less_displacement(u_v: Array, end_v: float, more_v: float) -> None:
    lower = MODEL.displacement(np.append(u_v, end_v))[-1]
    higher = MODEL.displacement(np.append(u_v, end_v + more_v))[-1]
    assert higher - lower >= 1.5 * more_v - 1e-9


def test_a_conditioned_model_comes_back_to_where_it_started() -> None:
    state = MODEL.conditioned(0.0, 120.0)
    start_um = state.position_um
    remnant_um = WEIGHTS @ np.minimum(THRESHOLDS_V, 120.0 - THRESHOLDS_V)
    assert start_um == pytest.approx(remnant_um)
    assert MODEL.displacement(np.array([120.0, 0.0]), state)[-1] == pytest.approx(start_um, abs=1e-12)


def test_the_block_h_holds_the_same_elements_in_electrical_units() -> None:
    model = MaxwellModel.from_plays(THRESHOLDS_V, WEIGHTS)
    block = model.block(TABLE_1.charge_c_per_m, TABLE_1.transduction_v_per_um, TABLE_1.lever)
    used = model.stiffness_v_per_um > 0.0
    coulomb_per_um = TABLE_1.charge_c_per_m / (TABLE_1.lever * 1e6)
    assert block.limits_v == pytest.approx((model.stiffness_v_per_um * model.limits_um)[used])
    assert block.capacitances_f * model.stiffness_v_per_um[used] == pytest.approx(coulomb_per_um)
    rest_v_per_um = block.remainder_per_f * coulomb_per_um
    assert rest_v_per_um + TABLE_1.transduction_v_per_um == pytest.approx(model.base_v_per_um)


def test_a_model_softer_than_the_transducer_is_refused_with_both_stiffnesses() -> None:
    soft = MaxwellModel.from_plays([0.0, 5.0], [3.0, 1.5])
    with pytest.raises(ValueError, match=r"0\.2222 V/µm, less than the transducer's 0\.2619 V/µm"):
        soft.block(TABLE_1.charge_c_per_m, TABLE_1.transduction_v_per_um, TABLE_1.lever)


@pytest.mark.parametrize(
    ("thresholds_v", "weights"),
    [
        ([0.0, 1.0], [1.0]),
        ([1.0, 2.0], [1.0, 1.0]),
        ([0.0, 2.0, 2.0], [1.0, 1.0, 1.0]),
        ([0.0, 1.0], [0.0, 1.0]),
        ([0.0, 1.0], [1.0, -0.1]),
        ([], []),
    ],
)
def test_plays_that_have_no_inverse_are_refused(thresholds_v: list[float], weights: list[float]) -> None:
    with pytest.raises(ValueError, match=r"plays|thresholds|weights"):
        MaxwellModel.from_plays(thresholds_v, weights)


@pytest.mark.parametrize(
    ("base", "stiffness", "limits"),
    [(0.0, [1.0], [1.0]), (1.0, [-1.0], [1.0]), (1.0, [1.0, 1.0], [2.0, 1.0]), (1.0, [1.0], [1.0, 2.0])],
)
def test_numbers_that_are_no_maxwell_model_are_refused(
    base: float, stiffness: list[float], limits: list[float]
) -> None:
    with pytest.raises(ValueError, match="a Maxwell model needs"):
        MaxwellModel(base, np.array(stiffness), np.array(limits))
