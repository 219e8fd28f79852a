"""Gain and zero that follow trusted readings, and nothing else."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edmctl.actuator.correction import GAIN_SD_BETWEEN_DAYS, SlowCorrection

LOW_UM, HIGH_UM = 20.0, 350.0


def test_two_heights_give_gain_and_zero() -> None:
    correction = SlowCorrection()
    for time_s, y_um in enumerate((LOW_UM, HIGH_UM) * 3):
        correction.observe(float(time_s), y_um, 1.02 * y_um - 35.0, 0.05)
    assert correction.gain == pytest.approx(1.02, abs=2e-4)
    assert correction.offset_um == pytest.approx(-35.0, abs=0.05)
    assert correction.sd_um(200.0) < 0.1


def test_one_height_moves_the_zero_and_leaves_the_gain() -> None:
    correction = SlowCorrection()
    correction.observe(0.0, 0.0, 12.0, 0.1)
    assert correction.gain == 1.0
    assert correction.offset_um == pytest.approx(12.0, abs=1e-4)
    assert correction.gain_sd == GAIN_SD_BETWEEN_DAYS


def test_it_is_the_least_squares_line_where_nothing_walks() -> None:
    rng = np.random.default_rng(1)
    y_um = rng.uniform(LOW_UM, HIGH_UM, 40)
    z_um = 0.99 * y_um + 3.0 + 0.3 * rng.standard_normal(40)
    correction = SlowCorrection()
    for y, z in zip(y_um, z_um, strict=True):
        correction.observe(0.0, float(y), float(z), 0.3)
    zero_um, gain = np.polynomial.polynomial.polyfit(y_um, z_um, 1)
    assert correction.gain == pytest.approx(gain, abs=2e-5)
    assert correction.offset_um == pytest.approx(zero_um, abs=5e-3)


def test_after_an_hour_a_new_reading_counts_for_more_than_the_old_ones() -> None:
    old, now = 0.0, 3600.0
    correction = SlowCorrection()
    for y_um in (LOW_UM, HIGH_UM):
        correction.observe(old, y_um, y_um, 0.1)
    correction.observe(now, 100.0, 103.0, 0.1)
    assert correction.gain * 100.0 + correction.offset_um == pytest.approx(103.0, abs=0.02)
    assert correction.offset_um > 2.0  # the zero has walked 2.4 µm by then, the gain 0.5 % of 100 µm


def test_uncertainty_grows_with_time_as_stated() -> None:
    """0.5 % of gain in an hour, 1 µm of zero in ten minutes, beside a reading that says nothing."""
    correction = SlowCorrection(gain_sd=1e-9)
    correction.observe(0.0, 0.0, 0.0, 1e-6)
    correction.observe(600.0, 0.0, 0.0, 1e9)
    assert correction.sd_um(0.0) == pytest.approx(1.0, rel=1e-6)
    correction.observe(3600.0, 0.0, 0.0, 1e9)
    assert correction.gain_sd == pytest.approx(0.005, rel=1e-6)
    assert correction.sd_um(0.0) == pytest.approx(math.sqrt(6.0), rel=1e-6)


def test_readings_come_in_order_with_a_positive_spread() -> None:
    correction = SlowCorrection(10.0)
    with pytest.raises(ValueError, match="after the last one"):
        correction.observe(9.0, 0.0, 0.0, 0.1)
    with pytest.raises(ValueError, match="standard deviation"):
        correction.observe(11.0, 0.0, 0.0, 0.0)
