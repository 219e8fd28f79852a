"""How well displacement follows from voltage."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from edmctl.actuator.estimator import (
    PLAYS,
    DisplacementEstimator,
    IdentificationResult,
    PlayEstimator,
    identify_play_model,
)
from edmctl.actuator.operators import BankState, advance_bank
from tests.actuator.truth import (
    NOISE_UM,
    STROKE_UM,
    Array,
    clock,
    conditioning,
    job,
    ramps,
    true_displacement,
)


@cache
def true_record_and_job() -> tuple[Array, Array, Array, int]:
    """Times, volts, true displacement of conditioning and job, and where the job begins."""
    record_v = conditioning()
    actuator_v = np.concatenate([record_v, job()])
    return clock(len(actuator_v)), actuator_v, true_displacement(actuator_v), len(record_v)


def identified(seed: int = 1) -> IdentificationResult:
    time_s, actuator_v, truth_um, end = true_record_and_job()
    noise_um = np.random.default_rng(seed).normal(0.0, NOISE_UM, end)
    return identify_play_model(time_s[:end], actuator_v[:end], truth_um[:end] + noise_um)


def job_error_um(model: DisplacementEstimator, block: int = 10) -> Array:
    time_s, actuator_v, truth_um, end = true_record_and_job()
    estimate_um = [
        model.advance(time_s[k : k + block], actuator_v[k : k + block])
        for k in range(end, len(time_s), block)
    ]
    return np.concatenate(estimate_um) - truth_um[end:]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_job_is_followed_within_one_percent_of_the_stroke(seed: int) -> None:
    error_um = job_error_um(identified(seed).model)
    assert np.abs(error_um).max() <= 0.010 * STROKE_UM
    assert np.sqrt(np.mean(error_um**2)) <= 0.004 * STROKE_UM


def test_a_straight_line_would_be_ten_times_worse() -> None:
    _, actuator_v, truth_um, end = true_record_and_job()
    line_um = np.polyval(np.polyfit(actuator_v[:end], truth_um[:end], 1), actuator_v[end:])
    line_rms_um = np.sqrt(np.mean((line_um - truth_um[end:]) ** 2))
    model_rms_um = np.sqrt(np.mean(job_error_um(identified().model) ** 2))
    assert line_rms_um > 10.0 * model_rms_um


def test_creep_and_memory_both_earn_their_place() -> None:
    forgetful, creepless = identified().model, identified().model
    forgetful.state = BankState.at_rest(forgetful.shape, 0.0, forgetful.state.time_s)
    creepless.weights_um_per_v[PLAYS:] = 0.0
    good_um = np.abs(job_error_um(identified().model)).max()
    assert np.abs(job_error_um(forgetful)).max() > 3.0 * good_um
    assert np.abs(job_error_um(creepless)).max() > 3.0 * good_um


def test_the_reported_residual_is_that_of_the_record() -> None:
    result = identified()
    assert NOISE_UM < result.rms_um < 4.0 * NOISE_UM
    assert result.rms_um < result.max_um < 2.0


def test_noise_free_data_of_the_class_are_recovered() -> None:
    teacher = identified().model
    record_v = conditioning()
    after_v = ramps((0.0, 3.0), (90.0, 20.0), (40.0, 5.0), (120.0, 10.0))
    time_s = clock(len(record_v) + len(after_v))
    end = len(record_v)
    teacher.state = BankState.at_rest(teacher.shape, float(record_v[0]), 0.0)
    truth_um = teacher.advance(time_s, np.concatenate([record_v, after_v]))
    result = identify_play_model(time_s[:end], record_v, truth_um[:end])
    error_um = result.model.advance(time_s[end:], after_v) - truth_um[end:]
    assert result.max_um < 1e-6 * STROKE_UM
    assert np.abs(error_um).max() < 1e-6 * STROKE_UM


def test_the_state_goes_on_from_the_end_of_the_record() -> None:
    time_s, actuator_v, truth_um, end = true_record_and_job()
    model = identified().model
    first_um = model.advance(time_s[end : end + 1], actuator_v[end : end + 1])
    assert first_um[0] == pytest.approx(truth_um[end - 1], abs=1.0)
    assert model.state.time_s == time_s[end]


def test_the_size_of_blocks_leaves_no_trace() -> None:
    np.testing.assert_array_equal(
        job_error_um(identified().model, 10), job_error_um(identified().model, 10_000)
    )


def test_plain_python_gives_the_same_displacement() -> None:
    compiled, plain = identified().model, identified().model
    plain.kernel = advance_bank
    time_s, actuator_v, _, end = true_record_and_job()
    part = slice(end, end + 3000)
    np.testing.assert_array_equal(
        plain.advance(time_s[part], actuator_v[part]), compiled.advance(time_s[part], actuator_v[part])
    )


def test_more_voltage_means_more_displacement() -> None:
    model = identified().model
    assert (model.weights_um_per_v >= 0.0).all()
    assert model.weights_um_per_v[0] > 0.5


def test_an_empty_block_changes_nothing() -> None:
    model = identified().model
    before = model.state.copy()
    assert model.advance(np.empty(0), np.empty(0)).shape == (0,)
    assert model.state.time_s == before.time_s


def test_what_came_before_the_record_does_not_matter() -> None:
    """Before its first maximum the record is not fitted, so an unknown history costs nothing."""
    history_v = ramps((130.0, 1.0), (0.0, 1.0))
    record_v = conditioning()
    truth_um = true_displacement(np.concatenate([history_v, record_v]))[len(history_v) :]
    assert identify_play_model(clock(len(record_v)), record_v, truth_um).rms_um < 1.0


@pytest.mark.parametrize(
    ("actuator_v", "complaint"),
    [(np.full(500, 20.0), "does not change"), (np.linspace(0.0, 150.0, 500), "after the first maximum")],
)
def test_a_record_that_shows_nothing_is_refused(actuator_v: Array, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        identify_play_model(clock(500), actuator_v, actuator_v * 3.0)


def test_an_estimator_is_what_the_port_asks_for() -> None:
    model: DisplacementEstimator = identified().model
    assert isinstance(model, PlayEstimator)
