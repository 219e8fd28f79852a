"""Z1, Z2, Z3 and the honesty of their intervals."""

from __future__ import annotations

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edmctl.process.touches import (
    LINEARITY_LENGTH_UM,
    DepthAndWear,
    Displacement,
    Drift,
    Reading,
    Touch,
    measure,
    reading_of,
    tilt_uncertainty_um,
)
from edmctl.results.telemetry import PulseShares, pulse_shares

GAIN_U, TILT_U_UM, DRIFT_U, Z1_Z3_S, Z2_Z3_S = 0.003, 0.15, 0.0017, 900.0, 40.0
heights = st.floats(-500.0, 500.0)


def timed(
    z1: Reading, z2: Reading, z3: Reading, z1_to_z3_s: float, z2_to_z3_s: float
) -> tuple[Touch, Touch, Touch]:
    return Touch(-z1_to_z3_s, z1), Touch(-z2_to_z3_s, z2), Touch(0.0, z3)


def measured(z1: Reading, z2: Reading, z3: Reading) -> DepthAndWear:
    sensor = Displacement(GAIN_U, drift_u_um_per_s=DRIFT_U)
    return measure(*timed(z1, z2, z3, Z1_Z3_S, Z2_Z3_S), sensor, tilt_u_um=TILT_U_UM)


@given(heights, heights, heights)
def test_feed_is_depth_plus_wear(z1: float, z2: float, z3: float) -> None:
    result = measured(Reading(z1, 0.1, 3), Reading(z2, 0.1, 3), Reading(z3, 0.1, 3))
    assert result.feed_um == pytest.approx(result.depth_um + result.wear_um, abs=1e-12, rel=1e-12)


def test_the_papers_touches_give_the_papers_depth_and_wear() -> None:
    result = measured(Reading(50.0, 0.2, 3), Reading(300.0, 0.2, 3), Reading(120.0, 0.2, 3))
    assert (result.depth_um, result.wear_um, result.feed_um) == (180.0, 70.0, 250.0)
    assert result.wear_ratio == pytest.approx(0.389, abs=1e-3)


def test_tilt_enters_the_depth_and_not_the_wear() -> None:
    z = Reading(50.0, 0.1, 3), Reading(300.0, 0.1, 3), Reading(120.0, 0.1, 3)
    flat, tilted = (measure(*timed(*z, 900.0, 40.0), Displacement(), tilt_u_um=t) for t in (0.0, 1.0))
    assert tilted.wear.u95 == flat.wear.u95
    assert tilted.depth.u95 > 1.96 > flat.depth.u95


def test_drift_widens_the_wear_of_a_long_job() -> None:
    z = Reading(50.0, 0.1, 3), Reading(300.0, 0.1, 3), Reading(120.0, 0.1, 3)
    result = measure(*timed(*z, 900.0, 30.0), Displacement(drift_u_um_per_s=1e-3), tilt_u_um=0.0)
    assert result.wear.u95 == pytest.approx(1.96 * 0.9, rel=0.1)
    assert result.depth.u95 < 0.6


def test_a_known_drift_is_taken_off_the_bottom_as_far_as_it_had_come() -> None:
    """A sensor drifts by 2 nm/s for a thousand seconds, the last two hundred of them between bottom and pad."""
    rate_um_s, all_s, since_s = 0.002, 1000.0, 200.0
    z = (
        Reading(50.0, 0.05, 3),
        Reading(300.0 + rate_um_s * (all_s - since_s), 0.05, 3),
        Reading(120.0 + rate_um_s * all_s, 0.05, 3),
    )
    result = measure(
        *timed(*z, all_s, since_s),
        Displacement(drift_u_um_per_s=rate_um_s),
        tilt_u_um=0.0,
        drift=Drift(rate_um_s * all_s, 0.1),
    )
    assert (result.depth_um, result.wear_um, result.feed_um) == pytest.approx((180.0, 70.0, 250.0))
    assert (result.drift_um, result.drift_to_bottom_um) == pytest.approx((2.0, 1.6))


def test_what_drifts_between_bottom_and_pad_widens_the_feed() -> None:
    z = Reading(50.0, 0.05, 3), Reading(300.0, 0.05, 3), Reading(120.0, 0.05, 3)
    soon, late = (
        measure(
            *timed(*z, 1000.0, since_s),
            Displacement(drift_u_um_per_s=0.002),
            tilt_u_um=0.0,
            drift=Drift(0.0, 0.1),
        )
        for since_s in (10.0, 200.0)
    )
    assert late.feed.u95 > soon.feed.u95 + 0.3
    assert late.wear.u95 == soon.wear.u95


def test_more_touches_narrow_the_interval() -> None:
    def depth_u95(touches: int) -> float:
        r = Reading(0.0, 0.5, touches)
        return measure(*timed(r, r, r, 0.0, 0.0), Displacement(), tilt_u_um=0.0).depth.u95

    assert depth_u95(12) < 0.5 * depth_u95(3)
    assert depth_u95(3) > 1.96 * 0.5 * (2 / 3) ** 0.5


@pytest.mark.parametrize(
    ("touch_sd_um", "touches", "least"), [(0.06, 3, 0.93), (0.5, 3, 0.91), (1.0, 3, 0.91), (0.06, 1, 0.93)]
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
