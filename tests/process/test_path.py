"""Ways in the plane: where they go, how long they are, and where on them something is."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edmctl.process.path import circle, even_places, lengths_um, rectangle, spiral, way_of

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


def test_a_place_beside_the_way_belongs_to_the_nearest_of_it() -> None:
    way = way_of(rectangle(0.0, 0.0, 600.0, 400.0), 25.0)
    assert way.length_at(-137.0, -199.0, 150.0, 100.0) == pytest.approx(163.0)


def test_where_the_way_comes_by_twice_the_lap_decides() -> None:
    way = way_of(rectangle(0.0, 0.0, 600.0, 400.0), 25.0)
    start_um = way.at(0.0)
    assert way.length_at(*start_um, 30.0, 100.0) == pytest.approx(0.0)
    assert way.length_at(*start_um, way.length_um - 30.0, 100.0) == pytest.approx(way.length_um)


def test_even_places_keep_off_the_ends() -> None:
    way = way_of(circle(0.0, 0.0, 300.0), 25.0)
    places_um = even_places(way, 4)
    assert places_um == pytest.approx([way.length_um * share for share in (0.125, 0.375, 0.625, 0.875)])
