"""The small solver against scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import nnls as reference

from edmctl.actuator.fitting import _minimise, nnls


@settings(max_examples=60)
@given(st.integers(1, 15), st.integers(0, 2**32 - 1))
def test_it_agrees_with_scipy(columns: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(40, columns))
    target = matrix @ np.maximum(rng.normal(size=columns), 0.0) + rng.normal(size=40)
    np.testing.assert_allclose(nnls(matrix, target), reference(matrix, target)[0], rtol=0, atol=1e-9)


def test_nearly_equal_columns_fit_as_well_as_scipy() -> None:
    rng = np.random.default_rng(1)
    base = rng.normal(size=(200, 1))
    matrix = base + 1e-3 * rng.normal(size=(200, 8))
    target = base[:, 0] + 1e-2 * rng.normal(size=200)
    found = nnls(matrix, target)
    assert (found >= 0.0).all()
    assert np.linalg.norm(matrix @ found - target) == pytest.approx(reference(matrix, target)[1], rel=1e-9)


def test_a_target_that_needs_negative_weights_gets_none() -> None:
    np.testing.assert_array_equal(nnls(np.eye(3), np.array([1.0, -2.0, 3.0])), [1.0, 0.0, 3.0])
    np.testing.assert_array_equal(nnls(np.eye(2), np.array([-1.0, -1.0])), [0.0, 0.0])


def test_a_column_that_is_worth_nothing_is_fixed_where_it_stands() -> None:
    with np.errstate(invalid="raise"):
        x = _minimise(np.eye(2), np.array([1.0, 0.0]), np.array([0.5, 0.0]), np.array([True, True]))
    assert x.tolist() == [1.0, 0.0]
