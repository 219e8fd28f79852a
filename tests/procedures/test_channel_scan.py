"""Passes of a channel; layers by passes to and fro until the tool was held, given up where that does not help."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from edmctl.errors import MachineFault, PreconditionError
from edmctl.machine.interface import EventCode, MachineEvent
from edmctl.procedures.channel import layers as channel_layers
from edmctl.procedures.channel.layers import LOOK_AHEAD_S, SPARE_PASSES, Layers, PassFollower
from edmctl.procedures.channel.touching import ChannelSurface, PassPlan, PassResult
from edmctl.procedures.servo.limits import UNSTABLE_S, TimeLeft, TimeLimits
from edmctl.procedures.touch.reading import SurfaceReading
from edmctl.process.channel import HeldTool, ToolWear, Way, circle, rectangle, way_of
from edmctl.process.plane import Plane
from edmctl.process.touches import Reading
from edmctl.profile.places import Place
from edmctl.record.rows import RunEvent
from tests.procedures.channel_bench import Noted, ScanningMachine, scanning_run

WAY = way_of(rectangle(0.0, 0.0, 300.0, 200.0), 25.0)
LEVEL = Plane((0.0, 0.0), np.zeros(2), np.zeros((2, 2)))
PER_UJ = 1e-6
SPEED_UM_S = 50.0


def machine_at_start(**settings: object) -> ScanningMachine:
    return ScanningMachine(place_um=WAY.at(0.0), z_um=40.0, **settings)  # type: ignore[arg-type]


def plan(*, plane: Plane = LEVEL, uj_per_um: float = 0.0, way: Way = WAY) -> PassPlan:
    return PassPlan(way, SPEED_UM_S, HeldTool(50.0, plane, 2.0, 3.5), uj_per_um, since_uj=0.0, rest_s=0.0)


def passed(machine: ScanningMachine, planned: PassPlan, left_s: float = 1e4) -> PassResult:
    run, _ = scanning_run(machine)
    return PassFollower(run, planned, ToolWear(PER_UJ, 0.1, 0.15)).run(left_s, "the time is up")


def test_every_line_is_sent_once_in_order_shortly_before_the_tool_needs_it() -> None:
    machine, usual = machine_at_start(queue_size=3, open_pulses=23), machine_at_start()
    done = passed(machine, plan())
    assert machine.full > 0
    assert [(m.x_um, m.y_um) for m in machine.moves] == [tuple(p) for p in WAY.points[1:]]
    assert [m.last for m in machine.moves] == [False] * (len(WAY.points) - 2) + [True]
    assert {m.speed_um_s for m in machine.moves} == {SPEED_UM_S}
    assert done.time_s == pytest.approx(WAY.length_um / SPEED_UM_S, abs=0.5)
    assert (done.fault, done.open_share) == ("", 1.0)
    assert done.energy_j == pytest.approx(22.0 * 0.01 * done.time_s, rel=0.02)
    assert not math.isnan(done.gap_ratio_mean)
    passed(usual, plan())
    assert 3 <= usual.longest_queue <= 1 + (SPEED_UM_S * LOOK_AHEAD_S + 25.0) / 25.0


def test_the_limit_follows_the_tilt_of_the_face() -> None:
    tilted = Plane((0.0, 0.0), np.array([0.002, -0.001]), np.zeros((2, 2)))
    machine = machine_at_start(current_a=0.0)
    passed(machine, plan(plane=tilted))
    for move in machine.moves:
        assert move.z_limit_um == pytest.approx(48.5 + 0.002 * move.x_um - 0.001 * move.y_um)


def test_the_limit_sinks_by_the_wear_that_the_energy_tells() -> None:
    machine = machine_at_start(current_a=0.02)
    done = passed(machine, plan(uj_per_um=1.2 * 22.0 * 0.02 * 1e6 / SPEED_UM_S))
    wear_um = PER_UJ * done.wearing_uj
    assert wear_um > 2.0
    assert machine.moves[-1].z_limit_um - 48.5 == pytest.approx(wear_um, rel=0.05)
    middle = len(WAY.points) // 2
    assert done.limits_um[middle] - 48.5 == pytest.approx(PER_UJ * done.used_uj[middle], rel=0.05)


def test_what_was_expected_of_the_energy_counts_less_and_less() -> None:
    machine = machine_at_start(current_a=0.0)
    passed(machine, plan(uj_per_um=5e3))
    sunk_um = [m.z_limit_um - 48.5 for m in machine.moves]
    assert sunk_um[0] > 0.1
    assert sunk_um[-1] < 0.5
    assert sunk_um[-1] < PER_UJ * 5e3 * WAY.length_um / 5.0


@pytest.mark.parametrize(
    ("misses_um", "held_share"), [(lambda s: 1.0 if 6.0 < s < 11.0 else 0.0, 0.75), (lambda _: 3.0, 0.0)]
)
def test_the_share_of_the_path_at_the_limit_is_reported_and_the_tool_continues(
    misses_um: Callable[[float], float], held_share: float
) -> None:
    done = passed(machine_at_start(misses_um=misses_um), plan())
    assert done.fault == ""
    assert done.held_share == pytest.approx(held_share, abs=0.04)


def test_the_host_ends_a_pass_when_the_time_is_up() -> None:
    machine = machine_at_start()
    done = passed(machine, plan(), left_s=3.0)
    assert machine.stopped == 1
    assert (done.fault, done.message) == ("TIMEOUT", "the time is up")
    assert done.time_s == pytest.approx(3.0, abs=0.2)
    assert machine.scans[0].max_time_s > 3.0


def test_a_line_that_is_refused_shows_the_end_or_the_fault_behind_it() -> None:
    ended = MachineEvent(EventCode.TIME_UP, 4.0, 0, 48.5, 16.0)
    assert passed(machine_at_start(refuse_after=5, then=lambda: ended), plan()).fault == "TIMEOUT"

    def fault() -> MachineEvent:
        raise MachineFault("The short did not clear.", code="E63001")

    with pytest.raises(MachineFault, match="did not clear"):
        passed(machine_at_start(refuse_after=5, then=fault), plan())
    with pytest.raises(PreconditionError, match="PATH_MOVE"):
        passed(machine_at_start(refuse_after=5), plan())


def test_arcs_over_their_limit_are_told_once_and_end_the_pass_when_they_stay() -> None:
    machine = machine_at_start(arc_pulses=6)
    run, noted = scanning_run(machine)
    slow = replace(plan(), speed_um_s=10.0)
    done = PassFollower(run, slow, ToolWear(PER_UJ, 0.1, 0.15)).run(1e4, "the time is up")
    assert (done.fault, done.message) == ("STALL", "arcs have stayed over their limit")
    assert UNSTABLE_S < done.time_s < UNSTABLE_S + 5.0
    assert noted.codes.count(RunEvent.ARCING) == 1
    assert passed(machine_at_start(arc_pulses=2), slow).fault == ""


RING = way_of(circle(0.0, 0.0, 100.0), 25.0)
FACE = ChannelSurface(SurfaceReading("Z1", Reading(50.0, 0.1, 3), 50.0, 17.0, 0.0, 0.0), LEVEL)


class Engaged:
    """Counts how often the tool was brought to the path."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.bottoms_um: list[float] = []
        self.places: list[tuple[float, float]] = []
        monkeypatch.setattr(channel_layers, "move_to", self._move)
        monkeypatch.setattr(channel_layers, "approach_bottom", self._approach)

    def _move(self, _: object, place: Place) -> None:
        self.places.append((place.x_um, place.y_um))

    def _approach(self, _: object, bottom_um: float, _bottom_u_um: float) -> None:
        self.bottoms_um.append(bottom_um)


@pytest.fixture
def engaged(monkeypatch: pytest.MonkeyPatch) -> Engaged:
    return Engaged(monkeypatch)


def layers_on(
    machine: ScanningMachine, left_s: float = 1e5, asked_um_s: float = 100.0
) -> tuple[Layers, Noted]:
    machine.place_um = RING.at(0.0)
    run, noted = scanning_run(machine)
    limits = SimpleNamespace(left=lambda: TimeLeft(left_s - machine.time_s, "that is all the time"))
    return Layers(run, cast("TimeLimits", limits), RING, FACE, asked_um_s), noted


def directions(machine: ScanningMachine) -> list[float]:
    """Sense of rotation of each pass: +1 to the left."""
    lines = len(RING.points) - 1
    turns = []
    for first in range(0, len(machine.moves), lines):
        a, b = machine.moves[first], machine.moves[first + 1]
        turns.append(float(np.sign(a.x_um * b.y_um - a.y_um * b.x_um)))
    return turns


def test_layers_follow_each_other_to_and_fro_without_lifting_the_tool(engaged: Engaged) -> None:
    machine = ScanningMachine(z_um=46.0, current_a=0.0)
    layers, noted = layers_on(machine)
    for depth_um in (2.0, 4.0, 6.0):
        assert layers.cut(depth_um, 3, even_out=False) == ("", "")
    assert directions(machine) == [1.0, -1.0, 1.0]
    assert len(engaged.bottoms_um) == 1
    assert engaged.bottoms_um[0] == pytest.approx(50.0)
    sunk_um = [scan.z_limit_um for scan in machine.scans]
    assert np.diff(sunk_um) == pytest.approx([2.0, 2.0], abs=0.2)
    assert noted.codes.count(RunEvent.PASS_ENDED) == 3
    assert (layers.layers, layers.depth_um) == (3, 6.0)


def test_a_layer_is_repeated_at_the_same_height_until_the_tool_was_held(engaged: Engaged) -> None:
    lines = len(RING.points) - 1
    machine = ScanningMachine(z_um=46.0, current_a=0.0)
    machine.misses_um = lambda _: 1.0 if len(machine.moves) <= 3 * lines else 0.0
    layers, _ = layers_on(machine)
    assert layers.cut(2.0, 0, even_out=False) == ("", "")
    assert layers.sums.number == 4
    assert len({scan.z_limit_um for scan in machine.scans}) == 1


def test_a_tool_that_never_gets_there_ends_the_channel(engaged: Engaged) -> None:
    machine = ScanningMachine(z_um=46.0, misses_um=lambda _: 1.0)
    layers, _ = layers_on(machine)
    fault, told = layers.cut(2.0, 0, even_out=False)
    assert fault == "STALL"
    assert "held on 0 % of the path" in told
    assert SPARE_PASSES < layers.sums.number < 20
    assert layers.depth_um == 0.0


def test_evening_out_goes_on_at_the_same_height_until_hardly_a_spark_is_left(engaged: Engaged) -> None:
    lines = len(RING.points) - 1
    machine = ScanningMachine(z_um=46.0, current_a=0.0, open_pulses=8, quiet_after=2 * lines)
    layers, _ = layers_on(machine)
    assert layers.cut(2.0, 0, even_out=True) == ("", "")
    assert layers.sums.number == 3
    assert layers.depth_um == 2.0
    limits_um = [scan.z_limit_um for scan in machine.scans]
    assert max(limits_um) - min(limits_um) < 1.0


def test_no_pass_begins_when_the_time_is_up(engaged: Engaged) -> None:
    machine = ScanningMachine(z_um=46.0)
    layers, _ = layers_on(machine, left_s=0.0)
    assert layers.cut(2.0, 0, even_out=False) == ("TIMEOUT", "that is all the time")
    assert machine.scans == []
