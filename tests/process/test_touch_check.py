"""The statistics by which touches are believed: how often good ones are doubted, and how short a chip may be."""

from __future__ import annotations

import math
from random import Random

import pytest

from edmctl.process.touches import (
    TOUCH_CHECK_SD_UM,
    Deviation,
    Displacement,
    Reading,
    Touch,
    against_sparks,
    agreeing_spots,
    between,
    has_grown,
    is_constant,
    is_long,
    is_short,
    measure,
    pooled_reading,
    reading_of,
)

TRIES = 20_000


def touched(random: Random, z_um: float, touches: int) -> Reading:
    """A set of touches that scatter as expected."""
    return reading_of(tuple(random.gauss(z_um, TOUCH_CHECK_SD_UM) for _ in range(touches)))


def test_two_clean_spots_disagree_in_a_third_of_a_percent() -> None:
    random, doubted = Random(1), 0
    for _ in range(TRIES):
        tilt_um = random.gauss(0.0, 0.09)
        spots = (touched(random, 50.0, 2), touched(random, 50.0 + tilt_um, 1))
        doubted += len(agreeing_spots(spots, 0.09)) < 2
    assert doubted / TRIES == pytest.approx(0.0027, abs=0.0015)


@pytest.mark.parametrize("chip_um", [1.5, 5.0, 20.0])
def test_the_shorter_spot_had_the_chip_whichever_it_is(chip_um: float) -> None:
    clean, dirty = Reading(50.0, 0.1, 2), Reading(50.0 - chip_um, 0.1, 2)
    assert agreeing_spots((dirty, clean, clean), 0.1) == (1, 2)
    assert agreeing_spots((clean, dirty, clean), 0.1) == (0, 2)
    assert agreeing_spots((dirty, clean), 0.1) == (1,)


def test_a_bottom_is_doubted_by_the_gap_and_its_uncertainty() -> None:
    def off(bottom_um: float, gap_u_um: float) -> Deviation:
        return against_sparks(bottom_um, 60.0, 3.4, gap_u_um)

    assert not is_short(off(63.0, 0.8), 3.4)
    assert is_short(off(61.5, 0.8), 3.4)
    assert is_short(off(62.4, 0.3), 3.4)
    assert is_long(off(66.2, 0.8))
    assert not is_long(off(64.2, 0.3))


def test_a_bottom_above_the_last_sparks_is_impossible_however_little_is_known_of_the_gap() -> None:
    off = against_sparks(59.0, 60.0, 3.4, 10.0)
    assert abs(off.sigmas) < 1.0
    assert is_short(off, 3.4)


def test_a_bottom_in_doubt_lies_between_the_last_sparks_and_the_gap_expected() -> None:
    for touch_um in (40.0, 55.0, 61.0):
        middle_um, u_um = between(touch_um, 60.0, 3.4, 0.8)
        assert middle_um - 2.0 * u_um < max(touch_um, 60.0) < middle_um < 63.4 < middle_um + 2.0 * u_um


def test_what_was_doubted_widens_depth_and_wear_but_not_what_it_does_not_enter() -> None:
    z1, z2, z3 = Reading(50.0, 0.1, 3), Reading(64.0, 0.1, 3), Reading(54.0, 0.1, 3)

    def found(*doubts_u_um: float) -> tuple[float, float, float]:
        made = zip((0.0, 80.0, 100.0), (z1, z2, z3), doubts_u_um, strict=True)
        first, bottom, last = (Touch(*one) for one in made)
        one = measure(first, bottom, last, Displacement(0.003), tilt_u_um=0.1)
        return one.depth.u95, one.wear.u95, one.feed.u95

    sure = found(0.0, 0.0, 0.0)
    assert found(2.0, 0.0, 0.0)[0] == sure[0]
    assert found(0.0, 2.0, 0.0)[1] == sure[1]
    assert found(0.0, 0.0, 2.0)[2] == sure[2]
    for widened in (found(0.0, 2.0, 0.0)[0], found(0.0, 0.0, 2.0)[1], found(2.0, 0.0, 0.0)[2]):
        assert 3.9 < widened < 4.5


def test_touches_that_repeat_to_the_last_digit_are_none() -> None:
    assert is_constant((Reading(50.0, 0.0, 3),))
    assert is_constant((Reading(50.0, 0.0, 2), Reading(50.0, 0.0, 1)))
    assert not is_constant((Reading(50.0, 0.0, 2),))
    assert not is_constant((Reading(50.0, 0.0, 2), Reading(50.002, 0.0, 1)))


def test_touches_that_scatter_are_hardly_ever_constant() -> None:
    """Two are equal to the last digit in 0.7 % of all pairs; a set that would be refused for it does not turn up."""
    random, equal, refused = Random(6), 0, 0
    digit_um, sd_um = 0.001, 0.04
    for _ in range(TRIES):
        said_um = tuple(digit_um * round(random.gauss(50.0, sd_um) / digit_um) for _ in range(4))
        equal += said_um[0] == said_um[1]
        refused += is_constant((reading_of(said_um),))
    by_chance = digit_um / (2.0 * sd_um * math.sqrt(math.pi))
    assert equal / TRIES == pytest.approx(by_chance, rel=0.2)
    assert refused == 0


def test_a_tool_that_grows_is_doubted_and_one_that_wears_is_not() -> None:
    assert has_grown(Deviation(-1.0, 0.22))
    assert not has_grown(Deviation(-0.8, 0.22))
    assert not has_grown(Deviation(5.0, 0.22))


def test_readings_pool_to_that_of_all_their_touches() -> None:
    all_um = (50.1, 49.9, 50.4, 50.2, 49.7)
    pooled = pooled_reading((reading_of(all_um[:2]), reading_of(all_um[2:])))
    together = reading_of(all_um)
    assert (pooled.mean_um, pooled.sd_um) == pytest.approx((together.mean_um, together.sd_um))
    assert pooled.touches == 5
