"""A job with a calibration: what the estimator learns from the sensor, when, and how well it then does alone."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from edmctl.actuator.model import Estimator
from edmctl.machine.interface import EventCode, MachineState, TelemetryBlock
from edmctl.procedures.displacement_estimate import SPAN_S, FeedError, Trace
from edmctl.procedures.hole.cut import CLEARANCE_UM, jump_request
from edmctl.procedures.job import CalibratedActuator
from edmctl.procedures.machining import machine_sites
from edmctl.procedures.touch.approach import lower_to, raise_by
from edmctl.profile.places import Place
from edmctl.record.rows import RunEvent
from tests.tiers import tiers

from .conftest import Done, Shop, armed, calibrated, refused, samples


@pytest.fixture(scope="module")
def run() -> Done:
    shop = Shop(calibration=calibrated())
    return Done(shop, shop.run_job())


def scaled(factor: float, zero_um: float = 0.0) -> CalibratedActuator:
    own = calibrated()
    model = replace(
        own.model,
        slopes_um_per_v=factor * own.model.slopes_um_per_v,
        creep_um_per_v=factor * own.model.creep_um_per_v,
        zero_um=own.model.zero_um + zero_um,
    )
    return replace(own, model=model)


def test_a_calibration_of_something_else_is_refused_before_the_work() -> None:
    with refused("E8038", "is not this actuator's"):
        armed(Shop(calibration=scaled(4.0)), conditioned=True)


def test_the_model_alone_measures_the_hole_with_the_error_of_the_recorded_samples(run: Done) -> None:
    (site,), seen = run.result.sites, run.shop.seen
    assert site.depth_model_um == pytest.approx(site.depth_um, abs=site.depth_u95_um)
    assert site.depth_model_um != site.depth_um
    error_um = seen.column("model_um") - seen.column("displacement_um")
    machining = seen.column("state") == MachineState.MACHINING
    with_noise_um = np.hypot(site.feed_model_error_rms_um, 0.15)  # of single samples
    assert with_noise_um == pytest.approx(np.sqrt(np.mean(error_um[machining] ** 2)), rel=0.02)
    assert site.feed_model_error_rms_um < site.feed_model_error_max_um < 1.5
    assert site.feed_model_error_max_pct == pytest.approx(100 * site.feed_model_error_max_um / site.feed_um)
    assert seen.sites[-1].feed_model_error_max_um == site.feed_model_error_max_um
    assert seen.sites[-1].zero_drift_um == site.zero_drift_um
    assert 0.0 < abs(site.zero_drift_um) < 3.0
    assert site.wear_model_um == pytest.approx(site.wear_um, abs=0.8)


def test_the_gain_is_that_of_the_swings_and_the_zero_moves_at_rests_only(run: Done) -> None:
    """What it says of every touch and cut is one model with one gain: between rests nothing corrects it."""
    (homed,) = run.shop.seen.args(RunEvent.CONDITIONED)
    rests = [code for code in run.shop.seen.codes if code == RunEvent.STAGE_MOVED]
    calibration = calibrated()
    times_s, volts = run.shop.seen.column("time_s"), run.shop.seen.column("actuator_v")
    again = Estimator(calibration.model)
    again.state.t_s = float(times_s[0])
    again.correct(float(homed["gain"]), float(homed["offset_um"]))
    alone_um = again.advance(times_s, volts)
    estimated_um = run.shop.seen.column("model_um")
    seen = np.isfinite(estimated_um)
    assert seen.mean() > 0.9
    zeros_um = np.round((estimated_um - alone_um)[seen], 6)
    assert np.count_nonzero(np.diff(zeros_um)) <= len(rests)
    assert np.abs(volts[seen][1:][np.diff(zeros_um) != 0.0]).max() < 0.01


def test_a_moved_gain_and_zero_of_the_day_are_found_at_home() -> None:
    """The calibration is of another day: 3 % more gain, another zero."""
    s = Shop(calibration=scaled(1.03, 40.0))
    (site,) = s.run_job().sites
    (homed,) = s.seen.args(RunEvent.CONDITIONED)
    assert float(homed["gain"]) == pytest.approx(1 / 1.03, abs=2e-3)
    assert site.depth_model_um == pytest.approx(site.depth_um, abs=site.depth_u95_um)
    assert site.feed_model_error_max_um < 1.5


def test_touches_correct_the_gain_only_between_holes() -> None:
    s = Shop(('target={kind="feed",feed_um=6.0}',), calibration=calibrated())
    run = armed(s, conditioned=True)
    tracker = run.watch.tracker()
    assert tracker is not None

    homed = tracker.estimator.gain
    (first,) = s.job.sites
    machine_sites(run)
    assert tracker.estimator.gain == homed
    run.tally.sites.clear()
    second = Place("second", first.x_um + 400.0, first.y_um)
    machine_sites(replace(run, job=replace(s.job, sites=(second,))))
    assert tracker.estimator.gain != homed


@pytest.mark.parametrize("target_um", tiers(300.0, slow=(200.0,)))
def test_lowering_by_the_model_takes_two_steps_and_stays_short(target_um: float) -> None:
    s = Shop(calibration=calibrated())
    run = armed(s, conditioned=True)
    before = len(s.seen.events)
    lower_to(run, target_um)
    ramps = [code for _, code, _, _, _ in s.seen.events[before:] if code == EventCode.MOVE_DONE]
    assert len(ramps) <= 2
    assert target_um - 3.0 <= run.watch.displacement_um < target_um
    raise_by(run, 60.0)
    s.machine.rest(0.2)
    assert run.watch.displacement_um == pytest.approx(target_um - 60.0, abs=4.0)


def test_a_jump_is_as_high_as_the_profile_says() -> None:
    s = Shop(('jump.mode="fixed"', "jump.period_s=3.0", "jump.height_um=40.0"), calibration=calibrated())
    s.run_job()
    volts, heights_um = s.seen.column("actuator_v"), s.seen.column("displacement_um")
    jumping = np.flatnonzero(s.seen.column("state") == MachineState.JUMP)
    found = []
    for jump in np.split(jumping, np.flatnonzero(np.diff(jumping) > 1) + 1):
        top = jump[volts[jump] <= volts[jump].min() + 0.003]
        found.append(heights_um[jump[0] - 5 : jump[0]].mean() - heights_um[top].mean())
    assert len(found) >= 3
    assert np.mean(found) == pytest.approx(40.0, rel=0.025)
    assert np.abs(np.array(found) / 40.0 - 1.0).max() < 0.05


def test_without_a_model_a_jump_is_told_by_the_mean_gain() -> None:
    run = Shop(('jump.mode="fixed"', "jump.period_s=3.0", "jump.height_um=40.0")).run()
    request = jump_request(run, 40.0)
    assert (request.height_um, request.clearance_um) == (40.0, CLEARANCE_UM)
    assert request.speed_um_s == run.profile.jump.speed_um_s


def block(start_s: float, sensor_um: float, state: MachineState = MachineState.MACHINING) -> TelemetryBlock:
    """50 samples with the sensor at one height."""
    return samples(start_s, np.full(50, sensor_um), state=state)


def test_a_trace_interpolates_and_forgets_what_is_long_past() -> None:
    trace = Trace()
    assert math.isnan(trace.at(0.0))
    for second in range(60):
        times_s = second + np.array([0.0, 0.5])
        trace.append(times_s, 2.0 * times_s)
    assert trace.at(55.25) == pytest.approx(110.5)
    assert trace.at(1e3) == 2.0 * 59.5
    assert 2.0 * (59.5 - SPAN_S - 1.0) <= trace.at(0.0) <= 2.0 * (59.5 - SPAN_S)


def test_the_feed_error_is_largest_and_rms_of_means_while_machining() -> None:
    error = FeedError()
    assert [math.isnan(um) for um in error.figures_um()] == [True, True]
    error.update(block(0.0, 100.0), np.full(50, 101.0))
    error.update(block(0.5, 100.0), np.full(50, 97.0))
    error.update(block(1.0, 100.0, state=MachineState.JUMP), np.full(50, 150.0))
    assert error.figures_um()[0] == pytest.approx(3.0)
    assert error.figures_um()[1] == pytest.approx(math.sqrt((1.0 + 9.0) / 2.0))
