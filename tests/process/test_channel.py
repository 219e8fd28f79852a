"""Ways in the plane: where they go, how long they are, and where on them something is."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edmctl.process.channel import (
    HeldTool,
    ToolWear,
    circle,
    even_places,
    layer_depths_um,
    lengths_um,
    passes_needed,
    rectangle,
    spiral,
    way_of,
    wearing_uj,
)
from edmctl.process.live_erosion import Energy
from edmctl.process.plane import Plane

INNER_UM, PITCH_UM, TURNS = 150.0, 220.0, 2.5


def archimedes_um(radius_um: float) -> float:
    """Length from the centre to a radius, by the closed form."""
    growth_um = PITCH_UM / (2.0 * math.pi)
    phi = radius_um / growth_um
    return growth_um / 2.0 * (phi * math.hypot(1.0, phi) + math.asinh(phi))


def test_a_rectangle_is_as_long_as_its_sides_and_ends_where_it_begins() -> None:
    way = way_of(rectangle(100.0, -50.0, 600.0, 400.0), 25.0)
    assert way.length_um == pytest.approx(2000.0)
    assert way.at(0.0) == way.at(way.length_um) == pytest.approx((-200.0, -250.0))
    assert way.at(600.0) == pytest.approx((400.0, -250.0))


def test_chords_hardly_leave_their_circle_and_their_spiral() -> None:
    round_way = way_of(circle(0.0, 0.0, 300.0), 25.0)
    assert round_way.length_um == pytest.approx(2.0 * math.pi * 300.0, rel=1e-3)
    assert np.hypot(*round_way.points.T).min() > 299.0
    wound = spiral(0.0, 0.0, INNER_UM, PITCH_UM, TURNS)
    outer_um = INNER_UM + PITCH_UM * TURNS
    assert lengths_um(wound)[-1] == pytest.approx(archimedes_um(outer_um) - archimedes_um(INNER_UM), rel=2e-3)
    assert tuple(wound[-1]) == pytest.approx((-outer_um, 0.0), abs=1e-6)


def test_straight_lines_are_cut_into_equal_pieces_with_their_corners_kept() -> None:
    way = way_of(rectangle(0.0, 0.0, 110.0, 60.0), 25.0)
    steps_um = np.diff(way.lengths_um)
    assert steps_um.max() <= 25.0
    assert len(way.points) == 1 + 2 * 5 + 2 * 3
    for corner in ((55.0, -30.0), (55.0, 30.0), (-55.0, 30.0)):
        assert (np.abs(way.points - corner).max(axis=1) < 1e-9).any()


def test_backwards_the_same_places_come_in_the_other_order() -> None:
    way = way_of(spiral(0.0, 0.0, INNER_UM, PITCH_UM, TURNS), 25.0)
    back = way.reversed()
    for s_um in (0.0, 333.0, way.length_um):
        assert back.at(way.length_um - s_um) == pytest.approx(way.at(s_um))
    assert back.lengths_um[0] == 0.0
    assert np.all(np.diff(back.lengths_um) > 0.0)


def test_a_place_beside_the_way_belongs_to_the_nearest_of_it_on_its_lap() -> None:
    way = way_of(rectangle(0.0, 0.0, 600.0, 400.0), 25.0)
    assert way.length_at(-137.0, -199.0, 150.0, 100.0) == pytest.approx(163.0)
    start_um = way.at(0.0)
    assert way.length_at(*start_um, 30.0, 100.0) == pytest.approx(0.0)
    assert way.length_at(*start_um, way.length_um - 30.0, 100.0) == pytest.approx(way.length_um)


def test_even_places_keep_off_the_ends() -> None:
    way = way_of(circle(0.0, 0.0, 300.0), 25.0)
    assert even_places(way, 4) == pytest.approx([way.length_um * n / 8.0 for n in (1, 3, 5, 7)])


TILTED = Plane((0.0, 0.0), np.array([0.001, -0.002]), np.zeros((2, 2)))


def test_layers_are_equal_and_end_at_the_target() -> None:
    assert layer_depths_um(0.0, 25.0, 2.0) == pytest.approx([25.0 * i / 13 for i in range(1, 14)])
    assert layer_depths_um(20.5, 25.0, 2.0) == pytest.approx([22.0, 23.5, 25.0])
    assert len(layer_depths_um(0.0, 6.05, 2.0)) == 3  # a little more makes no layer of its own
    assert len(layer_depths_um(0.0, 6.3, 2.0)) == 4
    assert layer_depths_um(24.95, 25.0, 2.0) == pytest.approx([25.0])
    assert layer_depths_um(25.1, 25.0, 2.0) == ()


def test_a_fast_scan_needs_more_passes_for_a_layer() -> None:
    passes = [passes_needed(2.0, 166.0, speed_um_s, 12_000.0) for speed_um_s in (36.0, 37.0, 100.0)]
    assert passes == [1, 2, 3]
    assert passes_needed(0.1, 166.0, 10.0, 12_000.0) == 1


def test_the_held_tool_follows_the_tilt_and_its_own_wear() -> None:
    held = HeldTool(50.0, TILTED, 8.0, 3.5)
    assert held.floor_um((1000.0, 0.0), 0.0) == pytest.approx(59.0)
    assert held.floor_um((0.0, 1000.0), 6.0) == pytest.approx(62.0)
    assert held.z_um((0.0, 1000.0), 6.0) == pytest.approx(58.5)


KJ = 1e9
"""A kilojoule in µJ."""


def tool() -> ToolWear:
    return ToolWear(per_uj=1e-7, u_rel=0.14, touch_u_um=0.15)


def test_wear_grows_with_energy_and_so_does_its_uncertainty() -> None:
    assert wearing_uj(Energy(100.0, 0.0)) == 100.0
    assert wearing_uj(Energy(0.0, 100.0)) == pytest.approx(69.5454)
    wear = tool()
    assert wear.um(0.1 * KJ) == pytest.approx(10.0)
    assert wear.u_um(0.1 * KJ) == pytest.approx(1.41, abs=0.02)
    assert wear.u_um(0.0) == pytest.approx(0.15)


def test_a_long_cut_between_touches_teaches_the_rate_and_the_next_estimate_starts_at_the_touch() -> None:
    wear = tool()
    wear.learn(0.1 * KJ, 12.0, 0.1)
    assert wear.per_uj == pytest.approx(1.2e-7, rel=0.01)
    assert wear.u_rel < 0.03
    assert wear.um(0.0) == 12.0
    assert wear.um(0.05 * KJ) == pytest.approx(18.0, abs=0.1)


def test_a_short_cut_teaches_little_of_the_rate_but_all_of_the_length() -> None:
    wear = tool()
    wear.learn(0.001 * KJ, 0.4, 0.0)
    assert wear.per_uj == pytest.approx(1e-7, rel=0.02)
    assert wear.um(0.0) == 0.4


def test_drift_belongs_to_the_length_and_not_to_the_rate() -> None:
    steady, drifting = tool(), tool()
    steady.learn(0.02 * KJ, 2.6, 0.0)
    drifting.learn(0.02 * KJ, 2.6, 2.0)
    assert drifting.um(0.0) == steady.um(0.0) == 2.6
    assert abs(drifting.per_uj - 1e-7) < 0.2 * abs(steady.per_uj - 1e-7)


def test_a_wear_that_chance_does_not_explain_makes_the_belief_as_uncertain_as_it_was_wrong() -> None:
    wear = tool()
    wear.learn(0.1 * KJ, 4.0, 1.0)
    assert wear.per_uj == pytest.approx(0.5e-7, rel=0.2)
    assert abs(wear.per_uj - 0.4e-7) < 2.0 * wear.u_rel * wear.per_uj
