"""The mode switch of the plant: what stands at the gap, with a switch that is sound or stuck, and a gate that is."""

from __future__ import annotations

import math

import pytest

from edmctl.simulator import BenchConfig
from edmctl.simulator.plant import Plant
from edmctl.simulator.plant_records import STUCK_AT_CONTACT, STUCK_AT_GENERATOR, Drive, Readings
from tests.conformance import acts
from tests.conformance.lines import InProcess
from tests.conformance.peer import Peer


class Told:
    """A controller that puts the mode switch and the gate somewhere and keeps them there."""

    def __init__(self, *, generator: bool = False, pulses: bool = False) -> None:
        self.generator, self.pulses = int(generator), int(pulses)

    def __call__(self, readings: Readings, drive: Drive) -> None:
        drive.generator, drive.pulses_on = self.generator, self.pulses


@pytest.mark.parametrize("gate_stuck", [False, True])
@pytest.mark.parametrize("told", [False, True])
@pytest.mark.parametrize("stuck", [0, STUCK_AT_GENERATOR, STUCK_AT_CONTACT])
def test_a_gate_that_is_stuck_on_shows_where_the_generator_is_at_the_gap(
    stuck: int, told: bool, gate_stuck: bool
) -> None:
    plant = Plant(BenchConfig(), 1)
    plant.unit.mode_stuck, plant.unit.gate_stuck = stuck, int(gate_stuck)
    plant.advance(Told(generator=told), 2)
    there = told if stuck == 0 else stuck == STUCK_AT_GENERATOR
    if there and gate_stuck:
        assert plant.readings.gap_v == plant.unit.open_v
    else:
        assert math.isnan(plant.readings.gap_v)
    assert plant.readings.stray_pulses == plant.readings.pulses == 0  # the gate's driver makes no edges
    plant.hv_supply_ok = False
    plant.advance(Told(generator=told), 2)
    assert math.isnan(plant.readings.gap_v)


def test_pulses_end_at_a_switch_that_is_stuck_at_the_contact_circuit() -> None:
    plant = Plant(BenchConfig(offset_um=3.0), 1)  # near enough for sparks
    plant.stage_lands(0, 0.0)
    plant.advance(Told(pulses=True), 50)
    assert plant.readings.gap_v > 0.0
    depth_um, sparks = plant.state.depth_um, plant.scope.array("discharge_us").max()
    assert depth_um > 0.0
    assert sparks > 0.0
    plant.unit.mode_stuck = STUCK_AT_CONTACT
    for _ in range(50):
        plant.advance(Told(pulses=True), 1)
        r = plant.readings
        assert r.pulses > 0
        assert (r.gap_v, r.charge_uc) == (0.0, 0.0)
        assert all(r.array("plateau_v")[: r.pulses] == 0.0)
        assert not any(r.array("discharge_us")[: r.pulses])
    assert plant.state.depth_um == depth_um


def test_the_controller_tells_the_switch() -> None:
    """Generator at the gap in sparks, jumps and both halves of a self-test, the contact circuit otherwise."""
    line = InProcess()
    peer, drive = Peer(line), line.bench.plant.drive
    acts.settle(peer)
    assert drive.generator == 0
    acts.start_sparks(peer)
    peer.pump(0.002)
    assert (drive.generator, drive.pulses_on) == (1, 1)
    peer.ok("JUMP", height_um=1.0, speed_um_s=50.0, dwell_s=0.2, clearance_um=0.0)
    peer.pump(0.1)
    assert (drive.generator, drive.pulses_on) == (1, 0)
    peer.event("JUMP_DONE", 10.0)
    acts.rest(peer)
    assert (drive.generator, drive.pulses_on) == (0, 0)
