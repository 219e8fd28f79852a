"""The default actuator shows what the paper tells of its own (Muralidhara et al. 2009, §2, Figs 3 and 4)."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from edmctl.actuator.fitting import nnls
from edmctl.actuator.maxwell import MaxwellModel
from edmctl.actuator.waveforms import sine
from tests.actuator.apa400m import THRESHOLDS_V, WEIGHTS_UM_PER_V, default_model
from tests.actuator.truth import play

Array = NDArray[np.float64]

RATE_HZ = 10.0
CYCLE = 1000
SETTLED_CYCLES = 30
ACTUATOR = default_model()


@cache
def steady_cycle(high_v: float) -> tuple[Array, Array]:
    """Last of many 10 mHz cycles: voltage and displacement."""
    t_s, u_v = sine(0.0, high_v, 0.01, SETTLED_CYCLES, RATE_HZ)
    y_um = ACTUATOR.predict(t_s, u_v)
    return u_v[-CYCLE - 1 :], y_um[-CYCLE - 1 :]


@cache
def creepless() -> MaxwellModel:
    """Maxwell model of the steady 0–120 V loop, as the paper's would be identified."""
    u_v, y_um = steady_cycle(120.0)
    history_v = np.concatenate([[0.0, 120.0], u_v])
    bank = np.column_stack([play(history_v, threshold_v)[2:] for threshold_v in THRESHOLDS_V])
    return MaxwellModel.from_plays(THRESHOLDS_V, nnls(bank, y_um))


@pytest.mark.parametrize(("high_v", "stroke_um", "within_um"), [(150.0, 445.0, 1.0), (120.0, 345.0, 2.0)])
def test_stroke_of_the_steady_slow_cycle(high_v: float, stroke_um: float, within_um: float) -> None:
    assert np.ptp(steady_cycle(high_v)[1]) == pytest.approx(stroke_um, abs=within_um)


def test_the_loop_opens_by_15_percent() -> None:
    u_v, y_um = steady_cycle(120.0)
    middle = CYCLE // 2
    rising = np.interp(60.0, u_v[: middle + 1], y_um[: middle + 1])
    falling = np.interp(60.0, u_v[middle:][::-1], y_um[middle:][::-1])
    assert (falling - rising) / np.ptp(y_um) == pytest.approx(0.153, abs=0.005)


def test_a_creepless_model_fits_the_slow_cycle() -> None:
    u_v, y_um = steady_cycle(120.0)
    assert np.abs(creepless().displacement(u_v, creepless().conditioned(0.0, 120.0)) - y_um).max() < 0.5


def test_a_creepless_model_without_memory_misses_the_trough() -> None:
    u_v, y_um = steady_cycle(120.0)
    virgin_um = creepless().displacement(u_v)
    error_um = (virgin_um[-1] - virgin_um[0]) - (y_um[-1] - y_um[0])
    assert error_um == pytest.approx(38.0, abs=2.0)


def test_a_creepless_model_misses_the_crest_at_1_hz() -> None:
    t_s, u_v = sine(0.0, 120.0, 1.0, 10, 1000.0)
    y_um = ACTUATOR.predict(t_s, u_v)
    model_um = creepless().displacement(u_v, creepless().conditioned(0.0, 120.0))
    assert np.ptp(model_um[-1001:]) - np.ptp(y_um[-1001:]) == pytest.approx(18.2, abs=1.0)


def test_a_creepless_model_misses_a_step_until_the_creep_has_come() -> None:
    u_v = np.array([0.0, 120.0, 120.0, 120.0, 120.0])
    y_um = ACTUATOR.predict(np.array([0.0, 1e-9, 0.1, 1.0, 5.5]), u_v)
    model_um = creepless().displacement(u_v, creepless().conditioned(0.0, 120.0))
    error_um = (model_um - model_um[0]) - (y_um - y_um[0])
    assert error_um[2:].tolist() == pytest.approx([17.1, 8.0, 1.1], abs=1.0)


def test_the_step_response_creeps_by_3_percent_per_decade() -> None:
    t_s = np.array([0.0, 1e-9, 0.1, 10.0])
    y_um = ACTUATOR.predict(t_s, np.array([0.0, 120.0, 120.0, 120.0]))
    immediate_um = y_um[1] - y_um[0]
    assert (y_um[3] - y_um[2]) / immediate_um / 2.0 == pytest.approx(0.030, rel=0.02)


def test_all_creep_adds_its_shares() -> None:
    plays_um = np.dot(WEIGHTS_UM_PER_V, 150.0 - 2.0 * np.array(THRESHOLDS_V))
    t_s, u_v = np.array([0.0, 1.0, 1e6]), np.array([0.0, 150.0, 150.0])
    y_um = ACTUATOR.predict(t_s, u_v)
    assert y_um[2] - y_um[0] == pytest.approx(plays_um * (1.0 + 8 * 0.021), rel=1e-9)
