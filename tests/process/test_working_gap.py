"""What is believed of the first sparks and of the working gap before it is measured."""

from __future__ import annotations

import pytest

from edmctl.process.discharge import first_gap_u_um, first_sparks_um


@pytest.mark.parametrize("voltage_v", [30.0, 40.0, 80.0, 200.0])
def test_first_sparks_are_less_certain_than_the_gap(voltage_v: float) -> None:
    before_um, before_u_um = first_sparks_um(voltage_v)
    assert before_um > 0.0
    assert before_u_um > first_gap_u_um(voltage_v) > 0.0


def test_uncertainty_grows_with_the_open_voltage() -> None:
    assert first_gap_u_um(80.0) == pytest.approx(1.6)
    assert first_sparks_um(80.0) == pytest.approx((2.4, 3.0))


def test_below_it_nothing_is_known_better() -> None:
    assert first_gap_u_um(30.0) == 0.8
    assert first_sparks_um(30.0) == pytest.approx((0.9, 1.5))
