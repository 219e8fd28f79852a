"""Tables of simulated runs."""

from __future__ import annotations

from dataclasses import dataclass, field

from edmctl.console.spread_table import render_cases


@dataclass(frozen=True, slots=True)
class Spread:
    mean: float
    sd: float = 0.5
    minimum: float = 1.0
    maximum: float = 9.0


@dataclass(frozen=True, slots=True)
class Case:
    label: str = "cu270"
    runs: tuple[object, ...] = (0, 1)
    failed: int = 0
    spreads: dict[str, Spread] = field(
        default_factory=lambda: {"depth_um": Spread(180.25), "depth_error_um": Spread(0.75)}
    )
    by_model: dict[str, Spread] = field(default_factory=dict)
    estimated: dict[str, Spread] = field(default_factory=dict)
    truth: dict[str, Spread] = field(
        default_factory=lambda: {"depth_um": Spread(179.5), "wear_um": Spread(70.0)}
    )
    coverage: dict[str, float] = field(default_factory=lambda: {"depth": 1.0, "wear": 0.5})


def test_truth_and_measurement_have_rows_of_their_own() -> None:
    rows = {line.split(",")[0]: line for line in render_cases([Case()]).splitlines()}
    assert "179.50" in rows["true depth"]
    assert "70.00" in rows["true wear"]
    assert "180.25" in rows["depth"]


def test_what_was_not_touched_has_rows_of_its_own() -> None:
    case = Case(spreads={}, estimated={"depth_um": Spread(180.0, 0.0)}, by_model={"wear_um": Spread(71.5)})
    rows = {line.split(",")[0]: line for line in render_cases([case]).splitlines()}
    assert "180.00   0.00" in rows["depth estimated"]
    assert "71.50" in rows["tool wear by model"]
    assert not {"depth", "tool wear"} & set(rows)


def test_an_overview_leads_with_the_truth() -> None:
    overview = render_cases([Case("a"), Case("b", spreads={}, truth={}, failed=2)])
    header, *lines = overview.splitlines()
    assert header.index("true depth") < header.index("depth error")
    assert "179.50 ± 0.50" in next(line for line in lines if line.startswith("a"))
    assert "2 of 2" in next(line for line in lines if line.startswith("b"))
