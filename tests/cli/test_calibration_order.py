"""What `calibrate` refuses before it begins: numbers that nothing can have measured."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from edmctl.record.columns import write_columns
from tests.cli.commands import Here

T_S = np.arange(500) / 50.0
U_V = 75.0 - 75.0 * np.cos(T_S)


@pytest.mark.parametrize("column", ["t_s", "u_V", "y_um"])
@pytest.mark.parametrize("value", [1e300, -1.7e308, 9.9e37])
def test_a_number_that_nothing_measures_is_named_with_its_sample(
    here: Here, column: str, value: float
) -> None:
    columns = {"t_s": T_S, "u_V": U_V, "y_um": 3.0 * U_V + np.sin(T_S)}
    write_columns(Path("good.csv"), columns)
    columns[column] = np.where(np.arange(500) == 41, value, columns[column])
    write_columns(Path("huge.csv"), columns)
    for files in (("--from", "huge.csv"), ("--from", "good.csv", "--validate", "huge.csv")):
        error = here("calibrate", *files, "--json").document["error"]
        told = f"huge.csv: 1 of 500 values of {column} cannot have been measured"
        assert (error["code"], error["message"]) == ("E3612", f"{told}, the first, {value:g}, at sample 42.")
        assert error["hint"]


def test_a_number_that_nothing_measures_gives_no_lever_factor(here: Here) -> None:
    write_columns(Path("huge.csv"), {"x_um": U_V, "z_um": 1e300 * U_V})
    said = here("calibrate", "--lever", "huge.csv", "--json")
    assert said.document["error"]["code"] == "E3622"
    assert "of 500 values of z_um cannot have been measured" in said.document["error"]["message"]


def test_what_is_not_finite_is_still_said_to_be_so(here: Here) -> None:
    write_columns(Path("inf.csv"), {"t_s": T_S, "u_V": U_V, "y_um": np.where(U_V > 149.0, np.inf, U_V)})
    assert (
        "of y_um are not finite"
        in here("calibrate", "--from", "inf.csv", "--json").document["error"]["message"]
    )
