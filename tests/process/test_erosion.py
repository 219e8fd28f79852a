"""From electrical settings to a feed rate."""

from __future__ import annotations

import pytest

from edmctl.process.erosion import (
    average_power_uj_s,
    feed_rate_um_s,
    linear_wear_ratio,
    mrr_mm3_min,
    pulse_energy_uj,
    removal_rate_um3_s,
)
from edmctl.process.voltage import discharge_share

FULL_PULSE_UJ = pulse_energy_uj(22.0, 0.12, 130.43)


def feed(diameter_um: float, theta: float) -> float:
    power = average_power_uj_s(2300.0, FULL_PULSE_UJ, discharge_share(0.80, 22.0 / 40.0))
    return feed_rate_um_s(
        removal_rate_um3_s(power, 0.0424),
        diameter_um=diameter_um,
        side_gap_um=8.0,
        side_share=0.05,
        wear_ratio=linear_wear_ratio(theta, diameter_um=diameter_um, side_gap_um=8.0),
    )


def test_a_full_pulse_holds_a_few_hundred_microjoules() -> None:
    assert pytest.approx(344.3, abs=0.1) == FULL_PULSE_UJ


@pytest.mark.parametrize(
    ("diameter_um", "theta", "expected"), [(270.0, 0.337, 0.304), (150.0, 0.337, 0.92), (252.0, 0.0358, 0.26)]
)
def test_the_voltage_law_predicts_the_feed(diameter_um: float, theta: float, expected: float) -> None:
    assert feed(diameter_um, theta) == pytest.approx(expected, rel=0.01)


def test_the_smaller_tool_feeds_about_three_times_as_fast() -> None:
    assert feed(150.0, 0.337) / feed(270.0, 0.337) == pytest.approx(3.04, abs=0.01)


def test_wear_along_the_tool_exceeds_the_volumetric_wear_because_the_hole_is_wider() -> None:
    assert linear_wear_ratio(0.337, diameter_um=270.0, side_gap_um=8.0) == pytest.approx(
        0.337 * (286 / 270) ** 2
    )


def test_the_removal_rate_is_given_in_the_trades_unit() -> None:
    assert mrr_mm3_min(1e9) == 60.0
