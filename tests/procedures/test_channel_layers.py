"""Layers: to and fro, repeated until the tool was held, given up where that does not help."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from edmctl.procedures.channel import layers as channel_layers
from edmctl.procedures.channel.layers import SPARE_PASSES, Layers
from edmctl.procedures.channel.touching import ChannelSurface
from edmctl.procedures.servo.limits import TimeLeft, TimeLimits
from edmctl.procedures.touch.reading import SurfaceReading
from edmctl.process.channel import circle, way_of
from edmctl.process.plane import Plane
from edmctl.process.touches import Reading
from edmctl.profile.places import Place
from edmctl.record.rows import RunEvent
from tests.procedures.channel_bench import Noted, ScanningMachine, scanning_run

WAY = way_of(circle(0.0, 0.0, 100.0), 25.0)
LEVEL = Plane((0.0, 0.0), np.zeros(2), np.zeros((2, 2)))
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
    machine.place_um = WAY.at(0.0)
    run, noted = scanning_run(machine)
    limits = SimpleNamespace(left=lambda: TimeLeft(left_s - machine.time_s, "that is all the time"))
    return Layers(run, cast("TimeLimits", limits), WAY, FACE, asked_um_s), noted


def directions(machine: ScanningMachine) -> list[float]:
    """Sense of rotation of each pass: +1 to the left."""
    lines = len(WAY.points) - 1
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
    lines = len(WAY.points) - 1
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
    lines = len(WAY.points) - 1
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
