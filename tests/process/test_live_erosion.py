"""Depth and wear from feed and energy, and what touches teach."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edmctl.process.live_erosion import (
    ARC_REMOVAL,
    ARC_WEAR,
    RECIPE_U_REL,
    USUAL_ARCS,
    Energy,
    ErosionEstimate,
)

AREA_UM2 = 64_000.0
REMOVAL = 0.04


def fresh(removal_u: float = 0.1, ratio_u: float = 0.1) -> ErosionEstimate:
    return ErosionEstimate(REMOVAL, removal_u, 0.4, ratio_u, AREA_UM2)


def energy_for(depth_um: float, removal: float = REMOVAL, arcs: float = USUAL_ARCS) -> Energy:
    normal_uj = depth_um * AREA_UM2 / removal / (1.0 + ARC_REMOVAL * arcs)
    return Energy(normal_uj, arcs * normal_uj)


def arc_factor(arcs: float) -> float:
    return (1.0 + ARC_WEAR * ARC_REMOVAL * arcs) / (1.0 + ARC_REMOVAL * arcs)


def test_without_energy_a_feed_is_split_by_the_wear_ratio() -> None:
    live = fresh().split(140.0, 0.0)
    assert (live.depth_um, live.wear_um) == pytest.approx((100.0, 40.0))
    assert live.depth_u_um == pytest.approx(140.0 * 0.4 / 1.4**2 * 0.1)


@given(
    feed_um=st.floats(0.1, 400.0),
    ratio=st.floats(0.01, 2.0),
    share=st.floats(0.7, 1.3),
    arcs=st.floats(0.0, 0.3),
)
def test_depth_and_wear_always_add_up_to_the_feed(
    feed_um: float, ratio: float, share: float, arcs: float
) -> None:
    estimate = ErosionEstimate(REMOVAL, 0.1, ratio, 0.1, AREA_UM2)
    normal = energy_for(share * feed_um / (1.0 + ratio)).normal_uj
    live = estimate.split(feed_um, 0.3, Energy(normal, arcs * normal))
    assert live.depth_um + live.wear_um == pytest.approx(feed_um)
    assert live.depth_um > 0.0
    assert live.depth_u_um > 0.0


def test_energy_tells_the_depth_once_the_removal_is_known() -> None:
    known = fresh(removal_u=0.005)
    live = known.split(140.0, 0.1, energy_for(97.0))
    assert live.depth_um == pytest.approx(97.0, abs=0.7)
    assert live.depth_u_um < 0.8
    blind = fresh(removal_u=1.0).split(140.0, 0.1, energy_for(97.0))
    assert blind.depth_um == pytest.approx(100.0, abs=0.5)


def test_a_touch_teaches_removal_and_wear() -> None:
    learned = fresh().fitted(energy_for(100.0, 0.036), 100.0, 0.3, 44.0, 0.5)
    assert learned.fits == 1
    assert learned.removal_um3_per_uj == pytest.approx(0.036, rel=0.005)
    assert learned.wear_ratio == pytest.approx(0.44, rel=0.01)
    assert learned.wear_ratio_u_rel < 0.02


def test_a_bad_touch_teaches_little() -> None:
    learned = fresh().fitted(energy_for(10.0), 10.0, 0.3, 6.0, 4.0)
    assert 0.4 < learned.wear_ratio < 0.5
    assert 0.3 < learned.wear_ratio_u_rel < RECIPE_U_REL  # the touch has hardly confirmed the belief
    # A hole just begun is touched again after hours, in which the sensor has drifted by 26 µm.
    late = fresh().fitted(None, 0.23, 0.26, 26.2, 19.0)
    assert not late.contradicted
    assert late.wear_ratio == pytest.approx(fresh().wear_ratio, rel=0.1)


def test_the_next_hole_is_known_a_little_less() -> None:
    learned = fresh().fitted(energy_for(100.0), 100.0, 0.3, 40.0, 0.5)
    later = learned.next_hole(math.nan)
    assert later.wear_ratio == learned.wear_ratio
    assert later.wear_ratio_u_rel > learned.wear_ratio_u_rel
    assert learned.fitted(energy_for(1.0), 0.0, 1.0, 0.0, 1.0) is learned


def test_wear_of_a_hole_of_another_depth_than_the_touched_one_is_known_less() -> None:
    """Debris and arcs change with depth: in a hole three times as deep the ratio was 2 to 4 % higher."""
    learned = fresh().fitted(energy_for(30.0), 30.0, 0.2, 12.0, 0.1)
    alike, deeper = (learned.next_hole(depth_um).split(140.0, 0.1) for depth_um in (30.0, 90.0))
    assert deeper.wear_ratio_u_um == alike.wear_ratio_u_um
    assert deeper.wear_own_u_um > alike.wear_own_u_um + 0.02 * deeper.depth_um * deeper.wear_um / 140.0
    assert (
        learned.next_hole(90.0).fitted(energy_for(90.0), 90.0, 0.3, 37.0, 0.1).split(9.0, 0.1).wear_own_u_um
        < 0.1
    )


def test_arcs_wear_the_tool_more_than_their_energy_says() -> None:
    known = fresh(ratio_u=1e-4)
    clean = known.split(140.0, 0.1, energy_for(100.0, arcs=0.0))
    arcing = known.split(140.0, 0.1, energy_for(100.0, arcs=0.5))
    assert arcing.wear_um > clean.wear_um
    ratio = 0.4 * arc_factor(0.5) / arc_factor(USUAL_ARCS)
    assert arcing.wear_um / arcing.depth_um == pytest.approx(ratio, rel=1e-3)


def test_the_next_cut_is_expected_to_arc_like_the_last_one() -> None:
    arcing = energy_for(100.0, arcs=0.3)
    worn_um = 100.0 * 0.4 * arc_factor(0.3) / arc_factor(USUAL_ARCS)
    learned = fresh(ratio_u=0.01).fitted(arcing, 100.0, 0.3, worn_um, 0.3)
    assert fresh().wear_ratio == pytest.approx(0.4)
    assert learned.wear_ratio == pytest.approx(worn_um / 100.0, rel=0.01)


def test_a_touch_of_a_tool_that_wears_little_does_not_confirm_a_belief() -> None:
    """One touch of 0.6 µm ± 0.3 looks alike at half and at twice the wear that was believed."""
    for believed in (0.0, 0.005, 0.015, 0.06):
        learned = ErosionEstimate(REMOVAL, 0.1, believed, 0.1, AREA_UM2).fitted(None, 20.0, 0.3, 0.6, 0.3)
        u95_um = 1.96 * 20.0 * learned.wear_ratio * learned.wear_ratio_u_rel
        assert abs(20.0 * learned.wear_ratio - 0.6) < u95_um
        assert u95_um > 0.25


def test_no_feed_is_no_depth_within_the_working_gap_and_a_tool_without_wear_has_a_ratio_too() -> None:
    unworn = ErosionEstimate(REMOVAL, 0.1, 0.0, 0.1, AREA_UM2).split(50.0, 0.1, energy_for(50.0))
    assert unworn.wear_um < 0.01
    assert math.isfinite(unworn.depth_u_um)
    live, hardly = fresh().split(0.0, 0.3), fresh().split(1e-6, 0.3)
    assert (live.depth_um, live.wear_um) == (0.0, 0.0)
    assert live.depth_u_um == pytest.approx(hardly.depth_u_um, rel=1e-3)
    assert live.wear_u_um == pytest.approx(hardly.wear_u_um, rel=1e-3)
    assert fresh().split(0.0, 0.3, Energy(1.0, 0.0)).wear_u_um > 0.0


AS_EXPECTED = Energy(20.0 * 1.0e4 / 0.0424, 0.0)
FIVEFOLD = Energy(AS_EXPECTED.normal_uj / 5.0, 0.0)
"""Energies of a depth of 20 µm, at the expected volume per energy and at five times as much."""


def paper() -> ErosionEstimate:
    return ErosionEstimate(0.0424, 0.1, 0.337, 0.1, 1.0e4)


def test_a_touch_far_from_what_was_believed_is_believed_instead() -> None:
    found = paper().fitted(AS_EXPECTED, 20.0, 0.3, 2.0, 0.3)
    assert found.contradicted
    assert found.wear_ratio == pytest.approx(0.1, abs=0.03)
    assert abs(found.wear_ratio - 0.1) <= 2.0 * found.wear_ratio * found.wear_ratio_u_rel
    assert not paper().fitted(AS_EXPECTED, 20.0, 0.3, 6.7, 0.3).contradicted


def test_energy_that_does_not_go_with_the_feed_does_not_pull_the_wear_ratio() -> None:
    assert not paper().contradicts(26.7, 0.3, AS_EXPECTED)
    assert paper().contradicts(26.7, 0.3, FIVEFOLD)
    by_ratio = paper().split(26.7, 0.3).wear_um
    assert paper().split(26.7, 0.3, FIVEFOLD).wear_um == pytest.approx(by_ratio, rel=0.05)
    found = paper().fitted(FIVEFOLD, 20.0, 0.2, 6.74, 0.2)
    assert found.removal_um3_per_uj == pytest.approx(5.0 * 0.0424, rel=0.05)
    assert found.wear_ratio == pytest.approx(0.337, rel=0.05)
    assert not found.contradicts(26.74, 0.3, FIVEFOLD)


def test_a_sharp_touch_is_believed_whatever_was_expected() -> None:
    for times in (0.3, 0.7, 1.0, 1.5, 3.0, 10.0):
        wear_um = times * fresh().wear_ratio * 100.0
        learned = fresh().fitted(None, 100.0, 0.3, wear_um, 0.01 * wear_um)
        assert learned.wear_ratio == pytest.approx(wear_um / 100.0, rel=0.03)
