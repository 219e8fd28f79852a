"""Depth to target by cuts: how far each goes, and when it has to be measured."""

from __future__ import annotations

import math
from dataclasses import dataclass
from random import Random

import pytest

from edmctl.process.live_erosion import Energy, ErosionEstimate
from edmctl.process.next_cut import GAP_U_UM, is_done, next_cut

AREA_UM2 = math.pi / 4.0 * 286.0**2
REMOVAL = 0.0424


def estimate(ratio: float = 0.389, u_rel: float = 0.1) -> ErosionEstimate:
    return ErosionEstimate(REMOVAL, 0.1, ratio, u_rel, AREA_UM2)


def energy(depth_um: float) -> Energy:
    return Energy(depth_um * AREA_UM2 / REMOVAL, 0.0)


def test_the_first_cut_of_a_wearing_tool_stays_short_by_what_is_unknown_of_the_wear() -> None:
    cut = next_cut(
        estimate(), target_um=180.0, remaining_um=180.0, tolerance_um=2.0, start_u_um=0.2, begun=False
    )
    assert cut.measured
    assert cut.depth_um == pytest.approx(180.0 - 2.0 * 250.0 * 0.389 / 1.389**2 * 0.1, abs=0.5)
    assert cut.feed_um == pytest.approx(cut.depth_um * 1.389)


def test_the_recipe_can_keep_the_first_cut_shorter_still() -> None:
    cut = next_cut(
        estimate(),
        target_um=180.0,
        remaining_um=180.0,
        tolerance_um=2.0,
        start_u_um=0.2,
        largest_um=100.0,
        begun=False,
    )
    assert cut.depth_um == 100.0


def test_a_tool_that_hardly_wears_goes_for_the_whole_depth() -> None:
    cut = next_cut(
        estimate(0.04), target_um=100.0, remaining_um=100.0, tolerance_um=2.5, start_u_um=0.2, begun=False
    )
    assert cut.depth_um == 100.0
    assert cut.measured


def test_a_later_hole_is_not_measured_where_the_first_one_has_told_enough() -> None:
    known = estimate().fitted(energy(20.0), 20.0, 0.2, 7.8, 0.2).next_hole(20.0)
    cut = next_cut(known, target_um=20.0, remaining_um=20.0, tolerance_um=2.0, start_u_um=0.3, begun=False)
    assert (cut.depth_um, cut.measured) == (20.0, False)
    unsure = next_cut(known, target_um=20.0, remaining_um=20.0, tolerance_um=2.0, start_u_um=1.5, begun=False)
    assert unsure.measured


def test_a_small_rest_is_finished_without_another_measurement() -> None:
    known = estimate().fitted(energy(170.0), 170.0, 0.5, 66.0, 1.0)
    small = next_cut(known, target_um=180.0, remaining_um=10.0, tolerance_um=2.0, start_u_um=0.5, begun=True)
    assert (small.depth_um, small.measured) == (10.0, False)
    long = next_cut(known, target_um=180.0, remaining_um=27.0, tolerance_um=2.0, start_u_um=0.5, begun=True)
    assert (long.depth_um, long.measured) == (27.0, True)


@pytest.mark.parametrize(
    ("remaining_um", "noise_um", "done"), [(0.9, 0.1, True), (1.1, 0.1, False), (1.1, 0.6, True)]
)
def test_half_the_tolerance_or_the_noise_ends_it(remaining_um: float, noise_um: float, done: bool) -> None:
    assert is_done(remaining_um, 2.0, noise_um) == done


@dataclass
class World:
    """A hole whose true wear ratio nobody knows, measured with noise."""

    random: Random
    ratio: float
    depth_um: float = 0.0

    def cut(self, feed_um: float) -> None:
        self.depth_um += (feed_um + self.random.gauss(0.0, GAP_U_UM)) / (1.0 + self.ratio)

    def measure(self, noise_um: float) -> float:
        return self.depth_um + self.random.gauss(0.0, noise_um)


def test_depths_come_out_within_two_micrometres_with_three_stops_at_most() -> None:
    misses, most_stops = 0, 0
    for seed in range(300):
        random = Random(seed)
        world = World(random, 0.389 * math.exp(random.gauss(0.0, 0.1)))
        known, found_um, stops, begun, worn_um = estimate(), 0.0, 0, False, 0.0
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
            world.cut(cut.feed_um)
            if not cut.measured:
                break
            stops, begun = stops + 1, True
            found_um = world.measure(0.3)
            worn_um = world.ratio * world.depth_um + random.gauss(0.0, 0.5)
            known = estimate().fitted(energy(world.depth_um), found_um, 0.3, worn_um, 0.5)
        most_stops = max(most_stops, stops)
        misses += abs(world.depth_um - 180.0) > 2.0
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
