"""Energy of discharges, and what the mean gap voltage says of them."""

from __future__ import annotations

import math
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edmctl.process.discharge import (
    burning_share,
    delay_over_on_time,
    mrr_mm3_min,
    open_share,
    pulse_energy_uj,
)


def test_the_closed_forms_agree_with_drawn_delays() -> None:
    rng = random.Random(1)
    tau, cut = 0.7, 0.4
    delays = [rng.expovariate(1.0 / tau) for _ in range(200_000)]
    n = len(delays)
    assert open_share(tau) == pytest.approx(math.fsum(min(d, 1.0) for d in delays) / n, abs=3e-3)
    burnt = math.fsum(min(cut, max(0.0, 1.0 - d)) for d in delays) / n
    assert burning_share(tau, cut) == pytest.approx(burnt, abs=3e-3)


@given(st.floats(0.01, 100.0), st.floats(0.1, 0.9))
def test_the_level_reads_back_as_the_burning_share(x: float, rho: float) -> None:
    assert delay_over_on_time(rho + (1.0 - rho) * open_share(x), rho) == pytest.approx(x, rel=1e-6)
    assert burning_share(x, 1.0) == pytest.approx(1.0 - open_share(x), abs=1e-9)


def test_a_closed_and_an_endless_gap_are_the_ends_of_the_scale() -> None:
    assert open_share(0.0) == 0.0
    assert open_share(1e9) == pytest.approx(1.0, abs=1e-6)


@given(st.floats(0.6, 0.95))
def test_an_uncut_isopulse_burns_as_an_isofrequency_pulse(s: float) -> None:
    assert burning_share(delay_over_on_time(s, 0.55), 1.0) == pytest.approx(
        (1.0 - s) / (1.0 - 0.55), abs=1e-6
    )


def test_a_cut_isopulse_burns_less_at_the_same_level() -> None:
    assert burning_share(delay_over_on_time(0.8, 0.55, 0.3), 0.3) < 0.9 * (1.0 - 0.8) / (1.0 - 0.55)


FULL_PULSE_UJ = pulse_energy_uj(22.0, 0.12, 130.43)


def test_a_full_pulse_holds_a_few_hundred_microjoules() -> None:
    assert pytest.approx(344.3, abs=0.1) == FULL_PULSE_UJ


def test_the_removal_rate_is_given_in_the_trades_unit() -> None:
    assert mrr_mm3_min(1e9) == 60.0
