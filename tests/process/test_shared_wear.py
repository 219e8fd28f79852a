"""How one touch of the pad divides among the holes before it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edmctl.process.shared_wear import WearShare, share_wear


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


@pytest.mark.parametrize("more", [0.5, 1.5, 2.0])
@pytest.mark.parametrize("count", [2, 5, 8])
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
