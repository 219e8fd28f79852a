"""The face of the work as a plane, and the way over it."""

from __future__ import annotations

import numpy as np
import pytest

from edmctl.planning.forecast import nearest_first
from edmctl.process.plane import fitted_plane, spread_out, unknown_plane


def test_three_touches_tell_a_tilt() -> None:
    places = [(1000.0, 0.0), (0.0, 1000.0), (1000.0, 1000.0)]
    heights = [0.3, -0.2, 0.1]
    plane = fitted_plane((0.0, 0.0), places, heights, 0.01, 1.0)
    assert plane.height_um(500.0, 500.0) == pytest.approx(0.05, abs=0.01)
    assert plane.height_um(0.0, 0.0) == 0.0


def test_the_stated_uncertainty_of_a_height_is_its_scatter() -> None:
    generator = np.random.default_rng(5)
    places = [(1300.0, 800.0), (900.0, 0.0), (500.0, 800.0)]
    errors, stated = [], 0.0
    for _ in range(2000):
        slope = generator.normal(0.0, 0.3e-3, 2)
        pad = generator.normal(0.0, 0.15)
        heights = [float(slope @ place) + generator.normal(0.0, 0.15) - pad for place in places]
        plane = fitted_plane((0.0, 0.0), places, heights, 0.15, 0.3)
        errors.append(plane.height_um(1300.0, 0.0) - slope[0] * 1300.0)
        stated = plane.height_u_um(1300.0, 0.0)
    assert np.std(errors) == pytest.approx(stated, rel=0.1)


def test_places_in_a_line_leave_the_other_direction_as_unknown_as_before() -> None:
    line = fitted_plane((0.0, 0.0), [(500.0, 0.0), (1000.0, 0.0)], [0.1, 0.2], 0.1, 0.3)
    assert line.height_u_um(0.0, 1000.0) == pytest.approx(0.3, rel=0.01)
    assert line.height_u_um(1000.0, 0.0) < 0.2


def test_a_face_touched_once_is_level_within_the_tilt() -> None:
    plane = unknown_plane((100.0, 0.0), 0.3)
    assert plane.height_um(1100.0, 0.0) == 0.0
    assert plane.height_u_um(1100.0, 0.0) == pytest.approx(0.3)


def test_the_nearest_place_comes_next() -> None:
    places = [(900.0, 0.0), (500.0, 0.0), (500.0, 400.0), (900.0, 400.0)]
    assert nearest_first(places, (0.0, 0.0)) == (1, 0, 3, 2)
    assert nearest_first([], (0.0, 0.0)) == ()


def test_touches_for_a_plane_lie_far_apart() -> None:
    places = [(float(x), float(y)) for y in (0, 400, 800) for x in (500, 900, 1300)]
    chosen = {places[i] for i in spread_out(places, (0.0, 0.0), 3)}
    assert (1300.0, 800.0) in chosen
    assert len(chosen) == 3
    assert spread_out(places[:2], (0.0, 0.0), 3) == (1, 0)
