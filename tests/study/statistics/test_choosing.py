"""Signal to noise, response tables, Pareto front and preferences, against worked examples."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edmctl.study.statistics.choice import grey_relational_grade, pareto_front, topsis_closeness
from edmctl.study.statistics.response_analysis import response_table, signal_to_noise_db


def test_signal_to_noise_ratios() -> None:
    assert signal_to_noise_db([10, 10], "larger") == pytest.approx(20)
    assert signal_to_noise_db([0.1, 0.1], "smaller") == pytest.approx(20)
    assert signal_to_noise_db([9, 11], "nominal") == pytest.approx(10 * math.log10(100 / 2))
    assert signal_to_noise_db([1, 3], "smaller") == pytest.approx(-10 * math.log10(5))


@pytest.mark.parametrize(
    ("values", "better"), [([0, 1], "larger"), ([0, 0], "smaller"), ([5], "nominal"), ([2, 2], "nominal")]
)
def test_a_ratio_that_is_not_defined(values: list[float], better: str) -> None:
    assert math.isnan(signal_to_noise_db(values, better))  # type: ignore[arg-type]


def test_a_response_table_ranks_by_delta() -> None:
    table = response_table(
        {"oil": ["b", "a", "b", "a"], "current": [2.0, 2.0, 1.0, 1.0]}, [1.0, 5.0, 2.0, 7.0]
    )
    oil, current = table
    assert (oil.levels, oil.means, oil.delta, oil.rank) == (("b", "a"), (1.5, 6.0), 4.5, 1)
    assert (current.levels, current.means, current.rank) == ((1.0, 2.0), (4.5, 3.0), 2)


def test_a_run_is_on_the_front_where_none_is_better_in_all() -> None:
    runs = np.array([[1, 1], [2, 2], [3, 1], [1, 3], [2, 1], [math.nan, 9], [2, 2]])
    front = pareto_front(runs, ["larger", "larger"])
    assert front.tolist() == [False, True, True, True, False, False, True]
    assert pareto_front([[1, 1], [2, 2]], ["larger", "smaller"]).tolist() == [True, True]
    assert pareto_front([[1, 2], [2, 1]], ["larger", "smaller"]).tolist() == [False, True]


def test_grey_relational_grade_of_best_and_worst() -> None:
    grade = grey_relational_grade([[1, 10], [2, 5], [3, 1]], ["larger", "smaller"], [1, 1])
    assert grade == pytest.approx([1 / 3, (0.5 + 0.5 / (4 / 9 + 0.5)) / 2, 1])


def test_topsis_of_best_and_worst() -> None:
    closeness = topsis_closeness([[1, 10], [2, 5], [3, 1]], ["larger", "smaller"], [1, 3])
    assert closeness[[0, 2]] == pytest.approx([0, 1])
    assert 0 < closeness[1] < 1


def test_weights_are_shares() -> None:
    responses = np.random.default_rng(0).uniform(1, 2, (6, 2))
    one = topsis_closeness(responses, ["larger", "smaller"], [1, 2])
    assert one == pytest.approx(topsis_closeness(responses, ["larger", "smaller"], [10, 20]))
