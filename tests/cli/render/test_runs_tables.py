"""Tables of many runs: side by side, where there is room for them, and the statistics of simulated ones."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

from edmctl.cli.render.runs_tables import render_cases, render_comparison
from edmctl.cli.render.terminal import Style
from edmctl.results.job import Case, SimulatedRun, Statistics
from edmctl.results.run_file import Amount, ComparedRun, Comparison, Quantity, Setting


def made_comparison(number: int, value: str = "0.8") -> Comparison:
    """So many runs, which differ in one setting, with a depth each."""
    runs = tuple(
        ComparedRun(f"runs/of-a-long-name-{i}.h5", f"{i}", "", "2026-01-02T03:04:05", "done", True, i, 1)
        for i in range(number)
    )
    amount = Amount(180.25, 0.61, 0.12, 0.86, beyond=False)
    settings = (Setting("servo.reference", "", tuple(f"{value}{i}" for i in range(number))),)
    return Comparison(runs, settings, (Quantity("depth_um", "depth, µm", 2, 1.0, (amount,) * number),), ())


def test_a_comparison_has_two_columns_for_each_further_run_and_fits_a_terminal() -> None:
    for number, columns in ((2, 60), (3, 80), (4, 120), (4, None)):
        text = render_comparison(made_comparison(number), Style(colour=False, live=False, columns=columns))
        lines = [line for line in text.splitlines() if not line.startswith(("±", "*"))]
        assert columns is None or max(map(len, lines)) <= columns
        assert len(re.findall("[B-D] − A", text)) == number - 1 or columns == 60


def made(mean: float, sd: float = 0.5) -> Statistics:
    return Statistics(mean, sd, 1.0, 9.0)


def made_case(label: str = "cu270", **changes: Any) -> Case:
    known = Case(
        label=label,
        overrides=(),
        runs=(SimulatedRun(1, True, 0, None), SimulatedRun(2, True, 0, None)),
        failed=0,
        spreads={"depth_um": made(180.25), "depth_error_um": made(0.75)},
        by_model={},
        estimated={},
        truth={"depth_um": made(179.5), "wear_um": made(70.0)},
        coverage={"depth": 1.0, "wear": 0.5},
    )
    return replace(known, **changes)


def test_truth_and_measurement_have_rows_of_their_own() -> None:
    rows = {line.split(",")[0]: line for line in render_cases([made_case()]).splitlines()}
    assert "179.50" in rows["true depth"]
    assert "70.00" in rows["true wear"]
    assert "180.25" in rows["depth"]


def test_what_was_not_touched_has_rows_of_its_own() -> None:
    case = made_case(spreads={}, estimated={"depth_um": made(180.0, 0.0)}, by_model={"wear_um": made(71.5)})
    rows = {line.split(",")[0]: line for line in render_cases([case]).splitlines()}
    assert "180.00   0.00" in rows["depth estimated"]
    assert "71.50" in rows["tool wear by model"]
    assert not {"depth", "tool wear"} & set(rows)


def test_an_overview_leads_with_the_truth() -> None:
    overview = render_cases([made_case("a"), made_case("b", spreads={}, truth={}, failed=2)])
    header, *lines = overview.splitlines()
    assert header.index("true depth") < header.index("depth error")
    assert "179.50 ± 0.50" in next(line for line in lines if line.startswith("a"))
    assert "2 of 2" in next(line for line in lines if line.startswith("b"))


def test_an_overview_fits_a_narrow_terminal() -> None:
    cases = [made_case(f"servo.reference=0.7{i}") for i in range(3)]
    whole, narrow = (
        render_cases(cases, Style(colour=False, live=False, columns=columns)) for columns in (None, 80)
    )
    assert max(map(len, whole.splitlines())) > 80 >= max(map(len, narrow.splitlines()))
    assert "depth error" in narrow
    assert narrow.splitlines()[-1] == "Hidden columns (terminal too narrow): true depth, true wear."
