"""Intervals from estimate, standard uncertainty and degrees of freedom."""

from __future__ import annotations

import math

import pytest

from edmctl.quantity import Value, coverage_factor


@pytest.mark.parametrize("p", [0.5, 0.68, 0.95])
def test_quantile_is_students_at_any_degrees_of_freedom(p: float) -> None:
    from scipy.special import stdtrit

    for power in range(0, 1200, 3):
        dof = 10.0 ** (power / 200.0)
        assert coverage_factor(p, dof) == pytest.approx(stdtrit(dof, 0.5 + 0.5 * p), rel=2e-9)
    assert coverage_factor(p, 3e7) == pytest.approx(stdtrit(1e12, 0.5 + 0.5 * p), rel=1e-7)


def test_interval_of_a_value_grows_with_probability_and_with_few_degrees_of_freedom() -> None:
    assert Value(10.0, 2.0).u95 == pytest.approx(2.0 * 1.959963984540054)
    assert Value(10.0, 2.0).interval(0.5) == pytest.approx((8.6510, 11.3490), abs=1e-4)
    assert Value(10.0, 2.0, 3.0).interval() == pytest.approx((10.0 - 6.3649, 10.0 + 6.3649), abs=1e-4)
    assert math.isnan(Value(10.0, math.nan).u95)


@pytest.mark.parametrize(
    ("p", "dof"), [(0.0, 3.0), (1.0, 3.0), (math.nan, 3.0), (0.95, 0.5), (0.95, math.nan)]
)
def test_nonsense_has_no_quantile(p: float, dof: float) -> None:
    with pytest.raises(ValueError, match="degrees of freedom"):
        coverage_factor(p, dof)
