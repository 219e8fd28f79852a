"""The simulated actuator shows the paper's facts and lies outside every estimator's class."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from edmctl.core.library import library
from edmctl.simulator import BenchConfig
from edmctl.simulator.plant import Plant


def drive(plant: Plant, actuator_v: NDArray[np.float64]) -> NDArray[np.float64]:
    """Free displacement [µm] for a voltage sampled at 1 kHz."""
    out = np.empty(actuator_v.size)
    for i, v in enumerate(actuator_v):
        library().actuator_tick(plant.unit.place, plant.state.place, v)
        out[i] = plant.state.free_z_um
    return out


def sine(top_v: float, cycles: float, period_s: float) -> NDArray[np.float64]:
    t_s = np.arange(0.0, cycles * period_s, 1e-3)
    return np.asarray(0.5 * top_v * (1.0 - np.cos(2.0 * np.pi * t_s / period_s)))


@pytest.mark.slow
def test_full_stroke_is_445_um_at_150_v_on_average_over_units() -> None:
    strokes = []
    for seed in range(6):
        z = drive(Plant(BenchConfig(), seed), sine(150.0, 1.5, 20.0))
        strokes.append(np.ptp(z[10_000:]))
    assert np.mean(strokes) == pytest.approx(445.0, abs=8.0)


def test_loop_is_wide_creep_is_there_and_more_voltage_is_more_travel() -> None:
    plant = Plant(BenchConfig(), 1)
    u = sine(120.0, 2.0, 20.0)
    z = drive(plant, u)
    up = np.interp(60.0, u[20_000:30_000], z[20_000:30_000])
    down = np.interp(-60.0, -u[30_000:], z[30_000:])
    assert 0.10 < (down - up) / np.ptp(z[20_000:]) < 0.20
    step = drive(plant, np.full(20_000, 120.0))
    per_decade = (step[10_000] - step[1_000]) / step[100]
    assert 0.015 < per_decade < 0.045
    assert np.all(np.diff(z[21_000:29_000:50]) > 0.0)


def test_rest_is_zero_and_the_mode_rings_at_its_frequency() -> None:
    plant = Plant(BenchConfig(), 1)
    assert abs(drive(plant, np.zeros(200))[-1]) < 1e-6
    drive(plant, np.full(400, 50.0))
    plant.state.mode_velocity_um_s = 2000.0
    ring = drive(plant, np.full(100, 50.0))
    ring -= ring[-1]
    assert np.abs(ring[:10]).max() > 3.0 * np.abs(ring[40:60]).max()
