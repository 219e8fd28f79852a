"""The face of the work as a plane, and the way over it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edmctl.process.plane import fitted_plane, spread_out, unknown_plane
from edmctl.process.shared_wear import WearShare, share_wear


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


def test_touches_for_a_plane_lie_far_apart() -> None:
    places = [(float(x), float(y)) for y in (0, 400, 800) for x in (500, 900, 1300)]
    chosen = {places[i] for i in spread_out(places, (0.0, 0.0), 3)}
    assert (1300.0, 800.0) in chosen
    assert len(chosen) == 3
    assert spread_out(places[:2], (0.0, 0.0), 3) == (1, 0)


def shares(count: int, wear_um: float = 8.0, common: float = 0.1, own: float = 0.05) -> list[WearShare]:
    return [WearShare(wear_um, common * wear_um, own * wear_um, 60.0 * (i + 1)) for i in range(count)]


def test_what_is_missing_of_the_tool_is_shared_out_evenly_among_equal_holes() -> None:
    found = share_wear(shares(3), 27.0, 200.0, touch_u_um=0.01, drift_u_um_per_s=0.0)
    assert [one.wear_um for one in found] == pytest.approx([9.0] * 3, abs=0.01)
    assert [one.tip_um for one in found] == pytest.approx([1.0, 2.0, 3.0], abs=0.02)


def test_a_touch_as_expected_moves_nothing_and_makes_everything_surer() -> None:
    before = shares(3)
    found = share_wear(before, 24.0, 200.0, touch_u_um=0.2, drift_u_um_per_s=0.001)
    for share, one in zip(before, found, strict=True):
        assert (one.wear_um, one.tip_um) == pytest.approx((share.wear_um, 0.0))
        assert one.wear_u_um < math.hypot(share.common_u_um, share.own_u_um)


def test_drift_that_may_explain_the_touch_keeps_the_shares_unsure() -> None:
    sure = share_wear(shares(2), 17.0, 600.0, touch_u_um=0.2, drift_u_um_per_s=0.0)
    unsure = share_wear(shares(2), 17.0, 600.0, touch_u_um=0.2, drift_u_um_per_s=0.01)
    assert unsure[0].wear_u_um > sure[0].wear_u_um
    assert abs(unsure[0].wear_um - 8.0) < abs(sure[0].wear_um - 8.0)


def test_a_touch_that_contradicts_what_was_expected_widens_it() -> None:
    near = share_wear(shares(4), 33.0, 240.0, touch_u_um=0.2, drift_u_um_per_s=0.0)
    far = share_wear(shares(4), 10.0, 240.0, touch_u_um=0.2, drift_u_um_per_s=0.0)
    assert far[0].wear_u_um > 2.0 * near[0].wear_u_um
    assert sum(one.wear_um for one in far) == pytest.approx(10.0, abs=0.5)


def test_intervals_hold_what_they_say_over_many_jobs() -> None:
    random = np.random.default_rng(7)
    held, count, jobs = 0, 5, 2000
    for _ in range(jobs):
        plan = shares(count)
        common = random.standard_normal()
        wears = [s.wear_um + s.common_u_um * common + s.own_u_um * random.standard_normal() for s in plan]
        drift = 0.002 * random.standard_normal()
        touched = sum(wears) + drift * 400.0 + 0.25 * random.standard_normal()
        found = share_wear(plan, touched, 400.0, touch_u_um=0.25, drift_u_um_per_s=0.002)
        for i, one in enumerate(found):
            tip = sum(wears[: i + 1]) - 8.0 * (i + 1) + drift * plan[i].after_s
            held += abs(one.wear_um - wears[i]) <= 2.0 * one.wear_u_um
            held += abs(one.tip_um - tip) <= 2.0 * one.tip_u_um
            before_um = one.tip_um - (one.wear_um - 8.0)
            held += abs(before_um - (tip - (wears[i] - 8.0))) <= 2.0 * one.feed_u_um
    assert 0.94 <= held / (3 * count * jobs) <= 0.99


@pytest.mark.parametrize(("count", "more"), [(2, 0.5), (5, 2.0), (8, 1.5)])
def test_a_tool_that_wears_otherwise_from_one_hole_on_is_held(more: float, count: int) -> None:
    random, held, jobs = np.random.default_rng(8), 0, 40
    for job in range(jobs):
        plan, begins = shares(count, common=0.03, own=0.02), job % count
        wears = [
            s.wear_um * (1.0 + 0.02 * random.standard_normal()) * (more if i >= begins else 1.0)
            for i, s in enumerate(plan)
        ]
        touched = sum(wears) + 0.25 * random.standard_normal()
        found = share_wear(plan, touched, 400.0, touch_u_um=0.25, drift_u_um_per_s=0.002)
        for i, one in enumerate(found):
            held += abs(one.wear_um - wears[i]) <= 2.0 * one.wear_u_um
            held += abs(one.tip_um - (sum(wears[: i + 1]) - 8.0 * (i + 1))) <= 2.0 * one.tip_u_um
    assert held / (2 * count * jobs) >= 0.92
