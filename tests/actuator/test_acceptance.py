"""What a calibration says of itself: where it is judged, what it gives no weight, and what it blames."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest

from edmctl.actuator.acceptance import Noise, most_accepted_pct
from edmctl.actuator.identification import Identification, identify
from edmctl.actuator.model import ActuatorState
from edmctl.actuator.record import Record
from edmctl.actuator.screening import screened, settled
from edmctl.actuator.waveforms import sampled, sine, slow_legs
from edmctl.simulator.plant import HIGH_V, VirtualActuator
from edmctl.simulator.plant import RATE_HZ as SEEN_HZ
from tests.actuator.models import Array, clock, make_model

RATE_HZ = 100.0


def swings(amplitudes_v: Array, rate_hz: float = RATE_HZ) -> Array:
    """Raised cosines of 1 s, one after the other."""
    phase = 2.0 * np.pi * np.arange(round(rate_hz)) / rate_hz
    return np.concatenate([0.5 * amplitude_v * (1.0 - np.cos(phase)) for amplitude_v in amplitudes_v])


def measured(u_v: Array, noise_um: float = 0.05, *, bow: float = 0.0) -> Record:
    """A record of an actuator that the model's class holds but for a bow, %, of its displacement."""
    truth = make_model(creep=0.01)
    t_s = clock(len(u_v), 1.0 / RATE_HZ)
    y_um = truth.predict(t_s, u_v, ActuatorState.after_jump(truth, 0.0, 0.0))
    y_um += 0.01 * bow * y_um * (y_um - 300.0) / 300.0
    y_um += noise_um * np.random.default_rng(3).standard_normal(len(u_v))
    return Record(t_s, u_v, y_um, 0.0, "swings")


def found_of(record: Record) -> Identification:
    return identify([record], delay_s=0.0, resamples=0, beyond_plays=True)


@pytest.fixture(scope="module")
def mixed_v() -> Array:
    return swings(np.random.default_rng(1).uniform(40.0, 150.0, 30))


def test_growing_swings_are_judged_where_others_have_been() -> None:
    record = measured(swings(np.linspace(20.0, 150.0, 20)), bow=12.0)
    found = found_of(record)
    assert found.beyond is not None
    assert 0.005 < found.beyond_share < 0.2
    assert found.beyond.max_um > found.held_out.max_um
    assert any("beyond what the other blocks reached" in note for note in found.notes)
    assert found.accepted, found.problems


def test_growing_swings_of_an_actuator_that_had_not_been_cycled_are_no_drift() -> None:
    """They wipe out its memory little by little, which looked like a drift of the sensor by 27 µm."""
    record = measured(swings(np.linspace(20.0, 150.0, 20)))._replace(previous_v=None)
    problem, unknown = identify([record], delay_s=0.0, resamples=0, beyond_plays=False).problems
    assert unknown.startswith("Unknown start: every rising voltage")
    assert "swings begins as of an actuator that had not been cycled" in problem
    assert "--previous-voltage" in problem


def test_a_range_that_was_reached_once_is_not_accepted_and_its_remedy_mends_it() -> None:
    """All but the last second is 20 V of 150 V: errors there say nothing about the rest."""
    small_v = np.full(20, 20.0)
    found = found_of(measured(swings(np.append(small_v, 150.0))))
    assert found.held_out.max_pct < 1.0
    (problem,) = found.problems
    assert "Judged from 0.0 V to 2" in problem
    assert "of 0.0 V to 150.0 V" in problem
    assert "Record the largest swings twice" in problem
    early_and_late_v = np.concatenate([[150.0], small_v, [150.0]])
    assert found_of(measured(swings(early_and_late_v))).accepted


def test_a_start_that_rings_gets_no_weight_and_is_said(mixed_v: Array) -> None:
    plain = measured(mixed_v)
    ringing_um = 40.0 * np.exp(-plain.t_s / 0.1) * np.cos(40.0 * plain.t_s)
    found = found_of(plain._replace(y_um=plain.y_um + ringing_um))
    assert found.screening is not None
    assert 0.2 < found.screening.rung_s[0] < 1.5
    assert found.accepted, found.problems
    assert found.held_out.max_um < 2.0
    assert any("get no weight" in note for note in found.notes)


def test_single_samples_that_stand_out_get_no_weight_and_are_counted(mixed_v: Array) -> None:
    plain = measured(mixed_v)
    y_um = plain.y_um.copy()
    y_um[[500, 1700, 2650]] += (12.0, -9.0, 15.0)
    found = found_of(plain._replace(y_um=y_um))
    assert found.screening is not None
    assert found.screening.outliers == (3,)
    assert found.held_out.max_um < 2.0
    assert any(note.startswith("3 of the ") and "loose cable" in note for note in found.notes)


def test_clean_records_keep_every_sample(mixed_v: Array) -> None:
    record = measured(mixed_v)
    found = screened(make_model(creep=0.01), [record], settled([record]))
    assert found.is_plain
    assert found.used[0].all()


def test_noise_is_told_by_itself_and_excuses_the_largest_error_within_bounds() -> None:
    noise_um = np.random.default_rng(2).normal(0.0, 0.3, 20_000)
    noise = Noise.of([noise_um])
    assert noise.sd_um == pytest.approx(0.3, rel=0.03)
    assert noise.largest_um == pytest.approx(float(np.abs(noise_um).max()), rel=0.2)
    assert most_accepted_pct(noise, 445.0) == 2.0
    assert 2.0 < most_accepted_pct(noise, 50.0) < 4.0
    assert most_accepted_pct(noise, 5.0) == 4.0


@pytest.fixture(scope="module")
def calibration() -> Record:
    """The slow legs alone, through the sensor of an actuator of another kind, at 40 Hz, as they are soon fitted."""
    seen = VirtualActuator(1).drive(sampled(slow_legs(HIGH_V), SEEN_HZ).u_v)
    every = slice(None, None, 25)
    return Record(seen.t_s[every], seen.applied_v[every], seen.sensor_um[every], name="spoiled")


def decaying(samples: int, first: int, height_um: float) -> Array:
    after = np.arange(samples) - first
    um: Array = np.where(after < 0, 0.0, height_um * np.exp(-np.maximum(after, 0) / 2.0))
    return um


def single(samples: int, share: float) -> Array:
    rng = np.random.default_rng(6)
    um = np.zeros(samples)
    places = rng.choice(samples, round(share * samples), replace=False)
    um[places] = rng.choice([-30.0, 30.0], len(places))
    return um


@pytest.mark.parametrize(
    ("spoil_um", "words"),
    [
        (lambda t: np.random.default_rng(4).normal(0.0, 3.0, len(t)), "RMS error .* sensor's noise"),
        (lambda t: decaying(len(t), len(t) // 2, 40.0), "the worst is at 148.* of spoiled"),
        (lambda t: 20.0 * t / t[-1], "follows time, by 1[5-9] µm"),
        (lambda t: 60.0 * t / t[-1], "follows time, by [56][0-9] µm"),
        (lambda t: single(len(t), 0.003), "3[0-9] samples stand out"),
        (lambda t: np.where(np.arange(len(t)) % 300 < 2, 30.0, 0.0), "[78][0-9] samples stand out"),
        (lambda t: 8.0 * np.sin(0.5 * t), "everywhere and follows the voltage"),
    ],
    ids=[
        "noise",
        "knock",
        "drift",
        "large drift",
        "outliers",
        "pairs",
        "everywhere",
    ],
)
def test_the_cause_is_named(calibration: Record, spoil_um: Callable[[Array], Array], words: str) -> None:
    spoiled = calibration._replace(y_um=calibration.y_um + spoil_um(calibration.t_s))
    found = identify([spoiled], delay_s=0.005, resamples=0, beyond_plays=False)
    (problem,) = found.problems
    assert re.search(words, problem), problem


def test_records_that_differ_are_named_and_no_drift(mixed_v: Array) -> None:
    """Records of one rate are also held out whole."""
    first = measured(mixed_v)
    other = first._replace(y_um=1.04 * first.y_um)
    found = identify([first, other], delay_s=0.0, resamples=0, beyond_plays=False)
    assert found.held_out_records is not None
    assert found.held_out_records.max_pct > 2.0
    assert len(found.problems) == 2
    for problem in found.problems:
        assert "the records differ from each other" in problem
        assert "drift" not in problem


def test_a_record_of_another_rate_is_not_held_out_whole(mixed_v: Array) -> None:
    first = measured(mixed_v)
    slower = measured(np.interp(np.arange(4 * len(mixed_v)) / 4.0, np.arange(len(mixed_v)), mixed_v))
    found = identify([first, slower], delay_s=0.0, resamples=0, beyond_plays=False)
    assert found.held_out_records is None
    assert found.accepted, found.problems


def test_too_little_is_the_cause_where_a_fit_of_all_misses_less() -> None:
    """A small and a large swing of another actuator are not predicted better without a drift or a shift."""
    u_v = np.concatenate([sine(0.0, high_v, 0.2, 1, SEEN_HZ).u_v for high_v in (60.0, 150.0)])
    seen, every = VirtualActuator(1).drive(u_v), slice(None, None, 5)
    record = Record(seen.t_s[every], seen.applied_v[every], seen.sensor_um[every], 0.0)
    found = identify([record], delay_s=0.005, resamples=0, beyond_plays=False)
    assert "a fit of all of it misses far less" in " ".join(found.problems)


def of_the_plant(corners_v: list[float], *, seed: int, cycled: bool) -> Record:
    """Triangles at 30 V/s on plays and creep drawn as the simulator draws them, at first cycled or never used."""
    unit = VirtualActuator(seed)._plant.unit
    thresholds_v, um_per_v = unit.array("play_threshold_v"), unit.array("play_um_per_v")
    decay, share = unit.array("creep_decay") ** 10, unit.array("creep_share")
    t_s = clock(1 + round(float(np.abs(np.diff(corners_v)).sum()) / 0.3))
    passed_v = np.append(0.0, np.cumsum(np.abs(np.diff(corners_v))))
    u_v = np.interp(30.0 * t_s, passed_v, corners_v)
    plays_v = np.zeros_like(thresholds_v)
    for end_v in (150.0, 0.0) if cycled else ():
        plays_v = np.clip(plays_v, end_v - thresholds_v, end_v + thresholds_v)
    creep_um, y_um = np.full(len(share), um_per_v @ plays_v), np.empty(len(t_s))
    for k, volts in enumerate(u_v):
        plays_v = np.clip(plays_v, volts - thresholds_v, volts + thresholds_v)
        at_once_um = float(um_per_v @ plays_v)
        creep_um = at_once_um + (creep_um - at_once_um) * decay
        y_um[k] = at_once_um + share @ creep_um
    return Record(t_s, u_v, y_um + 0.03 * np.random.default_rng(seed).standard_normal(len(t_s)), name="loop")


@pytest.mark.parametrize("seed", [3, 8])
def test_one_loop_from_an_unknown_start_is_not_accepted(seed: int) -> None:
    """Its only rise depends on the start: 447 µm of stroke were accepted for 400."""
    loop = of_the_plant([0.0, 150.0, 0.0], seed=seed, cycled=False)
    (problem,) = found_of(loop).problems
    assert problem.startswith("Unknown start: every rising voltage between 0.0 V and 15.0 V depends on")
    assert "--previous-voltage" in problem
    known = found_of(loop._replace(previous_v=0.0))
    assert known.accepted, known.problems
    turned = found_of(loop._replace(u_v=150.0 - loop.u_v, y_um=450.0 - loop.y_um))
    assert turned.problems[0].startswith("Unknown start: every falling voltage")


def test_two_loops_of_a_cycled_actuator_are_accepted() -> None:
    found = found_of(of_the_plant([0.0, 150.0, 0.0, 150.0, 0.0], seed=3, cycled=True))
    assert found.accepted, found.problems
    assert found.stroke_um == pytest.approx(401.0, abs=4.0)
