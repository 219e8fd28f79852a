"""Signal to noise, response tables, Pareto front, and preferences, against worked examples."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edmctl.study.analysis import grey_relational_grade, pareto_front
from edmctl.study.statistics.response_analysis import response_table, signal_to_noise_db


@pytest.mark.parametrize(
    ("values", "better", "decibel"),
    [
        ([10, 10], "larger", 20.0),
        ([0.1, 0.1], "smaller", 20.0),
        ([9, 11], "nominal", 10 * math.log10(100 / 2)),
        ([1, 3], "smaller", -10 * math.log10(5)),
        ([0, 1], "larger", math.nan),
        ([0, 0], "smaller", math.nan),
        ([5], "nominal", math.nan),
        ([2, 2], "nominal", math.nan),
    ],
)
def test_signal_to_noise_ratios(values: list[float], better: str, decibel: float) -> None:
    assert signal_to_noise_db(values, better) == pytest.approx(decibel, nan_ok=True)  # type: ignore[arg-type]


def test_a_response_table_ranks_by_delta() -> None:
    table = response_table(
        {"oil": ["b", "a", "b", "a"], "current": [2.0, 2.0, 1.0, 1.0]}, [1.0, 5.0, 2.0, 7.0]
    )
    oil, current = table
    assert (oil.levels, oil.means, oil.delta, oil.rank) == (("b", "a"), (1.5, 6.0), 4.5, 1)
    assert (current.levels, current.means, current.rank) == ((1.0, 2.0), (4.5, 3.0), 2)


def test_a_run_is_on_the_front_where_none_is_better_in_all() -> None:
    runs = np.array([[1, 1], [2, 2], [3, 1], [1, 3], [2, 1], [math.nan, 9], [2, 2]])
    assert pareto_front(-runs).tolist() == [False, True, True, True, False, False, True]
    assert pareto_front([[-1, 1], [-2, 2]]).tolist() == [True, True]
    assert pareto_front([[-1, 2], [-2, 1]]).tolist() == [False, True]


def test_grades_of_best_and_worst_and_weights_are_shares() -> None:
    costs = [[-1, 10], [-2, 5], [-3, 1]]
    grade = grey_relational_grade(costs, [1, 1])
    assert grade == pytest.approx([1 / 3, (0.5 + 0.5 / (4 / 9 + 0.5)) / 2, 1])
