"""The mean gap voltage against the gap."""

from __future__ import annotations

import math
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edmctl.process.voltage import (
    IgnitionLaw,
    burning_share,
    clean_oil_level,
    clean_oil_spark_probability,
    discharge_share,
    isopulse_discharge_share,
    level,
    open_share,
    spark_probability,
)

ON_TIME_US = 0.30 / 2300.0 * 1e6
TABLE = {
    # gap µm: (level, share of sparks) of a Monte-Carlo run at 40 V, duty 0.30, 2300 Hz, clean oil
    1.0: (0.556, 1.00),
    1.5: (0.571, 1.00),
    2.0: (0.616, 0.998),
    2.5: (0.703, 0.93),
    3.0: (0.803, 0.73),
    3.5: (0.877, 0.49),
    4.0: (0.924, 0.32),
    5.0: (0.967, 0.14),
    6.0: (0.984, 0.07),
    8.0: (0.995, 0.02),
}


@pytest.mark.parametrize("gap_um", TABLE)
def test_the_clean_oil_law_gives_the_simulated_level_within_a_hundredth(gap_um: float) -> None:
    s = clean_oil_level(
        gap_um, on_time_us=ON_TIME_US, open_voltage_v=40.0, discharge_voltage_v=22.0, law=IgnitionLaw()
    )
    assert s == pytest.approx(TABLE[gap_um][0], abs=0.01)


@pytest.mark.parametrize("gap_um", TABLE)
def test_the_clean_oil_law_gives_the_simulated_share_of_sparks(gap_um: float) -> None:
    p = clean_oil_spark_probability(gap_um, on_time_us=ON_TIME_US, open_voltage_v=40.0, law=IgnitionLaw())
    assert p == pytest.approx(TABLE[gap_um][1], abs=0.01)


def test_the_gap_that_ignites_scales_with_the_open_voltage() -> None:
    law = IgnitionLaw()
    assert law.tau_us(5.0, 80.0) == pytest.approx(law.tau_us(2.5, 40.0))
    assert law.tau_us(0.0, 40.0) == 0.0


def test_the_closed_forms_agree_with_drawn_delays() -> None:
    rng = random.Random(1)
    tau, cut = 0.7, 0.4
    delays = [rng.expovariate(1.0 / tau) for _ in range(200_000)]
    n = len(delays)
    assert open_share(tau) == pytest.approx(math.fsum(min(d, 1.0) for d in delays) / n, abs=3e-3)
    assert spark_probability(tau) == pytest.approx(sum(d < 1.0 for d in delays) / n, abs=3e-3)
    burnt = math.fsum(min(cut, max(0.0, 1.0 - d)) for d in delays) / n
    assert burning_share(tau, cut) == pytest.approx(burnt, abs=3e-3)


@given(st.floats(0.01, 100.0), st.floats(0.1, 0.9))
def test_the_level_reads_back_as_the_burning_share(x: float, rho: float) -> None:
    assert discharge_share(level(x, rho), rho) == pytest.approx(1.0 - open_share(x), abs=1e-9)
    assert burning_share(x, 1.0) == pytest.approx(1.0 - open_share(x), abs=1e-9)


def test_a_closed_and_an_endless_gap_are_the_ends_of_the_scale() -> None:
    assert level(0.0, 0.55) == 0.55
    assert level(1e9, 0.55) == pytest.approx(1.0, abs=1e-6)
    assert spark_probability(0.0) == 1.0


@given(st.floats(0.6, 0.95))
def test_an_uncut_isopulse_burns_as_an_isofrequency_pulse(s: float) -> None:
    assert isopulse_discharge_share(s, 0.55, 1.0) == pytest.approx(discharge_share(s, 0.55), abs=1e-6)


def test_a_cut_isopulse_burns_less_at_the_same_level() -> None:
    assert isopulse_discharge_share(0.8, 0.55, 0.3) < 0.9 * discharge_share(0.8, 0.55)
