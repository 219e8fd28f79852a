"""The dirty gap: arcs, bridges, narrowing, removal and wear, flushing, and what a retraction draws in."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from edmctl.simulator import BenchConfig, DischargeConstants
from edmctl.simulator.controller_state import ARC, NORMAL, SHORT
from edmctl.simulator.plant import Plant
from edmctl.simulator.plant_interface import TICK_NS, TICK_S
from edmctl.simulator.plant_kernel import pump, renew_clearing
from tests.simulator.struck_pulses import PulseLog
from tests.tiers import tiers

if TYPE_CHECKING:
    from numpy.typing import NDArray

D = DischargeConstants()


@dataclass
class Struck:
    """Pulses struck at a gap and debris fraction held fixed."""

    classes: NDArray[np.uint8]
    energy_uj: NDArray[np.float64]
    depth_um: float
    wear_um: float
    mean_v: float
    plant: Plant


def strike(
    fraction: float,
    gap_um: float,
    pulses: int,
    constants: DischargeConstants = D,
    *,
    keep_carbon: bool = False,
) -> Struck:
    """Strike pulses in the same dirty gap again and again; depth, wear and debris start from zero each time."""
    plant = Plant(BenchConfig(discharge=constants), 3)
    unit, state, log = plant.unit, plant.state, PulseLog(plant)
    taken = []
    count, depth, wear, voltage = 0, 0.0, 0.0, 0.0
    renew_clearing(unit.shared[0], state.shared[0])
    while count < pulses:
        state.depth_um = state.wear_um = 0.0
        state.carbon *= keep_carbon
        state.debris_um3 = fraction * unit.tool_area_um2 * max(gap_um, 0.3)
        state.true_z_um = state.surface_um - gap_um
        # One pulse a call, so that debris and gap are the same for each.
        plant.readings.tick = state.next_pulse_ns // TICK_NS
        state.next_pulse_ns = (plant.readings.tick + 1) * TICK_NS - 1
        sum_v, struck = log.strike()
        assert len(struck) == 1
        taken.append(struck)
        count, voltage = count + 1, voltage + sum_v
        depth, wear = depth + state.depth_um, wear + state.wear_um
    records = np.concatenate(taken)
    plateau = records["plateau_v"] * 0.5
    energy = plateau * (40.0 - plateau) / 150.0 * records["discharge_us"] * 0.1
    energy[records["pulse_class"] % 3 == 0] = 0.0
    return Struck(records["pulse_class"], energy, depth, wear, voltage / count, plant)


@pytest.mark.parametrize("fraction", tiers(slow=(0.1, 0.25, 0.4)))
def test_arcs_come_as_often_as_debris_says_also_right_after_a_bridge(fraction: float) -> None:
    # A gap of 1 µm makes bridges frequent; they hold until they burn off, because the gap does not grow.
    struck = strike(
        fraction, 1.0, 60_000, constants=replace(D, bridge_base=0.2, bridge_clear=0.3, roughness_um=0.0)
    )
    classes = struck.classes
    expected = D.arc_base + D.arc_debris * fraction**2
    ignited = np.isin(classes, (NORMAL, ARC))
    share = np.count_nonzero(classes == ARC) / np.count_nonzero(ignited)
    assert share == pytest.approx(expected, rel=0.05)
    after = ignited[1:] & (classes[:-1] == SHORT)
    sample = np.count_nonzero(after)
    assert sample > 20
    share_after = np.count_nonzero(classes[1:][after] == ARC) / sample
    assert share_after == pytest.approx(expected, abs=4.0 * math.sqrt(expected * (1.0 - expected) / sample))


@pytest.mark.slow
def test_a_bridge_forms_as_often_as_debris_and_gap_say() -> None:
    constants = replace(D, bridge_clear=1.0, roughness_um=0.0)
    struck = strike(0.3, 1.0, 60_000, constants=constants)
    expected = D.bridge_base * (0.3 / D.bridge_debris) ** 3 * math.exp(-1.0 / D.bridge_gap_um)
    assert np.count_nonzero(struck.classes == SHORT) / struck.classes.size == pytest.approx(expected, rel=0.1)


def test_debris_narrows_the_gap() -> None:
    constants = replace(D, arc_debris=0.0, bridge_base=0.0)
    clean = strike(0.0, 3.0 * (1.0 - D.debris_gap_factor * 0.1), 20_000, constants)
    dirty = strike(0.1, 3.0, 20_000, constants)
    assert dirty.mean_v == pytest.approx(clean.mean_v, rel=0.01)


def test_removal_follows_energy_and_wear_follows_removal() -> None:
    struck = strike(0.0, 1.5, 30_000, constants=replace(D, arc_base=0.0))
    plant = struck.plant
    removed = struck.depth_um / plant.state.per_hole_area
    frontal = 1.0 - D.side_base
    assert removed / struck.energy_uj.sum() == pytest.approx(D.kappa_um3_per_uj * frontal, rel=0.02)
    worn = struck.wear_um / plant.unit.per_tool_area
    assert worn / removed == pytest.approx(0.337, rel=1e-6)


def test_an_arc_removes_a_third_and_wears_three_times_as_much() -> None:
    struck = strike(0.0, 1.5, 20_000, constants=replace(D, arc_base=1.0, side_base=0.0))
    plant = struck.plant
    removed = struck.depth_um / plant.state.per_hole_area
    assert removed / struck.energy_uj.sum() == pytest.approx(0.3 * D.kappa_um3_per_uj, rel=0.02)
    assert struck.wear_um / plant.unit.per_tool_area / removed == pytest.approx(3.0 * 0.337, rel=1e-6)


def test_twenty_arcs_in_a_row_begin_to_build_carbon() -> None:
    struck = strike(0.0, 1.5, 60, constants=replace(D, arc_base=1.0), keep_carbon=True)
    arcs = np.count_nonzero(struck.classes == ARC)
    assert struck.plant.state.carbon == pytest.approx(arcs - 20, abs=1)


def test_debris_leaves_with_the_flush_time_of_tool_and_depth() -> None:
    for diameter_um, depth_um in ((270.0, 0.0), (150.0, 0.0), (270.0, 189.0)):
        plant = Plant(BenchConfig(tool_diameter_um=diameter_um), 1)
        plant.state.depth_um = depth_um
        renew_clearing(plant.unit.shared[0], plant.state.shared[0])
        flush_s = -TICK_S / math.log(plant.state.tick_clearing)
        expected_s = 0.5 * (diameter_um / 270.0) ** 2 * (1.0 + (depth_um / (0.7 * diameter_um)) ** 2)
        assert flush_s == pytest.approx(expected_s, rel=1e-9)
        period_s = -math.log(plant.state.clearing) * flush_s
        assert period_s == pytest.approx(plant.unit.pulse_period_ns * 1e-9, rel=1e-9)


def test_opening_the_gap_draws_oil_in_however_the_tool_moves() -> None:
    plant = Plant(BenchConfig(), 1)
    plant.stage_lands(0, 0.0)
    unit, state = plant.unit, plant.state
    state.depth_um = 100.0
    for step_um in (60.0, 1.0):
        state.debris_um3, state.carbon, state.opening_um = 1000.0, 60.0, 0.0
        for lifted_um in np.arange(step_um, 60.0 + 0.5 * step_um, step_um):
            pump(unit.shared[0], state.shared[0], lifted_um)
        refill_um3 = unit.annulus_area_um2 * 100.0 + 3.0 * unit.tool_area_um2
        expected = 1000.0 * math.exp(-unit.tool_area_um2 * 60.0 / refill_um3)
        assert state.debris_um3 == pytest.approx(expected, rel=1e-9)
        assert state.carbon == 0.0
