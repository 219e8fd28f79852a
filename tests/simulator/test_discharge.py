"""The gap process: Laue line, voltage law, energy, and what each pulse leaves behind."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from edmctl.link.messages import PulseClass
from edmctl.simulator import BenchConfig
from edmctl.simulator.plant import BLOCK, Plant
from tests.simulator.struck_pulses import strike
from tests.tiers import tiers

ON_TIME_US = 130.435
# Normalised mean gap voltage against the gap, clean oil, 40 V, 30 %.
VOLTAGE_LAW = {
    1.0: 0.556,
    1.5: 0.571,
    2.0: 0.616,
    2.5: 0.703,
    3.0: 0.803,
    3.5: 0.877,
    4.0: 0.924,
    5.0: 0.967,
    6.0: 0.984,
    8.0: 0.995,
}


def fixed_gap(
    gap_um: float, pulses: int, seed: int = 3, rarity: float = 1.0
) -> tuple[float, NDArray[np.void]]:
    """Strike pulses at a gap held fixed in clean oil; returns (mean gap voltage, pulse records).

    `rarity` is the face of the tool over what of the sheet is left under it.
    """
    plant = Plant(BenchConfig(), seed)
    state = plant.state
    state.rarity = rarity
    taken, voltage_sum, count = [], 0.0, 0
    while count < pulses:
        state.debris_um3 = state.depth_um = state.wear_um = 0.0
        state.true_z_um = state.surface_um - gap_um
        sum_v, struck = strike(plant)
        voltage_sum, count = voltage_sum + sum_v, count + len(struck)
        taken.append(struck)
        plant.readings.tick += 1
    return voltage_sum / count, np.concatenate(taken)


@pytest.mark.slow
def test_ignition_is_rarer_by_the_share_of_the_face_that_has_nothing_under_it() -> None:
    tau_us = []
    for rarity in (1.0, 4.0):
        _, pulses = fixed_gap(2.5, 20_000, rarity=rarity)
        unlit = float((pulses["pulse_class"] == PulseClass.OPEN).mean())
        tau_us.append(ON_TIME_US / -math.log(unlit))
    assert tau_us[1] / tau_us[0] == pytest.approx(4.0, rel=0.06)
    _, pulses = fixed_gap(2.5, 1000, rarity=math.inf)
    assert (pulses["pulse_class"] == PulseClass.OPEN).mean() > 0.99


def test_ignition_delays_follow_a_laue_line() -> None:
    _, pulses = fixed_gap(3.0, 40_000)
    ignited = np.sort(pulses["delay_us"][pulses["pulse_class"] == PulseClass.NORMAL])
    survivors = 1.0 - (np.arange(ignited.size) + 0.5) / len(pulses)
    inside = (ignited > 5.0) & (ignited < 0.9 * ON_TIME_US)
    x, y = ignited[inside], np.log(survivors[inside])
    slope, offset = np.polyfit(x, y, 1)
    residual = y - (slope * x + offset)
    assert 1.0 - residual.var() / y.var() > 0.98
    assert slope < 0.0


@pytest.mark.parametrize("gap_um", tiers(3.5, slow=(1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0)))
def test_mean_voltage_follows_the_gap(gap_um: float) -> None:
    mean_v, _ = fixed_gap(gap_um, 40_000)
    assert mean_v / (0.3 * 40.0) == pytest.approx(VOLTAGE_LAW[gap_um], abs=0.01)


def test_a_closed_gap_is_a_short_and_an_open_one_stays_open() -> None:
    shorted_v, shorts = fixed_gap(-0.5, 2_000)
    open_v, opens = fixed_gap(30.0, 2_000)
    assert np.all(shorts["pulse_class"] == PulseClass.SHORT)
    assert shorted_v == pytest.approx(0.3, abs=0.01)
    assert np.all(opens["pulse_class"] == PulseClass.OPEN)
    assert open_v == pytest.approx(12.0, abs=0.001)


def test_random_tables_have_the_moments_of_their_distributions() -> None:
    plant = Plant(BenchConfig(), 5)
    half, volume = plant.random.tables
    assert half.mean() == pytest.approx(math.sqrt(2.0 / math.pi), abs=0.003)
    assert (half**2).mean() == pytest.approx(1.0, abs=0.01)
    assert volume.mean() == pytest.approx(1.0, abs=0.003)
    assert np.log(volume).std() == pytest.approx(0.3, abs=0.005)


def test_random_numbers_do_not_depend_on_where_blocks_end() -> None:
    def draw(step: int) -> NDArray[np.float64]:
        plant = Plant(BenchConfig(), 9)
        out = []
        for _ in range(0, 3 * BLOCK, step):
            plant.random.provide(plant.state, step, step)
            at = plant.state.random_at
            out.append(plant.random.pulse[:, at : at + step].copy())
            plant.state.random_at += step
        return np.concatenate(out, axis=1)

    assert np.array_equal(draw(512), draw(4096))


@pytest.mark.parametrize(
    ("exponent", "within"), [(3.0, 0.0), (4.0, 0.0), (3.87, 0.04), (4.12, 0.04), (5.5, 0.13)]
)
def test_the_delay_grows_about_as_the_power_of_the_gap_that_a_unit_has_drawn(
    exponent: float, within: float
) -> None:
    plant = Plant(BenchConfig(), 3)
    unit, state = plant.unit, plant.state
    unit.gap_exponent, unit.tau_reference_us = exponent, 1.0
    unit.formative_us = unit.roughness_um = unit.arc_base = 0.0
    plant.random.provide(state, 64, 1)
    decide, _, delay = plant.random.pulse
    decide[:], delay[:] = 0.5, 1.0
    for base in (0.5, 0.8, 1.0, 1.3, 2.0):
        state.true_z_um = state.surface_um - base / unit.per_open_gap
        state.debris_um3 = state.depth_um = state.wear_um = 0.0
        state.previous_burning = -1.0
        _, pulses = strike(plant)
        assert pulses["delay_us"][0] == pytest.approx(base**exponent, rel=within + 1e-9)
        plant.readings.tick += 1
