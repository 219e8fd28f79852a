"""Wear by energy: what is expected before a touch, and what a touch teaches."""

from __future__ import annotations

import pytest

from edmctl.process.channel import ToolWear, wearing_uj
from edmctl.process.live_erosion import Energy

KJ = 1e9
"""A kilojoule in µJ."""


def tool() -> ToolWear:
    return ToolWear(per_uj=1e-7, u_rel=0.14, touch_u_um=0.15)


def test_arcs_wear_nearly_as_much_per_energy_as_other_discharges() -> None:
    assert wearing_uj(Energy(100.0, 0.0)) == 100.0
    assert wearing_uj(Energy(0.0, 100.0)) == pytest.approx(69.5454)


def test_wear_grows_with_energy_and_so_does_its_uncertainty() -> None:
    wear = tool()
    assert wear.um(0.1 * KJ) == pytest.approx(10.0)
    assert wear.u_um(0.1 * KJ) == pytest.approx(1.41, abs=0.02)
    assert wear.u_um(0.0) == pytest.approx(0.15)


def test_a_long_cut_between_touches_teaches_the_rate_and_the_next_estimate_starts_at_the_touch() -> None:
    wear = tool()
    wear.learn(0.1 * KJ, 12.0, 0.1)
    assert wear.per_uj == pytest.approx(1.2e-7, rel=0.01)
    assert wear.u_rel < 0.03
    assert wear.um(0.0) == 12.0
    assert wear.um(0.05 * KJ) == pytest.approx(18.0, abs=0.1)


def test_a_short_cut_teaches_little_of_the_rate_but_all_of_the_length() -> None:
    wear = tool()
    wear.learn(0.001 * KJ, 0.4, 0.0)
    assert wear.per_uj == pytest.approx(1e-7, rel=0.02)
    assert wear.um(0.0) == 0.4


def test_drift_belongs_to_the_length_and_not_to_the_rate() -> None:
    steady, drifting = tool(), tool()
    steady.learn(0.02 * KJ, 2.6, 0.0)
    drifting.learn(0.02 * KJ, 2.6, 2.0)
    assert drifting.um(0.0) == steady.um(0.0) == 2.6
    assert abs(drifting.per_uj - 1e-7) < 0.2 * abs(steady.per_uj - 1e-7)


def test_a_wear_that_chance_does_not_explain_makes_the_belief_as_uncertain_as_it_was_wrong() -> None:
    wear = tool()
    wear.learn(0.1 * KJ, 4.0, 1.0)
    assert wear.per_uj == pytest.approx(0.5e-7, rel=0.2)
    assert abs(wear.per_uj - 0.4e-7) < 2.0 * wear.u_rel * wear.per_uj
