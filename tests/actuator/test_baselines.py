"""The straight line and the paper's class of model, identified and judged like the actuator model itself."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from edmctl.actuator.fitting import nnls
from edmctl.actuator.identification import fit_line, fit_maxwell
from edmctl.actuator.model import ActuatorModel
from edmctl.actuator.paper_model import MaxwellModel
from edmctl.actuator.record import Record
from edmctl.actuator.waveforms import Waveform, sampled, sine, slow_legs, square
from tests.actuator.models import THRESHOLDS_V, default_model, play

Array = NDArray[np.float64]

ACTUATOR = default_model()


def measured(waveform: Waveform) -> Record:
    return Record(*waveform, ACTUATOR.predict(*waveform), name="default actuator")


CALIBRATION = measured(sampled(slow_legs(150.0), 50.0))
SLOW = measured(sine(0.0, 120.0, 0.01, 2, 20.0))


def test_a_straight_line_is_found_exactly_without_held_out_error() -> None:
    t_s, u_v = sine(0.0, 120.0, 0.1, 2, 100.0)
    line = fit_line([Record(t_s, u_v, 3.0 * u_v + 17.0)])
    assert np.abs(line.model.predict(t_s, u_v) - (3.0 * u_v + 17.0)).max() < 1e-3
    assert line.held_out.max_um < 1e-3

    slope, zero_um = np.polyfit(SLOW.u_v, SLOW.y_um, 1)
    predicted_um = fit_line([SLOW]).model.predict(SLOW.t_s, SLOW.u_v)
    assert predicted_um == pytest.approx(slope * SLOW.u_v + zero_um, abs=0.05)


def test_a_hysteresis_of_the_class_is_found_from_noise_free_data() -> None:
    hidden = fit_maxwell([SLOW]).model
    waveform = sampled(slow_legs(120.0), 50.0)
    found = fit_maxwell([Record(*waveform, hidden.predict(*waveform))])
    assert found.held_out.max_pct < 0.01


def test_the_paper_class_is_the_maxwell_slip_model() -> None:
    model = fit_maxwell([SLOW]).model
    maxwell = MaxwellModel.from_plays(model.thresholds_v, model.slopes_um_per_v[:, 0])
    t_s, u_v = sine(0.0, 120.0, 1.0, 2, 200.0)
    slip_um = maxwell.displacement(u_v)
    error_um = model.predict(t_s, u_v, model.starting_state(t_s, u_v, 0.0)) - slip_um
    assert np.ptp(error_um) < 1e-9


def test_a_memory_of_nothing_is_told_from_a_conditioned_one() -> None:
    model, t_s, u_v = fit_maxwell([SLOW]).model, SLOW.t_s, SLOW.u_v
    start_um = [model.predict(t_s, u_v, model.starting_state(t_s, u_v, before))[0] for before in (None, 0.0)]
    assert start_um[0] - start_um[1] == pytest.approx(38.0, abs=5.0)


def test_one_slow_cycle_leaves_the_errors_that_the_paper_tells_of() -> None:
    paper = fit_maxwell([SLOW])
    assert paper.train.max_um < 5.0
    last_cycle, rise = slice(-201, None), slice(0, 151)
    assert swing_error_um(paper.model, sine(0.0, 120.0, 1.0, 5, 200.0), last_cycle) == pytest.approx(
        18.2, abs=2.0
    )
    assert swing_error_um(paper.model, square(0.0, 120.0, 0.05, 1, 1000.0), rise) == pytest.approx(
        21.3, abs=3.0
    )


def test_a_better_class_is_better_on_blocks_it_has_not_seen() -> None:
    line, maxwell = fit_line([CALIBRATION]), fit_maxwell([CALIBRATION])
    assert maxwell.held_out.rms_um < 0.5 * line.held_out.rms_um
    assert maxwell.held_out.rms_um >= maxwell.train.rms_um


def test_baselines_have_neither_creep_nor_delay() -> None:
    for baseline in (fit_line([SLOW]), fit_maxwell([SLOW])):
        assert baseline.model.gamma_per_decade == 0.0
        assert baseline.model.delay_s == 0.0
    assert len(fit_maxwell([SLOW]).model.thresholds_v) == 10
    assert len(fit_line([SLOW]).model.thresholds_v) == 1


def swing_error_um(baseline: ActuatorModel, waveform: Waveform, part: slice) -> float:
    """How much farther the baseline moves than the actuator in part of a waveform."""
    predicted_um, true_um = baseline.predict(*waveform)[part], ACTUATOR.predict(*waveform)[part]
    return float(np.ptp(predicted_um) - np.ptp(true_um))


RATE_HZ = 10.0
CYCLE = 1000
SETTLED_CYCLES = 30


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


def test_a_creepless_model_fits_the_slow_cycle_and_without_memory_misses_the_trough() -> None:
    u_v, y_um = steady_cycle(120.0)
    assert np.abs(creepless().displacement(u_v, creepless().conditioned(0.0, 120.0)) - y_um).max() < 0.5
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
