"""What makes one virtual machine another: its serial, and whether it has a displacement sensor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from edmctl.link import messages as m
from edmctl.simulator import BenchConfig
from edmctl.simulator.config import SensorConstants
from edmctl.simulator.plant import serial_number

if TYPE_CHECKING:
    from .conftest import Rig

NO_SENSOR = BenchConfig(sensors=SensorConstants(fitted=False))


def test_the_serial_is_made_of_the_seed(rig: Callable[..., Rig]) -> None:
    assert rig(seed=7).session.hello.serial == "SIM-7"
    assert serial_number(99_999_999) == "SIM-99999999"


def test_seeds_too_long_for_a_serial_are_hashed_apart() -> None:
    serials = {serial_number(10**8 + seed) for seed in range(1000)}
    assert len(serials) == 1000
    assert all(len(serial) == 12 and serial.isascii() for serial in serials)
    assert all(serial.startswith("SIM-x") for serial in serials)


def test_the_same_seed_is_the_same_actuator_with_and_without_a_sensor(rig: Callable[..., Rig]) -> None:
    with_one, without = rig(), rig(NO_SENSOR)
    unit, other = with_one.bench.plant.unit, without.bench.plant.unit
    assert np.array_equal(unit.array("play_um_per_v"), other.array("play_um_per_v"))
    assert unit.actuator_zero_um == other.actuator_zero_um


def ramped(rig: Rig, volts: float) -> None:
    rig.session.request(m.TlmStart(10_000, 10, m.PulseLog.OFF))
    rig.session.request(m.PiezoSet(volts, 100.0))
    rig.wait(m.EventCode.MOVE_DONE, 5.0)
    rig.session.pump(0.3)


def test_a_missing_sensor_reads_noise_about_zero(rig: Callable[..., Rig]) -> None:
    r = rig(NO_SENSOR).arm()
    ramped(r, 60.0)
    read_um = r.column("displacement_um")
    assert np.abs(read_um).max() < 1.0
    assert read_um.std() == pytest.approx(0.15, rel=0.3)


@pytest.mark.parametrize("config", [BenchConfig(), NO_SENSOR])
def test_a_controller_told_of_no_sensor_counts_volts_times_its_mean_gain(
    rig: Callable[..., Rig], config: BenchConfig
) -> None:
    r = rig(replace(config)).arm({"sensor_fitted": 0.0, "gain_um_per_v": 2.5})
    ramped(r, 60.0)
    assert r.column("displacement_um") == pytest.approx(2.5 * r.column("actuator_v"), abs=1e-3)
    assert r.column("displacement_um")[-1] == pytest.approx(150.0, abs=1e-3)
