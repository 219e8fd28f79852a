"""What one discharge removes of work and tool, and what the surface comes to."""

from __future__ import annotations

from itertools import pairwise

import pytest

from edmctl.process.erosion import (
    LAW,
    USUAL_PULSE_UJ,
    corner_radius_um,
    efficiency,
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


def test_the_usual_pulse_is_that_of_the_paper() -> None:
    assert pytest.approx(344.3, abs=0.1) == USUAL_PULSE_UJ


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
