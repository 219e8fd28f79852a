"""Sparklines and bars: what is drawn is what was."""

from __future__ import annotations

import math
import random

import pytest

from edmctl.cli.render.charts import SPAN_S, History, chart, count_bar, depth_bar, pulse_bar
from edmctl.results.telemetry import PulseShares


def lines_of(
    history: History, now_s: float, *, unicode: bool = True, rows: int = 2, mark: float = math.nan
) -> list[str]:
    drawn = chart(history, now_s, 30, rows, (0.0, 10.0), mark, unicode=unicode)
    return ["".join(text for text, _ in line) for line in drawn]


def steady(seconds: float = SPAN_S) -> History:
    history = History()
    for i in range(round(10 * seconds)):
        history.update(0.1 * i, 5.0, 5.0)
    return history


@pytest.mark.parametrize("unicode", [True, False])
def test_one_short_peak_in_a_minute_is_seen(unicode: bool) -> None:
    flat, peaked = steady(), steady()
    peaked.update(SPAN_S, 5.0, 10.0)
    before = lines_of(flat, SPAN_S, unicode=unicode)[0]
    assert before != lines_of(peaked, SPAN_S, unicode=unicode)[0]


def test_low_and_high_of_every_column_are_those_of_its_samples() -> None:
    rng = random.Random(7)
    samples = [(0.1 * i, rng.uniform(0, 5), rng.uniform(5, 10)) for i in range(590)]
    history = History()
    for row in samples:
        history.update(*row)
    step_s = SPAN_S / 24
    for i, found in enumerate(history.columns(24, 58.9)):
        index = math.floor(58.9 / step_s) - 23 + i
        inside = [row for row in samples if int(row[0] / step_s) == index]
        expected = (min(r[1] for r in inside), max(r[2] for r in inside)) if inside else None
        assert found == expected


def test_a_minute_is_kept_and_no_more() -> None:
    history = History()
    history.update(0.0, 1.0, 99.0)
    history.update(61.0, 4.0, 6.0)
    assert (history.low, history.high) == (4.0, 6.0)


def test_unknown_values_and_a_new_clock() -> None:
    history = History()
    history.update(5.0, math.nan, math.nan)
    assert math.isnan(history.low)
    history.update(6.0, 1.0, 2.0)
    history.update(0.5, 7.0, 8.0)
    assert (history.low, history.high) == (7.0, 8.0)


def test_the_reference_is_a_line_where_nothing_else_is() -> None:
    history = History()
    history.update(59.9, 9.0, 9.0)
    assert set(lines_of(history, 59.9, mark=0.0)[1]) == {"⣀"}
    assert set(lines_of(history, 59.9, mark=0.0, unicode=False)[1]) == {"-"}


def test_values_off_the_scale_stay_in_the_chart() -> None:
    history = History()
    history.update(1.0, -500.0, 500.0)
    assert all(len(line) == 30 for line in lines_of(history, 1.0))


@pytest.mark.parametrize(
    ("done_um", "u95_um", "bar"),
    [
        (0.0, math.nan, "-" * 26 + "|-"),
        (50.0, math.nan, "#" * 13 + "-" * 13 + "|-"),
        (50.0, 8.0, "#" * 10 + "~" * 6 + "-" * 10 + "|-"),
        (100.0, 1.0, "#" * 25 + "~|-"),
        (500.0, 1.0, "#" * 26 + "|#"),
    ],
)
def test_the_depth_bar_shows_what_is_sure_the_band_and_the_target(
    done_um: float, u95_um: float, bar: str
) -> None:
    drawn = "".join(text for text, _ in depth_bar(done_um, u95_um, 100.0, 28, unicode=False))
    assert drawn == bar


def test_the_band_is_a_cell_at_least() -> None:
    drawn = "".join(text for text, _ in depth_bar(50.0, 0.01, 100.0, 28, unicode=False))
    assert drawn.count("~") == 1


def test_a_depth_without_a_target_fills_nothing() -> None:
    assert depth_bar(50.0, 1.0, math.nan, 10)[0][0] == "─" * 10


def test_a_count_fills_the_bar_when_all_are_done() -> None:
    bars = ["".join(text for text, _ in count_bar(done, 4, 8, unicode=False)) for done in (0, 1, 4)]
    assert bars == ["--------", "##------", "########"]


def test_pulse_classes_share_the_bar() -> None:
    drawn = "".join(text for text, _ in pulse_bar(PulseShares(0.5, 0.3, 0.1, 0.1), 20, unicode=False))
    assert drawn == "." * 10 + "#" * 6 + "aa" + "SS"


def test_without_colour_the_classes_differ_in_pattern() -> None:
    drawn = "".join(text for text, _ in pulse_bar(PulseShares(0.4, 0.4, 0.1, 0.1), 10, colour=False))
    assert len(set(drawn)) == 4
