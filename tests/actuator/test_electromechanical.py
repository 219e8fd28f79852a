"""The paper's model: a consistent Table 1, and dynamics around the same hysteresis."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from edmctl.actuator.maxwell import TABLE_1, ElectromechanicalModel, MaxwellModel, Transducer
from edmctl.actuator.waveforms import sine

Array = NDArray[np.float64]

MAXWELL = MaxwellModel.from_plays(
    [0.0, 1.5, 4.0, 7.0, 10.0, 13.0, 16.0, 20.0, 24.0, 28.0, 40.0, 55.0],
    [1.2953, 0.5387, 0.1124, 0.1759, 0.1520, 0.1538, 0.1767, 0.2036, 0.1939, 0.2169, 0.0922, 0.1995],
)
MODEL = ElectromechanicalModel.from_maxwell(MAXWELL)


def material_transformer_n_per_v(transducer: Transducer) -> float:
    """T from the material of Table 1, 2·n·d33·(k_p + k_a) with d33 = k33·√(ε33·s33)."""
    d33_m_per_v = 0.7 * math.sqrt(2900.0 * 8.8541878128e-12 * 2.22e-11)
    return 2.0 * 200 * d33_m_per_v * transducer.stiffness_n_per_m


def test_the_printed_transformer_ratio_follows_from_the_material() -> None:
    assert material_transformer_n_per_v(TABLE_1) == pytest.approx(13.95, abs=0.01)
    assert material_transformer_n_per_v(TABLE_1) == pytest.approx(TABLE_1.transformer_n_per_v, rel=0.004)


def test_the_printed_stack_stiffness_would_need_another_transformer_ratio() -> None:
    printed = replace(TABLE_1, stack_n_per_m=6e6)
    assert material_transformer_n_per_v(printed) < 0.2 * printed.transformer_n_per_v


def test_the_printed_flexure_stiffness_would_need_another_transformer_ratio() -> None:
    printed = replace(TABLE_1, flexure_n_per_m=6e3)
    assert material_transformer_n_per_v(printed) == pytest.approx(12.7, abs=0.05)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("transduction_v_per_um", 0.2619),
        ("charge_c_per_m", 32.86),
    ],
)
def test_what_follows_from_table_1(name: str, value: float) -> None:
    assert getattr(TABLE_1, name) == pytest.approx(value, rel=1e-3)


def test_at_5_hz_only_the_quasi_static_motion_is_left() -> None:
    u_v = sine(0.0, 120.0, 5.0, 2, 20_000.0).u_v
    dynamic_um = MODEL.simulate(u_v, 5e-5).y_um
    static_um = MAXWELL.displacement(u_v)
    assert np.ptp(static_um) == pytest.approx(383.0, abs=1.0)
    assert np.abs(dynamic_um - static_um).max() < 0.02


def test_a_ramp_of_100_us_overshoots_by_5_percent() -> None:
    u_v = 120.0 * np.minimum(np.arange(1, 4001) / 100.0, 1.0)
    y_um = MODEL.simulate(u_v, 1e-6).y_um
    outside = np.abs(y_um - y_um[-1]) > 0.01 * y_um[-1]
    assert y_um.max() / y_um[-1] - 1.0 == pytest.approx(0.054, abs=0.003)
    assert np.flatnonzero(outside)[-1] == pytest.approx(210, abs=5)


def test_half_the_step_leaves_a_quarter_of_the_error() -> None:
    def swing_um(every: int) -> Array:
        u_v = sine(0.0, 100.0, 2500.0, 2, 2e6).u_v[every::every]
        return MODEL.simulate(u_v, every * 5e-7).y_um[32 // every - 1 :: 32 // every]

    fine_um = swing_um(1)
    errors_um = [float(np.abs(swing_um(every) - fine_um).max()) for every in (32, 16, 8)]
    assert errors_um[1] < 0.3 * errors_um[0]
    assert errors_um[2] < 0.3 * errors_um[1]


@given(st.lists(st.floats(0.0, 150.0), min_size=1, max_size=12), st.sampled_from([0.01, 0.1, 1.0]))
def test_coarse_steps_come_to_rest_where_the_maxwell_form_is(turns: list[float], step_s: float) -> None:
    y_um = MODEL.simulate(np.repeat(slow_path(turns), 2), step_s).y_um
    assert y_um[-1] == pytest.approx(MAXWELL.displacement(np.array(turns))[-1], abs=0.02)


@given(st.lists(st.floats(0.0, 150.0), min_size=1, max_size=12), st.sampled_from([1e-6, 1e-5, 1e-4]))
def test_fine_steps_come_to_rest_too(turns: list[float], step_s: float) -> None:
    held = np.full(round(0.01 / step_s), turns[-1])
    y_um = MODEL.simulate(np.concatenate([turns, held]), step_s).y_um
    assert np.abs(np.diff(y_um[-20:])).max() < 1e-6


@given(st.lists(st.floats(0.0, 150.0), min_size=2, max_size=20).map(np.array))
def test_the_applied_voltage_is_shared_by_hysteresis_and_transducer(u_v: Array) -> None:
    state = MODEL.virgin()
    response = MODEL.simulate(u_v, 1e-5, state=state)
    block, part = MODEL.block, MODEL.transducer
    hysteresis_v = block.remainder_per_f * state.charge_c + (state.stops_c / block.capacitances_f).sum()
    assert hysteresis_v + response.transducer_v[-1] == pytest.approx(u_v[-1], abs=1e-9)
    assert state.charge_c == pytest.approx(
        part.transformer_n_per_v * state.position_m + part.capacitance_f * response.transducer_v[-1],
        abs=1e-15,
    )


def test_a_push_of_the_work_moves_the_tool_back_by_its_compliance() -> None:
    state = MODEL.conditioned(0.0, 150.0)
    free = MODEL.simulate(np.full(3, 100.0), 1.0, 0.0, state)
    pushed = MODEL.simulate(np.full(3, 100.0), 1.0, 1.0, state)
    moved_um = pushed.y_um[-1] - free.y_um[-1]
    lost_v = pushed.transducer_v[-1] - free.transducer_v[-1]
    output_n_per_um = 1e-6 * TABLE_1.stiffness_n_per_m / TABLE_1.lever**2
    expected_um = -1.0 / output_n_per_um + lost_v / TABLE_1.transduction_v_per_um
    assert moved_um == pytest.approx(expected_um, abs=1e-6)
    assert -5.0 < moved_um < -2.0


def test_full_swings_leave_the_state_they_started_from() -> None:
    state = MODEL.conditioned(0.0, 150.0)
    start = state.position_m
    MODEL.simulate(np.array([150.0, 150.0, 0.0, 0.0]), 1.0, state=state)
    assert state.position_m == pytest.approx(start, abs=1e-12)


def test_one_run_is_the_same_in_parts() -> None:
    u_v = sine(0.0, 120.0, 1.0, 1, 1000.0).u_v
    whole = MODEL.simulate(u_v, 1e-3).y_um
    state = MODEL.virgin()
    parts = [MODEL.simulate(part, 1e-3, state=state).y_um for part in np.split(u_v, [7, 300])]
    assert np.array_equal(np.concatenate(parts), whole)


def slow_path(turns: list[float]) -> Array:
    """Straight lines from 0 V through turning points, ten samples each."""
    ends = zip([0.0, *turns], turns, strict=False)
    return np.concatenate([np.linspace(first, last, 10) for first, last in ends])
