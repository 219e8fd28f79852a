"""Tables of simulated runs."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from edmctl.console.statistics_table import render_cases
from edmctl.console.style import Style
from edmctl.results.simulation import Case, SimulatedRun, Statistics


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
    assert narrow.splitlines()[-1] == "Not shown, for want of width: true depth, true wear."
