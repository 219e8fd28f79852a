"""Depth to target by cuts: how far each goes, and when it has to be measured."""

from __future__ import annotations

import math
from random import Random

import pytest

from edmctl.process.live_erosion import Energy, ErosionEstimate
from edmctl.process.next_cut import GAP_U_UM, NextCut, is_done, next_cut

AREA_UM2 = math.pi / 4.0 * 286.0**2
REMOVAL = 0.0424


def estimate(ratio: float = 0.389, u_rel: float = 0.1) -> ErosionEstimate:
    return ErosionEstimate(REMOVAL, 0.1, ratio, u_rel, AREA_UM2)


def energy(depth_um: float) -> Energy:
    return Energy(depth_um * AREA_UM2 / REMOVAL, 0.0)


def first_cut(
    known: ErosionEstimate, target_um: float, tolerance_um: float = 2.0, u_um: float = 0.2, **more: float
) -> NextCut:
    return next_cut(
        known,
        target_um=target_um,
        remaining_um=target_um,
        tolerance_um=tolerance_um,
        start_u_um=u_um,
        begun=False,
        **more,
    )


def test_the_first_cut_of_a_wearing_tool_stays_short_by_what_is_unknown_of_the_wear() -> None:
    cut = first_cut(estimate(), 180.0)
    assert cut.measured
    assert cut.depth_um == pytest.approx(180.0 - 2.0 * 250.0 * 0.389 / 1.389**2 * 0.1, abs=0.5)
    assert cut.feed_um == pytest.approx(cut.depth_um * 1.389)
    assert first_cut(estimate(), 180.0, largest_um=100.0).depth_um == 100.0
    whole = first_cut(estimate(0.04), 100.0, tolerance_um=2.5)
    assert (whole.depth_um, whole.measured) == (100.0, True)


def test_a_later_hole_is_not_measured_where_the_first_one_has_told_enough() -> None:
    known = estimate().fitted(energy(20.0), 20.0, 0.2, 7.8, 0.2).next_hole(20.0)
    cut = first_cut(known, 20.0, u_um=0.3)
    assert (cut.depth_um, cut.measured) == (20.0, False)
    assert first_cut(known, 20.0, u_um=1.5).measured


@pytest.mark.parametrize(("remaining_um", "measured"), [(10.0, False), (27.0, True)])
def test_a_small_rest_is_finished_without_another_measurement(remaining_um: float, measured: bool) -> None:
    known = estimate().fitted(energy(170.0), 170.0, 0.5, 66.0, 1.0)
    cut = next_cut(
        known, target_um=180.0, remaining_um=remaining_um, tolerance_um=2.0, start_u_um=0.5, begun=True
    )
    assert (cut.depth_um, cut.measured) == (remaining_um, measured)


@pytest.mark.parametrize(
    ("remaining_um", "noise_um", "done"), [(0.9, 0.1, True), (1.1, 0.1, False), (1.1, 0.6, True)]
)
def test_half_the_tolerance_or_the_noise_ends_it(remaining_um: float, noise_um: float, done: bool) -> None:
    assert is_done(remaining_um, 2.0, noise_um) == done


def test_depths_come_out_within_two_micrometres_with_three_stops_at_most() -> None:
    misses, most_stops = 0, 0
    for seed in range(300):
        random = Random(seed)
        ratio, depth_um = 0.389 * math.exp(random.gauss(0.0, 0.1)), 0.0
        known, found_um, stops, begun = estimate(), 0.0, 0, False
        while not is_done(180.0 - found_um, 2.0, 0.3):
            cut = next_cut(
                known,
                target_um=180.0,
                remaining_um=180.0 - found_um,
                tolerance_um=2.0,
                start_u_um=0.3,
                largest_um=math.inf if begun else 0.85 * 180.0,
                begun=begun,
            )
            depth_um += (cut.feed_um + random.gauss(0.0, GAP_U_UM)) / (1.0 + ratio)
            if not cut.measured:
                break
            stops, begun = stops + 1, True
            found_um = depth_um + random.gauss(0.0, 0.3)
            worn_um = ratio * depth_um + random.gauss(0.0, 0.5)
            known = estimate().fitted(energy(depth_um), found_um, 0.3, worn_um, 0.5)
        most_stops = max(most_stops, stops)
        misses += abs(depth_um - 180.0) > 2.0
    assert misses <= 15
    assert most_stops <= 3


@pytest.mark.parametrize("wear_um", [40.0, 400.0])
def test_after_a_contradiction_no_cut_feeds_further_than_what_is_left_is_deep(wear_um: float) -> None:
    """Where the touch was wrong, the tool wears as little as was believed: then nothing is cut too deep."""
    learned = estimate().fitted(energy(10.0), 10.0, 0.3, wear_um, 0.5)
    assert learned.contradicted
    cut = next_cut(learned, target_um=30.0, remaining_um=20.0, tolerance_um=2.0, start_u_um=0.3, begun=True)
    assert cut.measured
    assert cut.feed_um <= 20.0
