"""What one discharge removes of work and tool, and what the surface comes to."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edmctl.process.erosion import (
    LAW,
    USUAL_PULSE_UJ,
    corner_radius_um,
    delay_over_on_time,
    efficiency,
    first_gap_u_um,
    first_sparks_um,
    material,
    materials,
    mrr_mm3_min,
    open_share,
    pulse_energy_uj,
    removal_um3_per_uj,
    roughness_ra_um,
    widening_um,
)

CURRENT_A = 0.12


def wear_ratio(burning_us: float, *, tool_negative: bool) -> float:
    """Tool over work, copper on copper."""
    work, tool = removal_um3_per_uj(LAW, burning_us, CURRENT_A, tool_negative=tool_negative)
    return tool / work


def test_removal_per_energy_has_an_optimum_that_grows_with_current() -> None:
    times_us = range(5, 300)
    for current_a, factor in ((0.12, 1.0), (1.2, 10.0**LAW.peak_per_current)):
        best_us = max(times_us, key=lambda t: efficiency(LAW, t, current_a))
        assert best_us == pytest.approx(LAW.peak_us * factor, abs=1.0)
        assert efficiency(LAW, best_us, current_a) == pytest.approx(1.0, abs=1e-3)


def test_long_pulses_spare_a_positive_tool_and_wear_a_negative_one() -> None:
    positive = [wear_ratio(t, tool_negative=False) for t in (5.0, 30.0, 130.0, 300.0)]
    negative = [wear_ratio(t, tool_negative=True) for t in (5.0, 30.0, 130.0, 300.0)]
    assert positive == sorted(positive, reverse=True)
    assert negative == sorted(negative)
    assert positive[0] > 2.0 > 0.1 > positive[-1]
    crossing_us = next(
        t for t in range(5, 400) if wear_ratio(t, tool_negative=False) < wear_ratio(t, tool_negative=True)
    )
    assert 100 <= crossing_us <= 260


def test_anode_and_cathode_share_a_pulse() -> None:
    for burning_us in (10.0, 100.0):
        straight, reversed_ = (
            removal_um3_per_uj(LAW, burning_us, CURRENT_A, tool_negative=negative)[0]
            for negative in (True, False)
        )
        whole = LAW.removal_um3_per_uj * efficiency(LAW, burning_us, CURRENT_A)
        assert straight + reversed_ == pytest.approx(whole)
        assert straight > reversed_


def test_roughness_is_the_cube_root_of_the_craters_volume() -> None:
    assert roughness_ra_um(8.0) == pytest.approx(0.2)
    assert roughness_ra_um(8000.0) / roughness_ra_um(8.0) == pytest.approx(10.0)
    assert roughness_ra_um(8.0, arc_share=1.0) == pytest.approx(0.3)


def test_a_corner_wears_round_and_then_no_rounder() -> None:
    assert corner_radius_um(0.0, 270.0) == 0.0
    assert corner_radius_um(1.0, 270.0) == pytest.approx(0.5, rel=0.02)
    assert corner_radius_um(2000.0, 270.0) == pytest.approx(0.15 * 270.0, rel=1e-6)


def test_a_wall_widens_the_slower_the_wider_it_is() -> None:
    assert widening_um(0.0, 8.0) == 0.0
    assert widening_um(0.1, 8.0) == pytest.approx(0.1, rel=0.05)
    widths_um = [widening_um(10.0 * n, 8.0) for n in range(4)]
    steps_um = [b - a for a, b in pairwise(widths_um)]
    assert steps_um == sorted(steps_um, reverse=True)
    assert steps_um[-1] > 0.0


def test_every_material_says_what_it_rests_on() -> None:
    for found in materials().values():
        assert found.source
        assert found.removal is not None or found.wear is not None
        assert found.u_rel >= 0.3 or "Muralidhara" in found.source


def test_a_material_is_found_by_symbol_and_name_and_is_not_guessed() -> None:
    for written in ("Cu", "cu", " copper ", "Ti-6Al-4V", "ti-6al-4v", "WC-Co", "brass", "graphite"):
        found = material(written)
        assert found is not None
        assert written.strip().casefold() in (found.symbol.casefold(), found.name.casefold())
    assert material("cheese") is None


def test_what_users_machine_is_there() -> None:
    tools = {symbol for symbol, found in materials().items() if found.wear is not None}
    work = {symbol for symbol, found in materials().items() if found.removal is not None}
    assert tools >= {"Cu", "W", "WC", "brass", "graphite"}
    assert work >= {"steel", "Cu", "Ti-6Al-4V", "WC-Co"}


@pytest.mark.parametrize(("level", "rho", "cut"), [(0.6, 0.55, 1.0), (0.95, 0.55, 1.0), (0.8, 0.55, 0.3)])
def test_drawn_delays_give_the_level_that_a_delay_was_found_for(level: float, rho: float, cut: float) -> None:
    import numpy as np

    tau = delay_over_on_time(level, rho, cut)
    delays = np.random.default_rng(1).exponential(tau, 200_000)
    opened, burning = np.minimum(delays, 1.0).mean(), np.clip(1.0 - delays, 0.0, cut).mean()
    assert open_share(tau) == pytest.approx(opened, abs=3e-3)
    assert opened + rho * burning == pytest.approx(level, abs=3e-3)


@given(st.floats(0.01, 100.0), st.floats(0.1, 0.9))
def test_the_level_of_uncut_pulses_is_that_of_their_open_share(x: float, rho: float) -> None:
    assert delay_over_on_time(rho + (1.0 - rho) * open_share(x), rho) == pytest.approx(x, rel=1e-6)


def test_a_closed_and_an_endless_gap_are_the_ends_of_the_scale() -> None:
    assert open_share(0.0) == 0.0
    assert open_share(1e9) == pytest.approx(1.0, abs=1e-6)


def test_energy_and_removal_are_in_the_trades_units() -> None:
    assert pulse_energy_uj(22.0, 0.12, 130.43) == pytest.approx(344.3, abs=0.1)
    assert pytest.approx(344.3, abs=0.1) == USUAL_PULSE_UJ
    assert mrr_mm3_min(1e9) == 60.0


@pytest.mark.parametrize("voltage_v", [30.0, 40.0, 80.0, 200.0])
def test_first_sparks_are_less_certain_than_the_gap(voltage_v: float) -> None:
    before_um, before_u_um = first_sparks_um(voltage_v)
    assert before_um > 0.0
    assert before_u_um > first_gap_u_um(voltage_v) > 0.0


def test_uncertainty_grows_with_the_open_voltage_above_the_usual_one() -> None:
    assert (first_gap_u_um(30.0), first_gap_u_um(80.0)) == pytest.approx((0.8, 1.6))
    assert first_sparks_um(30.0) == pytest.approx((0.9, 1.5))
    assert first_sparks_um(80.0) == pytest.approx((2.4, 3.0))
