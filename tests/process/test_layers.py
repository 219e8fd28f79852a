"""Layers of a channel: their depths, the speed that removal allows, and where the tool is held."""

from __future__ import annotations

import numpy as np
import pytest

from edmctl.process.channel import HeldTool, layer_depths_um, passes_needed
from edmctl.process.plane import Plane

TILTED = Plane((0.0, 0.0), np.array([0.001, -0.002]), np.zeros((2, 2)))


def test_layers_are_equal_and_end_at_the_target() -> None:
    assert layer_depths_um(0.0, 25.0, 2.0) == pytest.approx([25.0 * i / 13 for i in range(1, 14)])
    assert layer_depths_um(20.5, 25.0, 2.0) == pytest.approx([22.0, 23.5, 25.0])


def test_a_little_more_than_whole_layers_makes_no_layer_of_its_own() -> None:
    assert len(layer_depths_um(0.0, 6.05, 2.0)) == 3
    assert len(layer_depths_um(0.0, 6.3, 2.0)) == 4
    assert layer_depths_um(24.95, 25.0, 2.0) == pytest.approx([25.0])


def test_nothing_is_cut_upwards() -> None:
    assert layer_depths_um(25.1, 25.0, 2.0) == ()


def test_a_fast_scan_needs_more_passes_for_a_layer() -> None:
    assert passes_needed(2.0, 166.0, 36.0, 12_000.0) == 1
    assert passes_needed(2.0, 166.0, 37.0, 12_000.0) == 2
    assert passes_needed(2.0, 166.0, 100.0, 12_000.0) == 3
    assert passes_needed(0.1, 166.0, 10.0, 12_000.0) == 1


def test_the_held_tool_follows_the_tilt_and_its_own_wear() -> None:
    held = HeldTool(50.0, TILTED, 8.0, 3.5)
    assert held.floor_um((1000.0, 0.0), 0.0) == pytest.approx(59.0)
    assert held.floor_um((0.0, 1000.0), 6.0) == pytest.approx(62.0)
    assert held.z_um((0.0, 1000.0), 6.0) == pytest.approx(58.5)
