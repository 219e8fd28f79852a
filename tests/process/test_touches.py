"""Z1, Z2, Z3 and the honesty of their intervals."""

from __future__ import annotations

import math
import random
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edmctl.process.touches import (
    LINEARITY_LENGTH_UM,
    TOUCH_CHECK_SD_UM,
    DepthAndWear,
    Deviation,
    Displacement,
    Drift,
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
    tilt_uncertainty_um,
)
from edmctl.results.telemetry import PulseShares, pulse_shares
from tests.tiers import tiers

heights = st.floats(-500.0, 500.0)


def timed(
    z1: Reading, z2: Reading, z3: Reading, z1_to_z3_s: float, z2_to_z3_s: float
) -> tuple[Touch, Touch, Touch]:
    return Touch(-z1_to_z3_s, z1), Touch(-z2_to_z3_s, z2), Touch(0.0, z3)


def measured(
    z1: float = 50.0,
    z2: float = 300.0,
    z3: float = 120.0,
    *,
    since_s: float = 40.0,
    sensor: Displacement | None = None,
    tilt_u_um: float = 0.0,
    drift: Drift | None = None,
) -> DepthAndWear:
    """The paper's touches or others; the job takes 1000 s, the last `since_s` of them after the bottom."""
    first, bottom, last = (Reading(z_um, 0.1, 3) for z_um in (z1, z2, z3))
    touches = timed(first, bottom, last, 1000.0, since_s)
    return measure(*touches, sensor or Displacement(), tilt_u_um=tilt_u_um, drift=drift)


@given(heights, heights, heights)
def test_feed_is_depth_plus_wear(z1: float, z2: float, z3: float) -> None:
    result = measured(z1, z2, z3, sensor=Displacement(0.003, drift_u_um_per_s=0.0017))
    assert result.feed_um == pytest.approx(result.depth_um + result.wear_um, abs=1e-12, rel=1e-12)


def test_tilt_enters_the_depth_and_not_the_wear() -> None:
    flat, tilted = measured(), measured(tilt_u_um=1.0)
    assert (flat.depth_um, flat.wear_um, flat.feed_um) == (180.0, 70.0, 250.0)
    assert flat.wear_ratio == pytest.approx(0.389, abs=1e-3)
    assert tilted.wear.u95 == flat.wear.u95
    assert tilted.depth.u95 > 1.96 > flat.depth.u95


def test_drift_widens_the_wear_of_a_long_job() -> None:
    result = measured(sensor=Displacement(drift_u_um_per_s=0.9e-3), since_s=30.0)
    assert result.wear.u95 == pytest.approx(1.96 * 0.9, rel=0.1)
    assert result.depth.u95 < 0.6


def test_a_known_drift_is_taken_off_the_bottom_as_far_as_it_had_come() -> None:
    """A sensor drifts by 2 nm/s for a thousand seconds, the last two hundred of them between bottom and pad."""
    sensor = Displacement(drift_u_um_per_s=0.002)
    result = measured(50.0, 301.6, 122.0, since_s=200.0, sensor=sensor, drift=Drift(2.0, 0.1))
    assert (result.depth_um, result.wear_um, result.feed_um) == pytest.approx((180.0, 70.0, 250.0))
    assert (result.drift_um, result.drift_to_bottom_um) == pytest.approx((2.0, 1.6))
    soon, late = (measured(since_s=s, sensor=sensor, drift=Drift(0.0, 0.1)) for s in (10.0, 200.0))
    assert late.feed.u95 > soon.feed.u95 + 0.3
    assert late.wear.u95 == soon.wear.u95


def test_more_touches_narrow_the_interval() -> None:
    def depth_u95(touches: int) -> float:
        r = Reading(0.0, 0.5, touches)
        return measure(*timed(r, r, r, 0.0, 0.0), Displacement(), tilt_u_um=0.0).depth.u95

    assert depth_u95(12) < 0.5 * depth_u95(3)
    assert depth_u95(3) > 1.96 * 0.5 * (2 / 3) ** 0.5


@pytest.mark.parametrize(
    ("touch_sd_um", "touches", "least"),
    tiers(slow=((1.0, 3, 0.91), (0.06, 3, 0.93), (0.5, 3, 0.91), (0.06, 1, 0.93))),
)
def test_intervals_cover_as_often_as_they_state(touch_sd_um: float, touches: int, least: float) -> None:
    """A hole of 20 µm: drift, tilt, touches and nonlinearity in proportion, none hidden behind the gain."""
    rng, runs = random.Random(7), 2000
    inside = {0.95: [0, 0, 0], 0.5: [0, 0, 0]}
    known = Displacement(0.003, 0.1, 0.0017, 0.008)
    for _ in range(runs):
        gain, tilt, drift = rng.gauss(1.0, 0.003), rng.gauss(0.0, 0.15), rng.gauss(0.0, 0.0017)
        bend = rng.gauss(0.0, 0.1 / LINEARITY_LENGTH_UM)
        walk_um = [0.0, rng.gauss(0.0, 0.008 * 160.0**0.5)]
        walk_um.append(walk_um[1] + rng.gauss(0.0, 0.008 * 40.0**0.5))
        readings = []
        for z_um, t_s, walked_um in zip((50.0, 78.0 + tilt, 58.0), (0.0, 160.0, 200.0), walk_um, strict=True):
            shift_um = drift * t_s + walked_um
            touched_um = [
                (gain + bend) * z_um + rng.gauss(0.0, touch_sd_um) + shift_um for _ in range(touches)
            ]
            readings.append(reading_of(tuple(touched_um)))
        z1, z2, z3 = readings
        found = measure(*timed(z1, z2, z3, 200.0, 40.0), known, tilt_u_um=0.15)
        for p, counts in inside.items():
            for i, (value, true_um) in enumerate(
                ((found.depth, 20.0), (found.wear, 8.0), (found.feed, 28.0))
            ):
                low, high = value.interval(p)
                counts[i] += low <= true_um <= high
    assert all(least * runs <= count <= 0.98 * runs for count in inside[0.95])
    assert all(0.42 * runs <= count <= 0.6 * runs for count in inside[0.5])


def test_a_reading_is_mean_and_sample_deviation() -> None:
    assert reading_of((1.0, 2.0, 3.0)) == Reading(2.0, 1.0, 3)
    assert reading_of((5.0,)) == Reading(5.0, 0.0, 1)
    with pytest.raises(ValueError, match="at least one touch"):
        reading_of(())


def test_tilt_grows_with_the_distance_and_never_vanishes() -> None:
    assert tilt_uncertainty_um(0.3, 500.0) == pytest.approx(0.15)
    assert tilt_uncertainty_um(1.0, 0.0, 1.0) == pytest.approx(1.414e-3, rel=1e-3)


def test_pulse_shares_sum_to_one_or_are_nothing() -> None:
    assert pulse_shares(1, 2, 1, 0) == PulseShares(0.25, 0.5, 0.25, 0.0)
    assert pulse_shares(0, 0, 0, 0) == PulseShares(0.0, 0.0, 0.0, 0.0)


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
