"""The actuator on its own is the actuator of the virtual bench."""

from __future__ import annotations

import numpy as np
import pytest

from edmctl.core.library import library
from edmctl.simulator import BenchConfig
from edmctl.simulator.plant import HIGH_V, RATE_HZ, SLEW_V_S, Plant, VirtualActuator

RISE = np.minimum(0.05 * np.arange(3000.0), 90.0)


def test_it_moves_as_the_actuator_of_the_bench_with_the_same_seed() -> None:
    driven = VirtualActuator(5).drive(RISE)
    plant = Plant(BenchConfig(), 5)
    expected = np.empty(RISE.size)
    for i, v in enumerate(driven.applied_v):
        library().actuator_tick(plant.unit.place, plant.state.place, v)
        expected[i] = plant.state.free_z_um
    assert np.array_equal(driven.truth_um, expected)


def test_calls_continue_one_another_wherever_they_are_cut() -> None:
    whole = VirtualActuator(2).drive(np.tile(RISE, 12))
    actuator = VirtualActuator(2)
    parts = [actuator.drive(part) for part in np.split(np.tile(RISE, 12), [1, 777, 20_000])]
    for name in ("t_s", "applied_v", "truth_um", "sensor_um"):
        assert np.array_equal(getattr(whole, name), np.concatenate([getattr(p, name) for p in parts]))


def test_units_differ_by_their_seed_alone() -> None:
    first, again, other = (VirtualActuator(seed).drive(RISE) for seed in (1, 1, 2))
    assert np.array_equal(first.sensor_um, again.sensor_um)
    assert abs(first.truth_um[-1] - other.truth_um[-1]) > 0.1


def test_the_controller_slows_clamps_and_rounds_the_command() -> None:
    applied = VirtualActuator(1).drive(np.full(400, 200.0)).applied_v
    assert np.diff(applied).max() == pytest.approx(SLEW_V_S / RATE_HZ)
    assert applied[-1] == HIGH_V
    fine = VirtualActuator(1).drive(np.full(1, 0.0062)).applied_v
    assert fine[0] == pytest.approx(0.005)
    assert VirtualActuator(1).drive(np.full(1, -1.0)).applied_v[0] == 0.0


def test_the_sensor_is_off_by_its_gain_error_and_its_noise() -> None:
    driven = VirtualActuator(1).drive(np.concatenate([RISE, np.full(20_000, 90.0)]))
    gain = Plant(BenchConfig(), 1).unit.sensor_gain
    rest = driven.sensor_um[5000:] - gain * driven.truth_um[5000:]
    assert abs(rest.mean()) < 0.3
    assert np.diff(rest).std() / np.sqrt(2.0) == pytest.approx(0.15, rel=0.05)
    assert abs(gain - 1.0) > 1e-4
