"""Rests and touches of a made-up machine: creep, drift and share are found, and a later job goes by them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edmctl.process.rest_drift import (
    LEAST_GAIN,
    LEAST_TOUCHES,
    REST_SHARE,
    RESTS_S,
    CreepLags,
    CreepLeft,
    DriftFit,
    DriftModel,
    Rest,
    fit_drift,
    mean_rest,
    model_of,
)
from edmctl.process.touches import Touch, reading_of, share_u

STEP_S = 1.0
TAU_S = np.array([0.2, 2.0, 20.0, 200.0, 2000.0])
"""Of the made-up actuator: not those that the regression takes."""
CREEP = 0.021
DEEP_UM = 250.0
REST_U_UM = 0.04
TOUCH_SD_UM = 0.1
WALK = 0.01
"""µm/√s"""


@dataclass
class Actuator:
    """An actuator that creeps logarithmically, under a sensor that drifts, over work that drifts too."""

    sensor_um_s: float
    machine_um_s: float
    noise: np.random.Generator
    noisy: float = 1.0

    def __post_init__(self) -> None:
        self.time_s = 0.0
        self.lags_um = np.zeros(len(TAU_S))
        self.lags = CreepLags()

    @property
    def creep_um(self) -> float:
        return CREEP * float(self.lags_um.sum())

    def stay(self, depth_um: float, seconds: float) -> None:
        """Hold the tool at a depth, or at 0 V."""
        n = round(seconds / STEP_S)
        kept = np.exp(-STEP_S / TAU_S)
        times_s, shown_um = np.zeros(n), np.zeros(n)
        for k in range(n):
            self.lags_um = self.lags_um * kept + (1.0 - kept) * depth_um
            self.time_s += STEP_S
            held_um = depth_um or self.creep_um
            times_s[k], shown_um[k] = self.time_s, held_um + self.sensor_um_s * self.time_s
        self.lags.advance(times_s, shown_um, np.full(n, depth_um / 3.0))

    def rest(self) -> Rest:
        u_um = REST_U_UM * self.noisy
        um = self.creep_um + self.sensor_um_s * self.time_s + u_um * self.noise.standard_normal()
        return Rest(self.time_s, um, u_um, self.lags.um, self.lags.out_s)

    def touch(self) -> Touch:
        drift_um = (self.sensor_um_s + self.machine_um_s) * self.time_s
        touches_um = 40.0 + drift_um + TOUCH_SD_UM * self.noisy * self.noise.standard_normal(3)
        return Touch(self.time_s, reading_of(tuple(touches_um)))


@cache
def measured(
    sensor_um_s: float, machine_um_s: float, seed: int = 1, chip_um: float = 0.0, noisy: float = 1.0
) -> DriftFit:
    """A quarter of an hour of rests and touches with a hold between them; `chip_um` lies under one touch."""
    made = Actuator(sensor_um_s, machine_um_s, np.random.default_rng(seed), noisy)
    rests, touches = [], []
    made.stay(0.0, 5.0)
    for minute in range(11):
        if minute == 3:
            made.stay(DEEP_UM, 300.0)
            made.stay(0.0, 2.0)
        rests.append(made.rest())
        made.stay(40.0, 8.0)
        touches.append(made.touch())
        made.stay(0.0, 52.0)
    if chip_um:
        time_s, reading = touches[5].time_s, touches[5].reading
        touches[5] = Touch(time_s, replace(reading, mean_um=reading.mean_um - chip_um))
    return fit_drift(rests, touches, WALK)


SENSOR = 0.0025
"""µm/s."""


@pytest.mark.parametrize(
    ("sensor_um_s", "machine_um_s"),
    [
        pytest.param(SENSOR, 0.0, id="the sensor drifts"),
        pytest.param(0.0, SENSOR, id="the machine drifts"),
        pytest.param(SENSOR, SENSOR, id="both drift"),
        pytest.param(-SENSOR, 0.5 * SENSOR, id="one against the other"),
        pytest.param(0.0, 0.0, id="nothing drifts"),
    ],
)
def test_drifts_are_found_whatever_it_is_that_drifts(sensor_um_s: float, machine_um_s: float) -> None:
    fit = measured(sensor_um_s, machine_um_s)
    for found, true in (
        (fit.rest_um_per_s, sensor_um_s),
        (fit.touch_um_per_s, sensor_um_s + machine_um_s),
        (fit.apart_um_per_s, machine_um_s),
    ):
        assert abs(found.value - true) < 3.0 * found.u
        assert found.u < 0.001
    assert fit.misfit < 2.0


def test_the_share_is_how_much_of_the_rests_drift_a_touch_sees() -> None:
    sensor, both = measured(SENSOR, 0.0).share, measured(SENSOR, SENSOR).share
    assert sensor is not None
    assert both is not None
    assert abs(sensor.value - 1.0) < 3.0 * sensor.u < 0.6
    assert abs(both.value - 2.0) < 3.0 * both.u


def test_rests_that_stand_still_or_drift_by_no_more_than_their_walk_show_no_share() -> None:
    assert measured(0.0, SENSOR).share is None
    assert measured(0.0, 0.0).share is None
    assert measured(SENSOR, 0.0).is_steady
    walked = measured(0.0008, SENSOR)
    assert not walked.is_steady
    assert walked.share is None or walked.share.u <= share_u(1.0)
    assert model_of(measured(0.0, SENSOR)).share_u == share_u(1.0)


def test_a_sensor_with_more_noise_says_so_itself() -> None:
    quiet, loud = measured(SENSOR, 0.0), measured(SENSOR, 0.0, noisy=6.0)
    assert loud.misfit < 1.5
    assert loud.apart_um_per_s.u > 2.0 * quiet.apart_um_per_s.u
    assert abs(loud.touch_um_per_s.value - SENSOR) < 3.0 * loud.touch_um_per_s.u


@pytest.mark.slow
def test_intervals_of_the_drifts_hold() -> None:
    held = 0
    for seed in range(20):
        fit = measured(SENSOR, 0.0, seed)
        held += abs(fit.rest_um_per_s.value - SENSOR) < 1.96 * fit.rest_um_per_s.u
        held += abs(fit.apart_um_per_s.value) < 1.96 * fit.apart_um_per_s.u
    assert held >= 36


def test_a_touch_with_a_chip_under_it_is_left_out_and_few_touches_tell_nothing() -> None:
    clean, chip = measured(SENSOR, 0.0), measured(SENSOR, 0.0, chip_um=6.0)
    assert (clean.outliers, chip.outliers) == (0, 1)
    assert chip.touch_um_per_s.value == pytest.approx(clean.touch_um_per_s.value, abs=0.0005)
    made = Actuator(0.0, 0.0, np.random.default_rng(1))
    made.stay(0.0, 5.0)
    touches = [made.touch()] * (LEAST_TOUCHES - 1)
    with pytest.raises(ValueError, match="touches tell no drift"):
        fit_drift([made.rest(), made.rest()], touches, WALK)


def cut(
    made: Actuator,
    way_um: float = DEEP_UM,
    cut_s: float = 600.0,
    rest_s: float = 10.0,
    before_s: float = 30.0,
) -> tuple[Rest, Rest, float]:
    """The rests before and after a cut, and the time between them."""
    made.stay(0.0, before_s)
    first = made.rest()
    made.stay(way_um, cut_s)
    made.stay(0.0, rest_s)
    last = made.rest()
    return first, last, last.time_s - first.time_s


def a_job(made: Actuator, model: DriftModel) -> tuple[float, float, float]:
    """A cut of ten minutes between two rests: true drift of a touch, what is said of it, and its uncertainty."""
    first, last, seconds = cut(made)
    drift = model.between(first, last, seconds)
    return (made.sensor_um_s + made.machine_um_s) * seconds, drift.um, drift.left_u_um


@pytest.mark.parametrize(("sensor_um_s", "machine_um_s"), [(SENSOR, 0.0), (0.0, SENSOR), (SENSOR, SENSOR)])
def test_a_later_job_is_corrected_by_its_own_rests(sensor_um_s: float, machine_um_s: float) -> None:
    model = model_of(measured(sensor_um_s, machine_um_s))
    later = Actuator(sensor_um_s, machine_um_s, np.random.default_rng(7))
    true_um, said_um, left_u_um = a_job(later, model)
    assert abs(said_um - true_um) < 1.96 * left_u_um
    if machine_um_s == 0.0:
        assert abs(said_um - true_um) < 0.5 < abs(true_um)
        assert left_u_um < 0.5


def test_a_sensor_that_drifts_the_other_way_by_then_is_corrected_as_well() -> None:
    model = model_of(measured(SENSOR, 0.0))
    true_um, said_um, left_u_um = a_job(Actuator(-SENSOR, 0.0, np.random.default_rng(7)), model)
    assert abs(said_um - true_um) < 1.96 * left_u_um
    assert said_um < -1.0


def test_nothing_is_left_between_a_rest_and_itself_and_more_of_an_actuator_in_use_before() -> None:
    model = model_of(measured(SENSOR, 0.0))
    first, last, _ = cut(Actuator(SENSOR, 0.0, np.random.default_rng(7)), way_um=0.0)
    assert model.between(last, last, 0.0).um == 0.0
    assert model.between(last, last, 0.0).left_u_um < 0.1
    fresh, used = (model.between(first, last, 600.0, memory_s).left_u_um for memory_s in (math.inf, 60.0))
    assert used > fresh


def test_what_no_touch_can_see_of_a_rest_is_not_taken_for_a_share() -> None:
    """A touch that moves twice as fast as the rests is a drift between tool and work, which may be gone by then."""
    fit = measured(SENSOR, SENSOR)
    model = model_of(fit)
    assert model.share == 1.0
    assert model.apart_u_um_per_s >= abs(fit.apart_um_per_s.value)
    unseen = model_of(measured(0.0, SENSOR))
    assert (unseen.share, unseen.share_u) == (1.0, share_u(1.0))


def test_a_deep_cut_is_rested_out_before_a_touch_and_a_shallow_one_is_not() -> None:
    model = model_of(measured(SENSOR, 0.0))
    left = {}
    for way_um in (DEEP_UM, 2.0):
        made = Actuator(SENSOR, 0.0, np.random.default_rng(7))
        first, last, seconds = cut(made, way_um, 900.0, 2.0)
        pays_s = model.rest_that_pays_s(first, last, seconds)
        for drift_um_s in (1e-3, 1e-2):
            assert model.rest_that_pays_s(first, last, seconds, drift_u_um_per_s=drift_um_s) <= pays_s
        assert model.rest_that_pays_s(first, last, seconds, drift_u_um_per_s=0.01) == 0.0
        before_u_um = model.between(first, last, seconds).left_u_um
        made.stay(0.0, pays_s + STEP_S)
        after_u_um = model.between(first, made.rest(), seconds + pays_s).left_u_um
        left[way_um] = (pays_s, after_u_um / before_u_um)
    assert left[2.0][0] == 0.0
    assert left[DEEP_UM][0] in RESTS_S
    assert left[DEEP_UM][0] <= REST_SHARE * 932.0
    assert left[DEEP_UM][1] < 1.0 - LEAST_GAIN + 0.02


@settings(max_examples=25)
@given(st.lists(st.floats(-5.0, 5.0), min_size=2, max_size=30), st.integers(1, 29))
def test_lags_do_not_depend_on_how_samples_are_cut_into_blocks(ways_um: list[float], cut: int) -> None:
    time_s, way_um = np.arange(len(ways_um), dtype=np.float64), np.array(ways_um)
    volts = np.where(np.arange(len(ways_um)) % 3 == 0, 0.0, 50.0)
    whole, parts = CreepLags(), CreepLags()
    whole.advance(time_s, way_um, volts)
    cut = min(cut, len(ways_um) - 1)
    parts.advance(time_s[:cut], way_um[:cut], volts[:cut])
    parts.advance(time_s[cut:], way_um[cut:], volts[cut:])
    np.testing.assert_allclose(parts.um, whole.um, atol=1e-12)
    np.testing.assert_allclose(parts.out_s, whole.out_s, atol=1e-12)


def test_several_rests_are_one_as_the_touches_are() -> None:
    lags = np.ones(9)
    first, second = Rest(10.0, 1.0, 0.03, lags, lags), Rest(40.0, 4.0, 0.06, 2.0 * lags, 3.0 * lags)
    together = mean_rest([first, second], [2.0 / 3.0, 1.0 / 3.0])
    assert together is not None
    assert (together.time_s, together.um) == pytest.approx((20.0, 2.0))
    assert together.u_um == pytest.approx(0.02 * math.sqrt(2.0))
    np.testing.assert_allclose(together.lags_um, 4.0 / 3.0)
    assert mean_rest([first, None], [0.5, 0.5]) is None


def test_lags_go_on_from_what_an_earlier_run_has_left() -> None:
    deep = np.full(600, DEEP_UM)
    deep[0] = deep[-1] = 0.0
    volts = np.where(deep > 0.0, 100.0, 0.0)
    time_s = np.arange(1.0, 601.0)
    whole, first = CreepLags(), CreepLags()
    for lags in (whole, first):
        lags.advance(time_s, deep, volts)
    pause_s = 240.0
    second = CreepLags(first.left.after(pause_s))
    second.advance(time_s, deep, volts)
    # The later run begins with its first sample: between the two the tool rests.
    whole.advance(np.concatenate(([599.0 + pause_s + 1.0], time_s[1:] + 599.0 + pause_s)), deep, volts)
    assert second.um == pytest.approx(whole.um, rel=0.01, abs=0.05)
    assert first.left.unknown_s == math.inf
    known = CreepLags(CreepLeft.none(30.0))
    known.advance(time_s, deep, volts)
    assert known.left.after(pause_s).unknown_s == pytest.approx(30.0 + 599.0 + pause_s)


@pytest.mark.parametrize("lags_um", [[0.0] * 8, [math.nan] * 9, [2000.0] + [0.0] * 8])
def test_creep_that_cannot_be_left_is_refused(lags_um: list[float]) -> None:
    with pytest.raises(ValueError, match="no creep"):
        CreepLeft.of(lags_um, 0.0)


def test_the_second_of_two_jobs_knows_its_drift_as_well_as_the_first() -> None:
    model = model_of(measured(SENSOR, 0.0))
    actuator = Actuator(SENSOR, 0.0, np.random.default_rng(5))
    left: CreepLeft | None = None
    unknown_us, known_us = [], []
    for _ in range(2):
        actuator.lags = CreepLags(left)
        first, last, seconds = cut(actuator, rest_s=20.0, before_s=5.0)
        # Times of a run count from its begin.
        first, last = (replace(one, time_s=one.time_s - first.time_s + 5.0) for one in (first, last))
        known = model.between(first, last, seconds, math.inf if left is None else left.unknown_s)
        assert abs(known.um - SENSOR * seconds) < 2.0 * known.left_u_um
        known_us.append(known.left_u_um)
        unknown_us.append(model.between(first, last, seconds, 0.0).left_u_um)
        left = actuator.lags.left.after(60.0)
        actuator.stay(0.0, 60.0)
    assert known_us[1] < 1.2 * known_us[0]
    assert unknown_us[1] > 3.0 * known_us[1]
