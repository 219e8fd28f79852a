from typing import Any

import numpy as np
import pytest

from edmctl.actuator import waveforms as waves
from edmctl.actuator.fitting import choose_design
from edmctl.actuator.identification import fit_maxwell, identify
from edmctl.actuator.model import ActuatorModel, ActuatorState, Estimator
from edmctl.actuator.quick import identify_quick
from edmctl.actuator.record import Record
from edmctl.actuator.validation import judge, validate
from edmctl.simulator.plant import VirtualActuator
from tests.actuator.models import Array, clock, default_model, make_model, play
from tests.tiers import tiers

STROKE_SHARE_MAX, STROKE_SHARE_RMS = 0.010, 0.003


def calibration_record(seed: int, every_ms: int = 5) -> Record:
    """The slow legs of a calibration of a virtual actuator, through its sensor: they are soon fitted."""
    wave = waves.sampled(waves.slow_legs(150.0), 1000.0)
    driven = VirtualActuator(seed).drive(wave.u_v)
    every = slice(None, None, every_ms)
    return Record(wave.t_s[every], driven.applied_v[every], driven.sensor_um[every], name="calibration")


def fan_record(frequency_hz: float) -> Record:
    """Swings from 0 V up and ever less far back, of a quick virtual stage: off-grid plays, lag, asymmetry."""
    from scipy.signal import lfilter

    turns = [0.0]
    for k in range(1, 9):
        turns += [10.0, 10.0 * (1.0 - k / 8.0)]
    edges_s = np.cumsum([0.0, *np.abs(np.diff(turns)) / 20.0 / frequency_hz])
    t_s = clock(round(edges_s[-1] * 5000.0), 1.0 / 5000.0)
    u_v = np.interp(t_s, edges_s, turns)
    y_um = np.zeros(len(t_s))
    for k in range(30):
        r_v = 5.0 * ((k + 0.37) / 30.0) ** 1.35
        y_um += (5.5 if k == 0 else 0.3 * np.exp(-r_v / 2.0)) * play(u_v, r_v)
    y_um += 2.0 * np.tanh((y_um - 50.0) / 30.0)
    crept_um = np.zeros(len(t_s))
    for k in range(8):
        decay = np.exp(-2e-4 / (0.0013 * 3.1**k))
        crept_um += 0.03 * lfilter([1.0 - decay], [1.0, -decay], y_um - y_um[0])
    decay = np.exp(-2e-4 / 4e-4)
    y_um = y_um[0] + lfilter([1.0 - decay], [1.0, -decay], y_um + crept_um - y_um[0])
    noise_um = 0.01 * np.random.default_rng(int(frequency_hz)).standard_normal(len(t_s))
    return Record(t_s, u_v, y_um + noise_um, 0.0, f"{frequency_hz:g} Hz")


def class_model(record: Record) -> ActuatorModel:
    """A model of the very class that an identification of the record searches in."""
    design = choose_design([record])
    rng = np.random.default_rng(5)
    weights = rng.uniform(0.0, 0.1, design.features)
    weights[design.first_play] += 1.0
    return design.model(weights, 12.0, 0.0)


def test_noise_free_data_of_the_class_are_reproduced() -> None:
    wave = waves.sampled(waves.slow_legs(150.0), 50.0)
    blank = Record(wave.t_s, wave.u_v, wave.u_v)
    truth = class_model(blank)
    y_um = truth.predict(wave.t_s, wave.u_v, truth.starting_state(wave.t_s, wave.u_v))
    found = identify([blank._replace(y_um=y_um)], resamples=2, delay_s=0.0)
    assert found.train.max_um <= 1e-6 * found.train.range_um
    assert found.accepted


@pytest.mark.parametrize("seed", tiers(11, slow=(17, 23)))
def test_an_actuator_outside_the_class_is_followed(seed: int) -> None:
    found = identify([calibration_record(seed, 10)], resamples=0)
    assert found.accepted, found.problems
    assert found.held_out.rms_pct <= 0.3
    stroke_um = found.model.stroke_um
    for name, wave in {
        "10 mHz": waves.sine(0.0, 120.0, 0.01, 1, 1000.0),
        "1 Hz": waves.sine(0.0, 120.0, 1.0, 10, 1000.0),
        "step": waves.square(0.0, 120.0, 1.0 / 120.0, 1, 1000.0),
        "jumps": waves.jump_train(0.0, 120.0, 1000.0),
        "servo": waves.servo_dither(0.0, 120.0, 1000.0),
    }.items():
        driven = VirtualActuator(seed).drive(wave.u_v)
        errors = judge(found.model.predict(wave.t_s, driven.applied_v), driven.truth_um).errors
        assert errors.max_um <= STROKE_SHARE_MAX * stroke_um, name
        assert errors.rms_um <= STROKE_SHARE_RMS * stroke_um, name


def test_held_out_errors_are_honest() -> None:
    found = identify([calibration_record(12, 10)], resamples=0)
    wave = waves.sampled(waves.slow_legs(150.0), 1000.0)
    actuator = VirtualActuator(12)
    actuator.drive(wave.u_v)
    again = actuator.drive(wave.u_v)
    estimator = Estimator(found.model)
    estimator.advance(wave.t_s, wave.u_v)
    predicted_um = estimator.advance(wave.t_s + wave.t_s[-1] + 0.001, again.applied_v)
    fresh = judge(predicted_um[::10], again.sensor_um[::10]).errors
    assert found.train.rms_um <= 1.1 * found.held_out.rms_um
    assert fresh.rms_um <= 2.0 * found.held_out.rms_um


@pytest.mark.slow
def test_bands_hold_what_the_sensor_shows_of_an_actuator_outside_the_class() -> None:
    slow = waves.triangle(0.0, 150.0, 0.01, 2, 100.0)
    cycle = slice(len(slow.t_s) // 2, None)
    inside = 0
    for seed in (13, 14, 15):
        bands = identify([calibration_record(seed)], resamples=20).bands
        seen_um = VirtualActuator(seed).drive(np.repeat(slow.u_v, 10)).truth_um[9::10][cycle]
        quarter = len(seen_um) // 4
        width = (seen_um[3 * quarter] - seen_um[quarter]) / np.ptp(seen_um)
        inside += abs(bands.loop_width - width) <= 2.0 * bands.loop_width_sd
        assert bands.loop_width_sd <= 0.004
        assert bands.gain_sd_um_per_v <= 0.003 * bands.gain_um_per_v
        assert bands.gamma_sd_per_decade <= 0.003
        assert bands.displacement_sd_um <= 1.0
    assert inside == 3


def test_bands_hold_the_figures_of_another_class() -> None:
    wave = waves.sampled(waves.slow_legs(150.0), 50.0)
    truth = default_model()
    noise_um = 0.15 * np.random.default_rng(1).standard_normal(len(wave.t_s))
    y_um = truth.predict(wave.t_s, wave.u_v) + noise_um
    bands = identify([Record(wave.t_s, wave.u_v, y_um)], resamples=20, beyond_plays=False).bands
    assert abs(bands.gain_um_per_v - truth.gain_um_per_v) <= 2.0 * bands.gain_sd_um_per_v
    assert abs(bands.loop_width - truth.loop_width) <= 2.0 * bands.loop_width_sd
    assert abs(bands.gamma_per_decade - truth.gamma_per_decade) <= 2.0 * bands.gamma_sd_per_decade


def test_a_third_rate_is_predicted_from_two() -> None:
    records = {hz: fan_record(hz) for hz in (20.0, 40.0, 100.0)}
    found = identify([records[20.0], records[100.0]], resamples=2)
    errors = validate(found.model, records[40.0]).errors
    assert errors.max_pct <= 1.0
    assert errors.rms_pct <= 0.3
    maxwell = fit_maxwell([records[20.0], records[100.0]], delay_s=found.model.delay_s)
    assert validate(maxwell.model, records[40.0]).errors.rms_um >= 4.0 * errors.rms_um


def test_a_delay_is_found_where_two_rates_tell_it() -> None:
    slow, fast = (waves.triangle(0.0, 100.0, hz, 6, 500.0) for hz in (0.5, 5.0))
    truth = make_model(delay_s=0.008, creep=0.01)
    records = [
        Record(w.t_s, w.u_v, truth.predict(w.t_s, w.u_v, ActuatorState.after_jump(truth, 0.0, 0.0)), 0.0)
        for w in (slow, fast)
    ]
    found = identify(records, resamples=0, beyond_plays=False)
    assert found.model.delay_s == pytest.approx(0.008, abs=0.002)
    assert not any("one rate" in one for one in found.restrictions)


def test_one_rate_without_holds_is_said_not_to_tell_delay_and_slow_creep() -> None:
    wave = waves.triangle(0.0, 100.0, 1.0, 8, 200.0)
    truth = make_model()
    records = [Record(wave.t_s, wave.u_v, truth.predict(wave.t_s, wave.u_v))]
    rate, holds = identify(records, resamples=2, beyond_plays=False).restrictions
    assert "one rate (1 Hz)" in rate
    assert "Hold a step" in holds


def test_wrong_memory_costs_several_times_the_error() -> None:
    truth = make_model(creep=0.01)
    fan = np.concatenate([np.linspace(a, b, 100) for a, b in ((10, 150), (150, 30), (30, 120), (120, 10))])
    t_s = clock(len(fan))
    y_um = truth.predict(t_s, fan, ActuatorState.after_jump(truth, 90.0, 10.0))
    right, wrong = (
        validate(truth, Record(t_s, fan, y_um, previous_v)).errors.rms_um for previous_v in (90.0, 10.0)
    )
    assert wrong > 4.0 * max(right, 0.05)


def test_each_record_has_its_own_zero() -> None:
    wave = waves.sampled(waves.slow_legs(150.0), 50.0)
    truth = class_model(Record(wave.t_s, wave.u_v, wave.u_v))
    y_um = truth.predict(wave.t_s, wave.u_v)
    records = [Record(wave.t_s, wave.u_v, y_um + shift_um) for shift_um in (0.0, 80.0)]
    found = identify(records, resamples=2, delay_s=0.0, beyond_plays=False)
    assert found.train.max_pct <= 1e-4
    assert found.model.zero_um - truth.zero_um == pytest.approx(80.0, abs=0.5)


def test_refitting_gain_and_zero_forgives_another_day() -> None:
    truth = make_model()
    wave = waves.triangle(0.0, 140.0, 0.5, 4, 100.0)
    y_um = 1.025 * truth.predict(wave.t_s, wave.u_v) + 60.0
    record = Record(wave.t_s, wave.u_v, y_um)
    assert validate(truth, record, ("gain", "zero")).errors.max_um < 1e-6
    assert validate(truth, record, ("gain", "zero")).gain == pytest.approx(1.025)
    assert validate(truth, record).errors.max_pct > 0.5


def test_a_gap_in_the_range_is_not_covered() -> None:
    low, high = waves.triangle(0.0, 50.0, 0.5, 8, 100.0), waves.triangle(100.0, 150.0, 0.5, 8, 100.0)
    truth = make_model()
    records = [Record(w.t_s, w.u_v, truth.predict(w.t_s, w.u_v)) for w in (low, high)]
    assert any("Not covered" in problem for problem in identify(records, beyond_plays=False).problems)


def test_a_stuck_range_is_not_monotone() -> None:
    record = calibration_record(15, 20)
    stuck_um = np.minimum(record.y_um, 200.0)
    found = identify([record._replace(y_um=stuck_um)], resamples=0, beyond_plays=False)
    assert any("Not monotone" in problem for problem in found.problems)
    assert found.model.slopes_um_per_v[0].min() > 0.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"u_v": np.full(1000, 3.0)}, "voltage does not change"),
        ({"y_um": -np.linspace(0.0, 100.0, 1000)}, "does not rise"),
        ({"t_s": np.zeros(1000)}, "time does not ascend"),
        ({"y_um": np.full(1000, np.nan)}, "not finite"),
    ],
)
def test_impossible_data_are_refused(change: dict[str, Array], message: str) -> None:
    ramp = np.linspace(0.0, 100.0, 1000)
    with pytest.raises(ValueError, match=message):
        identify([Record(change.get("t_s", ramp), change.get("u_v", ramp), change.get("y_um", ramp))])


@pytest.mark.parametrize(
    "wrong",
    [{"delay_s": np.nan}, {"delay_s": -1.0}, {"folds": 1}, {"folds": 10**6}, {"plays": 0}, {"resamples": -3}],
)
def test_impossible_wishes_are_refused(wrong: dict[str, Any]) -> None:
    wave = waves.triangle(0.0, 100.0, 0.5, 4, 100.0)
    record = Record(wave.t_s, wave.u_v, 3.0 * wave.u_v)
    with pytest.raises(ValueError, match=r"delay|do not make a fit"):
        identify([record], **wrong)
    with pytest.raises(ValueError, match="a list of records"):
        identify(record)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="before it is not finite"):
        identify([record._replace(previous_v=np.nan)])


def test_a_few_swings_give_a_model_that_bends() -> None:
    wave = waves.triangle(0.0, 150.0, 0.2, 2, 100.0)
    driven = VirtualActuator(16).drive(np.repeat(wave.u_v, 10))
    record = Record(wave.t_s, driven.applied_v[9::10], driven.sensor_um[9::10])
    model, errors = identify_quick(record)
    assert errors.rms_pct < 0.2
    assert model.slopes_um_per_v.shape[1] == 3
    assert model.gamma_per_decade > 0.005
