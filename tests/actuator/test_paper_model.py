"""Plays and Maxwell slip are two faces of one hysteresis."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import accumulate

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from edmctl.actuator.identification import autocorrelation_time, lever_factor
from edmctl.actuator.paper_model import (
    TABLE_1,
    ElectromechanicalModel,
    MaxwellModel,
    Transducer,
)
from edmctl.actuator.waveforms import sine
from edmctl.errors import RecordError
from tests.actuator.models import play

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
def test_the_maxwell_form_moves_as_the_plays_and_inverts_them(bank: Plays, u_v: Array) -> None:
    model, path = MaxwellModel.from_plays(*bank), np.concatenate([[0.0], u_v])
    y_um = np.asarray(sum(w * play(path, r) for r, w in zip(*bank, strict=True)))
    state = model.virgin()
    parts_um = [model.displacement(part, state) for part in np.array_split(path, 3)]
    assert np.abs(np.concatenate(parts_um) - y_um).max() <= 1e-9
    assert np.abs(model.voltage(y_um) - path).max() <= 1e-9
    assert np.abs(model.displacement(model.voltage(u_v)) - u_v).max() <= 1e-9


def test_limits_are_the_initial_loading_curve() -> None:
    loading_um = MODEL.displacement(THRESHOLDS_V[1:])
    assert MODEL.limits_um == pytest.approx(loading_um, abs=1e-12)


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
        ([0, 1], [1]),
        ([1, 2], [1, 1]),
        ([0, 2, 2], [1, 1, 1]),
        ([0, 1], [0, 1]),
        ([0, 1], [1, -0.1]),
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
def test_other_numbers_are_refused(base: float, stiffness: list[float], limits: list[float]) -> None:
    with pytest.raises(ValueError, match="a Maxwell model needs"):
        MaxwellModel(base, np.array(stiffness), np.array(limits))


MAXWELL = MaxwellModel.from_plays(
    [0.0, 1.5, 4.0, 7.0, 10.0, 13.0, 16.0, 20.0, 24.0, 28.0, 40.0, 55.0],
    [1.2953, 0.5387, 0.1124, 0.1759, 0.1520, 0.1538, 0.1767, 0.2036, 0.1939, 0.2169, 0.0922, 0.1995],
)
ELECTRIC = ElectromechanicalModel.from_maxwell(MAXWELL)


def material_transformer_n_per_v(transducer: Transducer) -> float:
    """T from the material of Table 1, 2·n·d33·(k_p + k_a) with d33 = k33·√(ε33·s33)."""
    d33_m_per_v = 0.7 * math.sqrt(2900.0 * 8.8541878128e-12 * 2.22e-11)
    return 2.0 * 200 * d33_m_per_v * transducer.stiffness_n_per_m


def test_the_printed_transformer_ratio_follows_from_the_material() -> None:
    assert material_transformer_n_per_v(TABLE_1) == pytest.approx(13.95, abs=0.01)
    assert material_transformer_n_per_v(TABLE_1) == pytest.approx(TABLE_1.transformer_n_per_v, rel=0.004)


def test_the_printed_stiffnesses_would_need_another_transformer_ratio() -> None:
    soft_stack, soft_flexure = replace(TABLE_1, stack_n_per_m=6e6), replace(TABLE_1, flexure_n_per_m=6e3)
    assert material_transformer_n_per_v(soft_stack) < 0.2 * TABLE_1.transformer_n_per_v
    assert material_transformer_n_per_v(soft_flexure) == pytest.approx(12.7, abs=0.05)
    assert TABLE_1.transduction_v_per_um == pytest.approx(0.2619, rel=1e-3)
    assert TABLE_1.charge_c_per_m == pytest.approx(32.86, rel=1e-3)


def test_at_5_hz_only_the_quasi_static_motion_is_left() -> None:
    u_v = sine(0.0, 120.0, 5.0, 2, 20_000.0).u_v
    dynamic_um = ELECTRIC.simulate(u_v, 5e-5).y_um
    static_um = MAXWELL.displacement(u_v)
    assert np.ptp(static_um) == pytest.approx(383.0, abs=1.0)
    assert np.abs(dynamic_um - static_um).max() < 0.02


def test_a_ramp_of_100_us_overshoots_by_5_percent() -> None:
    u_v = 120.0 * np.minimum(np.arange(1, 4001) / 100.0, 1.0)
    y_um = ELECTRIC.simulate(u_v, 1e-6).y_um
    outside = np.abs(y_um - y_um[-1]) > 0.01 * y_um[-1]
    assert y_um.max() / y_um[-1] - 1.0 == pytest.approx(0.054, abs=0.003)
    assert np.flatnonzero(outside)[-1] == pytest.approx(210, abs=5)


turning_points = st.lists(st.floats(0.0, 150.0), min_size=1, max_size=12)


@given(turning_points, st.sampled_from([0.01, 0.1, 1.0]))
def test_coarse_steps_come_to_rest_where_the_maxwell_form_is(turns: list[float], step_s: float) -> None:
    ends = zip([0.0, *turns], turns, strict=False)
    slow_v = np.concatenate([np.linspace(first, last, 10) for first, last in ends])
    y_um = ELECTRIC.simulate(np.repeat(slow_v, 2), step_s).y_um
    assert y_um[-1] == pytest.approx(MAXWELL.displacement(np.array(turns))[-1], abs=0.02)


@given(st.lists(st.floats(0.0, 150.0), min_size=2, max_size=20).map(np.array))
def test_the_applied_voltage_is_shared_by_hysteresis_and_transducer(u_v: Array) -> None:
    state = ELECTRIC.virgin()
    response = ELECTRIC.simulate(u_v, 1e-5, state=state)
    block, part = ELECTRIC.block, ELECTRIC.transducer
    hysteresis_v = block.remainder_per_f * state.charge_c + (state.stops_c / block.capacitances_f).sum()
    assert hysteresis_v + response.transducer_v[-1] == pytest.approx(u_v[-1], abs=1e-9)
    assert state.charge_c == pytest.approx(
        part.transformer_n_per_v * state.position_m + part.capacitance_f * response.transducer_v[-1],
        abs=1e-15,
    )


def test_a_push_of_the_work_moves_the_tool_back_by_its_compliance() -> None:
    state = ELECTRIC.conditioned(0.0, 150.0)
    free = ELECTRIC.simulate(np.full(3, 100.0), 1.0, 0.0, state)
    pushed = ELECTRIC.simulate(np.full(3, 100.0), 1.0, 1.0, state)
    moved_um = pushed.y_um[-1] - free.y_um[-1]
    lost_v = pushed.transducer_v[-1] - free.transducer_v[-1]
    output_n_per_um = 1e-6 * TABLE_1.stiffness_n_per_m / TABLE_1.lever**2
    expected_um = -1.0 / output_n_per_um + lost_v / TABLE_1.transduction_v_per_um
    assert moved_um == pytest.approx(expected_um, abs=1e-6)
    assert -5.0 < moved_um < -2.0


def test_full_swings_leave_the_state_they_started_from() -> None:
    state = ELECTRIC.conditioned(0.0, 150.0)
    start = state.position_m
    ELECTRIC.simulate(np.array([150.0, 150.0, 0.0, 0.0]), 1.0, state=state)
    assert state.position_m == pytest.approx(start, abs=1e-12)


def test_one_run_is_the_same_in_parts() -> None:
    u_v = sine(0.0, 120.0, 1.0, 1, 1000.0).u_v
    whole = ELECTRIC.simulate(u_v, 1e-3).y_um
    state = ELECTRIC.virgin()
    parts = [ELECTRIC.simulate(part, 1e-3, state=state).y_um for part in np.split(u_v, [7, 300])]
    assert np.array_equal(np.concatenate(parts), whole)


STACK_UM = 12.0 * (1.0 - np.cos(np.linspace(0.0, 4.0 * np.pi, 2000)))


@given(st.floats(2.0, 60.0), st.floats(-100.0, 100.0))
def test_an_exact_lever_is_found_exactly(factor: float, offset_um: float) -> None:
    lever = lever_factor(STACK_UM, factor * STACK_UM + offset_um)
    assert lever.factor == pytest.approx(factor, rel=1e-9)
    assert lever.offset_um == pytest.approx(offset_um, abs=1e-6)
    assert lever.sd < 1e-9


def noise_um(rng: np.random.Generator, memory: float) -> Array:
    white = rng.normal(0.0, 0.3, len(STACK_UM))
    white[0] /= np.sqrt(1.0 - memory**2)
    return np.array(list(accumulate(white.tolist(), lambda last, value: memory * last + value)))


@pytest.mark.parametrize("memory", [0.0, 0.9], ids=["white", "correlated"])
def test_the_error_is_as_large_as_the_uncertainty_says(memory: float) -> None:
    rng = np.random.default_rng(18)
    ratios = []
    for _ in range(100):
        lever = lever_factor(STACK_UM, 18.0 * STACK_UM + 3.0 + noise_um(rng, memory))
        ratios.append((lever.factor - 18.0) / lever.sd)
    assert np.sqrt(np.mean(np.square(ratios))) == pytest.approx(1.0, abs=0.2)


def test_correlated_residuals_are_worth_fewer_samples() -> None:
    rng = np.random.default_rng(4)
    assert autocorrelation_time(noise_um(rng, 0.0)) == pytest.approx(1.0, abs=0.2)
    assert autocorrelation_time(noise_um(rng, 0.9)) == pytest.approx(19.0, rel=0.5)
    assert autocorrelation_time(np.zeros(100)) == 1.0


@pytest.mark.parametrize(
    ("x_um", "z_um", "code", "words"),
    [
        (STACK_UM, STACK_UM[:-1], "E3620", "2000 samples of the stacks' displacement, but 1999"),
        (STACK_UM[:9], STACK_UM[:9], "E3621", "9 samples are too few"),
        (np.where(np.arange(2000) == 6, np.nan, STACK_UM), 18 * STACK_UM, "E3622", "sample 7 "),
        (np.full(2000, 3.0), 18 * STACK_UM, "E3623", "stays at 3 µm"),
        (STACK_UM, -18 * STACK_UM, "E3624", "moves back"),
        (18 * STACK_UM, STACK_UM, "E3625", r"0\.0556 is not that of a flexure"),
        (STACK_UM / 1000.0, 18 * STACK_UM, "E3625", r"1\.8e\+04 is not"),
    ],
    ids=["lengths", "short", "nan", "still", "sign", "swapped", "units"],
)
def test_data_that_are_no_lever_are_named(x_um: Array, z_um: Array, code: str, words: str) -> None:
    with pytest.raises(RecordError, match=words) as refusal:
        lever_factor(x_um, z_um)
    assert refusal.value.code == code
    assert refusal.value.hint
