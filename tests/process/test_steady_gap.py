"""The gap as the servo keeps it: trends, balance, and limits."""

from __future__ import annotations

from dataclasses import replace

import pytest

from edmctl.process.erosion import GAP_LAW, crater_scale, deionisation_us, flush_time_s, side_gap_um
from edmctl.process.steady_gap import GapRecipe, SteadyGap, steady_gap

PAPER = GapRecipe(1e6 * 0.3 / 2300.0, 1e6 * 0.7 / 2300.0, 40.0, 0.12, 0.8, 270.0)


def gap(depth_um: float = 60.0, **changes: float | bool) -> SteadyGap:
    return steady_gap(replace(PAPER, **changes), depth_um)  # type: ignore[arg-type]


def best(key: str, values: list[float], depth_um: float = 60.0, **changes: float) -> float:
    """Which value of a key removes most."""
    return max(values, key=lambda value: gap(depth_um, **{key: value}, **changes).removal_um3_s)


LEVELS = [0.56 + 0.02 * n for n in range(20)]


def test_the_paper_has_its_gap_its_wear_and_few_arcs() -> None:
    found = gap(105.0)
    assert 3.0 < found.gap_um < 3.5
    assert found.wear_ratio == pytest.approx(0.345, rel=0.05)
    assert 0.01 < found.arc_share < 0.04
    assert found.short_share < 0.005


def test_removal_has_a_best_reference_that_bad_flushing_moves_up() -> None:
    clean, dirty = (best("level_s", LEVELS, flush_time_s=s) for s in (0.5, 2.0))
    assert 0.64 <= clean <= 0.75
    assert clean <= dirty <= clean + 0.10
    at_best = [gap(level_s=level, flush_time_s=s) for s, level in ((0.5, clean), (2.0, dirty))]
    assert at_best[1].gap_um > at_best[0].gap_um
    assert at_best[1].removal_um3_s < 0.8 * at_best[0].removal_um3_s


def test_removal_has_a_best_off_time_and_a_short_one_arcs() -> None:
    times_us = [5.0, 10.0, 20.0, 30.0, 50.0, 80.0, 150.0, 300.0]
    assert 10.0 <= best("off_time_us", times_us, on_time_us=60.0) <= 50.0
    shares = [gap(on_time_us=60.0, off_time_us=t).arc_share for t in times_us]
    assert shares == sorted(shares, reverse=True)


def test_jumps_and_flushing_clean_the_gap() -> None:
    assert gap(jump_clearing_hz=1.0).debris < gap().debris < gap(flush_time_s=2.0).debris
    assert gap(180.0).debris > gap(0.0).debris


def test_materials_and_polarity_count() -> None:
    assert gap(work_removal=0.8).removal_um3_s == pytest.approx(0.8 * gap().removal_um3_s, rel=0.1)
    assert gap(tool_wear=0.106).wear_ratio == pytest.approx(0.106 * gap().wear_ratio, rel=0.15)
    assert gap(tool_negative=False).wear_ratio > 2.0 * gap().wear_ratio


def test_a_level_that_cannot_be_is_the_nearest_that_can() -> None:
    assert gap(level_s=0.30).removal_um3_s > 0.0
    assert gap(level_s=1.0).removal_um3_s >= 0.0


def test_scales_are_those_of_the_paper_at_the_paper() -> None:
    assert crater_scale(PAPER.full_pulse_uj) == pytest.approx(1.0)
    assert deionisation_us(GAP_LAW, PAPER.full_pulse_uj) == pytest.approx(15.0)
    assert side_gap_um(GAP_LAW, 40.0, PAPER.full_pulse_uj) == pytest.approx(8.0)
    assert 15.0 < side_gap_um(GAP_LAW, 100.0, 22.0 * 1.0 * 300.0) < 25.0
    assert flush_time_s(GAP_LAW, 270.0, 297.0) == pytest.approx(1.0)
