"""A machine without a displacement sensor: the same job by its calibrated actuator, judged by the plant's truth."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edmctl.errors import MachineFault, PreconditionError
from edmctl.labels import Basis
from edmctl.machine.interface import CutRequest, EventCode, MachineState, ScanLine
from edmctl.procedures.displacement_estimate import SensorlessMachine
from edmctl.procedures.monitoring.drift import displacement_uncertainty
from edmctl.procedures.settings import controller_settings, pulse_settings, telemetry_settings
from edmctl.record.rows import RunEvent
from edmctl.simulator.plant_records import TICK_S
from tests.tiers import tiers

from .conftest import Done, Shop, calibrated, refused


@pytest.fixture(scope="module")
def blind() -> Done:
    shop = Shop(calibration=calibrated(), sensor=False)
    return Done(shop, shop.run_job())


@pytest.mark.parametrize("seed", tiers(1, slow=(2, 3)))
def test_depth_and_wear_hold_the_truth_within_their_uncertainty(seed: int) -> None:
    s = Shop(
        ('target={kind="depth",depth_um=40.0,tolerance_um=4.0}',),
        seed=seed,
        calibration=calibrated(seed),
        sensor=False,
    )
    (site,) = s.run_job().sites
    assert s.holds(site)
    assert s.holds_wear(site)
    assert site.depth_um == pytest.approx(s.true_depth_um(site), abs=1.0)


def test_every_displacement_is_the_estimate_with_what_the_model_does_not_know(
    blind: Done, done: Done
) -> None:
    job, seen, (site,) = blind.shop.job, blind.shop.seen, blind.result.sites
    assert job.calibration is not None
    known = displacement_uncertainty(job)
    assert known.gain_u_rel == pytest.approx(math.hypot(0.003, 0.025))
    assert known.model_u_um == pytest.approx(math.sqrt(2) * job.calibration.held_out_rms_um)
    assert site.depth_u95_um > 1.2 * done.result.sites[0].depth_u95_um
    assert np.isnan(seen.column("displacement_um")).all()
    estimates_um = seen.column("model_um")
    assert estimates_um.min() == pytest.approx(0.0, abs=1.0)
    assert estimates_um.max() > 300.0  # the conditioning swings
    assert all(math.isnan(touch.displacement_um) for touch in seen.touches)
    pad = [touch.model_um for touch in seen.touches if touch.kind == "Z1"]
    assert min(pad) <= site.z1_um <= max(pad)
    assert (site.depth_basis, site.wear_basis) == (Basis.MODEL, Basis.MODEL)
    assert site.depth_model_um == pytest.approx(site.depth_um)
    assert math.isnan(site.feed_model_error_max_um)
    assert blind.shop.bench.controller.seen.sensor_fitted == 0
    status = blind.shop.machine.status()
    assert status.displacement_um == pytest.approx(2.967 * status.actuator_v, abs=1e-3)


def test_the_host_ends_a_cut_where_the_estimate_reaches_its_limit(blind: Done) -> None:
    seen = blind.shop.seen
    planned = seen.args(RunEvent.CUT_PLANNED)
    ended_s = [time_s for time_s, code, _, _, _ in seen.events if code == EventCode.STOPPED]
    assert len(planned) == len(ended_s) == blind.result.sites[0].cuts
    times_s = seen.column("time_s")
    estimates_um = seen.column("model_um")
    for cut, end_s in zip(planned, ended_s, strict=True):
        last_um = estimates_um[(times_s > end_s - 0.2) & (times_s <= end_s)].mean()
        assert last_um == pytest.approx(float(cut["z_limit_um"]), abs=0.5)


def test_without_a_calibration_nothing_moves() -> None:
    s = Shop(sensor=False)
    with pytest.raises(PreconditionError, match=r"no calibration of SIM-1") as caught:
        s.run_job()
    assert "edmctl calibrate" in caught.value.hint
    assert s.machine.status().state is MachineState.IDLE
    assert s.seen.events == []


@pytest.mark.parametrize("known", tiers(True, slow=(False,)))
def test_a_sensor_that_should_be_there_and_is_not_is_refused(*, known: bool) -> None:
    s = Shop(calibration=calibrated() if known else None)
    s.bench.plant.unit.sensor_gain = 0.0
    with refused("E8033", "per volt while the actuator swings"):
        s.run_job()
    assert s.machine.status().state is MachineState.IDLE


def test_a_touch_that_finds_no_surface_ends_as_with_a_sensor() -> None:
    """The pad is 60 µm further away than the recipe says: no contact is a fault, not a plunge."""
    s = Shop(calibration=calibrated(), sensor=False)
    s.bench.plant._offset_um += 60.0
    with pytest.raises(MachineFault) as caught:
        s.run_job()
    assert caught.value.fault == 2005
    assert s.machine.status().actuator_v < 120.0


def scan_on(machine: SensorlessMachine, duration_s: float) -> None:
    end_s = machine.time_s + duration_s
    while machine.time_s < end_s:
        assert machine.watch_cut(0.1) is None


def test_a_scanning_tool_is_held_where_the_inverse_puts_it_and_the_controller_keeps_its_zero() -> None:
    s = Shop(calibration=calibrated(), sensor=False)
    run, settings = s.run(), controller_settings(s.profile, s.job.setup)
    machine = SensorlessMachine(s.machine, calibrated(), settings.gain_um_per_v)
    machine.configure(settings, pulse_settings(s.profile))
    machine.start_telemetry(telemetry_settings(s.profile, s.job.setup), run.watch)
    machine.arm()
    machine.set_zero(30.0)
    assert s.bench.controller.seen.zero_um == 0.0
    machine.ramp(12.0, 50.0)
    machine.rest(1.0)
    machine.start_scan(CutRequest(9.6, 20.0, 100.0))
    scan_on(machine, 8.0)
    assert s.bench.plant.state.true_z_um == pytest.approx(20.0, abs=1.5)
    x_um = machine.status().x_um
    assert machine.path_move(ScanLine(x_um - 30.0, 0.0, 20.0, 26.0, last=False))
    scan_on(machine, 3.0)
    assert s.bench.plant.state.true_z_um == pytest.approx(26.0, abs=1.5)
    assert machine.status().x_um == pytest.approx(x_um - 30.0)
    assert machine.stop_cut().code is EventCode.STOPPED


def test_without_samples_there_is_no_estimate_and_no_cut() -> None:
    s = Shop(calibration=calibrated(), sensor=False)
    s.inject("SAMPLES_LOST")
    with refused("E4022", "do not come any more"):
        s.run_job()
    ((_, lost_tick),) = s.bench.controller.injector.applied
    assert s.tally.time_s < lost_tick * TICK_S + 5.0
    assert s.bench.is_safe
