"""Sobol indices of a function whose own are known."""

from __future__ import annotations

import numpy as np
import pytest

from edmctl.study.statistics.choice import sensitivity_points, sobol_indices

FIRST = (0.3139, 0.4424, 0.0)
TOTAL = (0.5576, 0.4424, 0.2437)


def ishigami(points: np.ndarray) -> np.ndarray:
    """Ishigami and Homma, 1990, with a = 7 and b = 0.1."""
    x = (points * 2 - 1) * np.pi
    made: np.ndarray = np.sin(x[:, 0]) + 7 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])
    return made


@pytest.mark.parametrize("seed", range(5))
def test_indices_of_ishigami(seed: int) -> None:
    found = sobol_indices(ishigami(sensitivity_points(3, 1024, seed)), 3)
    assert found.first_order == pytest.approx(FIRST, abs=0.02)
    assert found.total == pytest.approx(TOTAL, abs=0.02)
    assert (np.abs(found.first_order - FIRST) < found.first_order_u95).all()
    assert (np.abs(found.total - TOTAL) < found.total_u95).all()


def test_a_missing_response_takes_one_base_sample_out() -> None:
    response = ishigami(sensitivity_points(3, 1024, 0))
    whole = sobol_indices(response, 3)
    response[1500] = np.nan
    found = sobol_indices(response, 3)
    assert found.first_order == pytest.approx(whole.first_order, abs=0.01)
    assert found.first_order[0] != whole.first_order[0]


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(ValueError, match="power of two, such as 128"):
        sensitivity_points(2, 100, 0)
    with pytest.raises(ValueError, match="no multiple"):
        sobol_indices(np.ones(9), 2)
    with pytest.raises(ValueError, match="Fewer than two base samples"):
        sobol_indices(np.full(8, np.nan), 2)
