"""Runs side by side, where there is room for them."""

from __future__ import annotations

from edmctl.console.compare_table import render_comparison
from edmctl.console.style import Style
from edmctl.results.comparison import Amount, ComparedRun, Comparison, Quantity, Setting


def made_comparison(number: int, value: str = "0.8") -> Comparison:
    """So many runs, which differ in one setting, with a depth each."""
    runs = tuple(
        ComparedRun(f"runs/of-a-long-name-{i}.h5", f"{i}", "", "2026-01-02T03:04:05", "done", True, i, 1)
        for i in range(number)
    )
    amount = Amount(180.25, 0.61, 0.12, 0.86, beyond=False)
    settings = (Setting("servo.reference", "", tuple(f"{value}{i}" for i in range(number))),)
    return Comparison(runs, settings, (Quantity("depth_um", "depth, µm", 2, 1.0, (amount,) * number),), ())


def widest(text: str) -> int:
    return max(len(line) for line in text.splitlines() if not line.startswith(("±", "*")))


def test_a_comparison_fits_the_terminal() -> None:
    for columns in (60, 80, 100, 160):
        style = Style(colour=False, live=False, columns=columns)
        for number in (2, 3, 4, 5):
            assert widest(render_comparison(made_comparison(number), style)) <= columns


def test_runs_that_do_not_fit_beside_each_other_stand_below_each_other() -> None:
    beside, below = (
        render_comparison(made_comparison(4), Style(colour=False, live=False, columns=columns))
        for columns in (None, 80)
    )
    assert "D − A" in beside
    assert "D − A" not in below
    assert sum(line.startswith("D ") for line in below.splitlines()) == 2


def test_a_long_value_is_cut_to_the_room_that_there_is() -> None:
    comparison = made_comparison(2, "a-value-of-many-letters-")
    whole = render_comparison(comparison)
    narrow = render_comparison(comparison, Style(colour=False, live=False, columns=60))
    assert "a-value-of-many-letters-0" in whole
    assert "a-value-of-many-le…" in narrow
