"""Fits and tables agree with statsmodels to 1e-10."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from edmctl.errors import PreconditionError
from edmctl.study.statistics.designs import arrays
from edmctl.study.statistics.linear_model import (
    Settings,
    anova,
    differing,
    fit,
    main_effects,
    model_matrix,
    pooled_anova,
    second_order,
    with_interactions,
)
from tests.tiers import tiers


def of_statsmodels(formula: str, columns: Mapping[str, object]) -> Any:
    """The fit of a formula by statsmodels."""
    import pandas as pd
    import statsmodels.formula.api as smf

    return smf.ols(formula, pd.DataFrame(columns)).fit()


def table_of(*models: Any, **options: object) -> Any:
    """The analysis of variance of fits by statsmodels."""
    from statsmodels.stats.anova import anova_lm

    return anova_lm(*models, **options)


def close(value: object) -> Any:
    """Return what is equal to 1e-10."""
    return pytest.approx(value, rel=1e-10, abs=1e-10)


def unbalanced(seed: int) -> tuple[Settings, np.ndarray, dict[str, object]]:
    """Runs of two numbers and a category, as if some had been lost."""
    rng = np.random.default_rng(seed)
    x, z = rng.uniform(-1, 1, (2, 25))
    oil = list(rng.choice(["water", "kerosene", "mineral"], 25))
    y = (
        3
        + x
        - 2 * z
        + x * z
        + 0.5 * x**2
        + np.array([len(name) / 5 for name in oil])
        + rng.normal(0, 0.3, 25)
    )
    settings = Settings({"x": x, "z": z}, {"oil": oil}, {"oil": ("water", "kerosene", "mineral")})
    return settings, y, {"x": x, "z": z, "oil": oil, "y": y}


FORMULA = "y ~ x + z + C(oil, Sum) + x:z + x:C(oil, Sum) + z:C(oil, Sum) + I(x**2) + I(z**2)"


@pytest.mark.parametrize("seed", range(3))
def test_sums_of_squares_are_those_of_statsmodels(seed: int) -> None:
    settings, y, frame = unbalanced(seed)
    table = anova(settings, second_order(["x", "z"], ["oil"]), y)
    model = of_statsmodels(FORMULA, frame)
    third = table_of(model, typ=3)
    order = ["x", "z", "C(oil, Sum)", "x:z", "x:C(oil, Sum)", "z:C(oil, Sum)", "I(x ** 2)", "I(z ** 2)"]
    for row, name in zip(table.rows, order, strict=True):
        assert row.dof == third.loc[name, "df"]
        assert row.adjusted_ss == close(third.loc[name, "sum_sq"])
        assert row.f == close(third.loc[name, "F"])
        assert row.p == close(third.loc[name, "PR(>F)"])
    assert table.error.dof == model.df_resid
    assert table.error.adjusted_ss == close(third.loc["Residual", "sum_sq"])
    assert sum(row.contribution_pct for row in table.rows) + table.error.contribution_pct == pytest.approx(
        100
    )
    assert sum(row.pure_pct for row in table.rows) + table.error.pure_pct == pytest.approx(100)


@pytest.mark.parametrize("seed", range(3))
def test_sequential_sums_of_squares_are_those_of_statsmodels(seed: int) -> None:
    settings, y, frame = unbalanced(seed)
    table = anova(settings, main_effects(["oil", "z", "x"]), y)
    first = table_of(of_statsmodels("y ~ C(oil, Sum) + z + x", frame), typ=1)
    assert [row.sequential_ss for row in table.rows] == close(first["sum_sq"].tolist()[:-1])


def test_leaving_a_run_out_is_what_a_fit_without_it_says() -> None:
    settings, y, _ = unbalanced(5)
    terms = main_effects(["x", "z"])
    whole = fit(model_matrix(settings, terms), y)
    rest = np.arange(1, len(y))
    numbers = {name: np.asarray(values) for name, values in settings.numbers.items()}
    without = fit(model_matrix(Settings({name: v[rest] for name, v in numbers.items()}), terms), y[rest])
    first = model_matrix(Settings({name: v[:1] for name, v in numbers.items()}), terms).columns
    assert whole.left_out_residuals[0] == pytest.approx(y[0] - (first @ without.ols.params)[0])


def test_lack_of_fit_is_the_test_between_the_two_models() -> None:
    from edmctl.study.statistics.response_analysis import Runs, analyse

    rng = np.random.default_rng(2)
    x = np.repeat([-1.0, -0.5, 0, 0.5, 1], 3)
    y = 1 + x + 0.8 * x**2 + rng.normal(0, 0.2, 15)
    runs = Runs(Settings({"x": x}), {"x": x.tolist()}, x.tolist(), [0] * 15)
    found = analyse("y", runs, y, main_effects(["x"]), "smaller").lack
    assert found is not None
    against = table_of(*(of_statsmodels(formula, {"x": x, "y": y}) for formula in ("y ~ x", "y ~ C(x)")))
    assert (found.dof, found.pure_dof) == (3, 10)
    assert found.f == close(against["F"][1])
    assert found.p == close(against["Pr(>F)"][1])


def saturated() -> tuple[Settings, np.ndarray]:
    levels = arrays()["L9 (3^4)"].levels
    names = ("low", "middle", "high")
    columns = {name: [names[level] for level in levels[:, n]] for n, name in enumerate("ABCD")}
    settings = Settings({}, columns, dict.fromkeys("ABCD", names))
    return settings, np.random.default_rng(1).normal(levels[:, 0] * 5.0 + levels[:, 1], 0.3)


def test_no_f_where_nothing_is_left_to_estimate_the_error() -> None:
    settings, y = saturated()
    table = anova(settings, main_effects(list("ABCD")), y)
    assert table.error.dof == 0
    assert all(np.isnan(row.f) and np.isnan(row.p) for row in table.rows)
    assert sum(row.contribution_pct for row in table.rows) == pytest.approx(100)


def test_pooling_names_what_it_counts_as_error() -> None:
    settings, y = saturated()
    whole = {row.name: row for row in anova(settings, main_effects(list("ABCD")), y).rows}
    table = pooled_anova(settings, main_effects(list("ABCD")), y)
    assert set(table.pooled) == {"C", "D"}
    assert [row.name for row in table.rows] == ["A", "B"]
    assert table.error.dof == 4
    assert table.error.adjusted_ss == pytest.approx(sum(whole[name].adjusted_ss for name in table.pooled))
    assert table.rows[0].f > 100


def test_terms_that_the_runs_do_not_determine_are_named() -> None:
    x = np.array([-1.0, 1, -1, 1])
    settings = Settings({"x": x, "z": x})
    with pytest.raises(ValueError, match=r"These runs do not determine z, x × z\."):
        fit(model_matrix(settings, with_interactions(["x", "z"])), [1.0, 2, 3, 4])


def test_a_response_that_does_not_vary_has_no_shares() -> None:
    x = np.array([-1.0, 0, 1, 0])
    table = anova(Settings({"x": x}), main_effects(["x"]), [2.0] * 4)
    assert np.isnan(table.rows[0].contribution_pct)


def test_a_factor_without_effect_is_flagged_as_often_as_the_level_says() -> None:
    rng = np.random.default_rng(11)
    settings, _ = saturated()
    twice = Settings({}, {name: [*v, *v] for name, v in settings.categories.items()}, settings.names)
    flagged = sum(
        anova(twice, main_effects(["A", "B"]), rng.normal(0, 1, 18)).rows[1].p < 0.05 for _ in range(400)
    )
    assert 0.02 <= flagged / 400 <= 0.09


BLOCKED = ["x", "nothing", "block"]


def on_machines(seed: int, machines: int, differing_sd: float) -> tuple[Settings, np.ndarray]:
    """A 2 × 2 on several machines, of two factors with no effect on average; the first differs between machines."""
    rng = np.random.default_rng(seed)
    x, nothing = np.tile([-1.0, -1.0, 1.0, 1.0], machines), np.tile([-1.0, 1.0], 2 * machines)
    block = np.repeat(np.arange(machines), 4)
    y = rng.normal(0, 1, len(x)) + rng.normal(0, 2, machines)[block]
    y += differing_sd * rng.normal(0, 1, machines)[block] * x
    return Settings({"x": x, "nothing": nothing}, {"block": list(block)}, {"block": range(machines)}), y


def test_a_factor_that_differs_between_machines_is_compared_with_that_as_statsmodels_does() -> None:
    settings, y = on_machines(3, 4, 5.0)
    terms = main_effects(BLOCKED)
    products = differing(settings, terms, y)
    table = anova(settings, terms, y, by_block=products)
    columns = {**settings.numbers, **settings.categories, "y": y}
    model = of_statsmodels("y ~ x + nothing + C(block, Sum) + x:C(block, Sum)", columns)
    third = table_of(model, typ=3)
    mean_squares = third["sum_sq"] / third["df"]
    rows = {row.name: row for row in table.rows}
    assert [row.name for row in table.by_block] == ["x × block"]
    assert table.error.dof == third["df"]["Residual"]
    assert rows["nothing"].f == close(third["F"]["nothing"])
    assert rows["x × block"].p == close(third["PR(>F)"]["x:C(block, Sum)"])
    assert rows["x"].f == close(mean_squares["x"] / mean_squares["x:C(block, Sum)"])
    assert (table.under("x").name, table.under("nothing").name) == ("x × block", "error")


@pytest.mark.parametrize("differing_sd", tiers(0.0, slow=[1.0, 3.0]))
def test_what_one_factor_does_differently_on_machines_is_no_error_of_another(differing_sd: float) -> None:
    count, flagged = 600, 0
    for seed in range(count):
        settings, y = on_machines(seed, 3, differing_sd)
        terms = main_effects(BLOCKED)
        table = anova(settings, terms, y, by_block=differing(settings, terms, y))
        flagged += next(row.p for row in table.rows if row.name == "nothing") < 0.05
    assert 0.02 * count <= flagged <= 0.09 * count


def test_pooling_keeps_what_a_factor_does_differently_apart() -> None:
    settings, y = on_machines(3, 4, 5.0)
    terms = main_effects(BLOCKED)
    products = differing(settings, terms, y)
    whole, pooled = (of(settings, terms, y, by_block=products) for of in (anova, pooled_anova))
    assert [row.name for row in pooled.by_block] == ["x × block"]
    assert "x" not in pooled.pooled
    assert pooled.under("x").mean_square == close(whole.under("x").mean_square)


def test_nothing_stands_out_of_an_error_of_rounding() -> None:
    for seed in range(50):
        settings, _ = on_machines(seed, 3, 0.0)
        x, block = np.asarray(settings.numbers["x"]), np.asarray(settings.categories["block"])
        assert not differing(settings, main_effects(BLOCKED), 0.1 * x + 0.7 * block)


@pytest.mark.slow
def test_a_factor_that_does_nothing_on_average_is_seldom_flagged_where_there_are_machines_enough() -> None:
    count, flagged, plainly = 400, 0, 0
    for seed in range(count):
        settings, y = on_machines(seed, 5, 3.0)
        terms = main_effects(BLOCKED)
        for by_block in (differing(settings, terms, y), []):
            p = next(row.p for row in anova(settings, terms, y, by_block=by_block).rows if row.name == "x")
            flagged, plainly = (
                (flagged + (p < 0.05), plainly) if by_block else (flagged, plainly + (p < 0.05))
            )
    assert flagged <= 0.10 * count < plainly


def test_without_statsmodels_the_remedy_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "statsmodels.regression.linear_model", None)
    with pytest.raises(PreconditionError, match="needs statsmodels") as missing:
        fit(model_matrix(Settings({"x": [-1.0, 0, 1]}), main_effects(["x"])), [1.0, 2, 3])
    assert (missing.value.code, "edmctl[study]" in missing.value.hint) == ("E8219", True)
