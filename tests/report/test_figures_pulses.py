"""Figures of pulses: what is counted, and that each says what it shows."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("matplotlib")

from pathlib import Path

from edmctl.record.reader import JUMP_DONE, RecordedState, open_run
from edmctl.record.rows import EventLevel, EventRow, RunEvent
from edmctl.report.figures.pulses import since_the_last
from edmctl.report.pulse_statistics import delays, pulse_counts, random_ignition, rows_at, spark_energies
from edmctl.report.removal import cumulated, in_this_run, kappa, removal
from edmctl.report.signals import broken, cuts_s, running_mean
from edmctl.results.telemetry import WaveformBatch
from tests.report import made_up
from tests.report.drawing import data, drawn, overlaps, texts, why_not, width_mm
from tests.tiers import tiers


@pytest.fixture
def random_pulses(tmp_path: Path) -> Path:
    """Return a run of one cut with 40 000 pulses that ignite at random, 60 µs after 2 µs on average."""
    writer = made_up.new_run(tmp_path)
    made_up.cut(writer, 100.0)
    rng = np.random.default_rng(5)
    delay_us = np.minimum(2.0 + rng.exponential(60.0, 40_000), made_up.ON_TIME_US)
    made_up.pulses(writer, 100.0, np.where(delay_us < made_up.ON_TIME_US, 1, 0), delay_us)
    made_up.measured(writer, 125.0, 20.0)
    return writer.finish("done", 0)


def test_pulses_are_counted_in_the_interval_of_their_time_and_blocks_in_that_of_their_first(
    tmp_path: Path,
) -> None:
    writer = made_up.new_run(tmp_path)
    kinds = np.array([0, 1, 1, 2, 3, 1])
    made_up.pulses(writer, 10.0, kinds, np.zeros(6))
    made_up.pulses(writer, 20.0, kinds[:4], np.zeros(4))
    with open_run(writer.finish("done", 0)) as run:
        # The third pulse of the first train is the first that is not before 10.001 s.
        edges_s = np.array([9.0, 10.001, 15.0, 20.0, 21.0])
        assert rows_at(run, edges_s).tolist() == [0, 2, 6, 6, 10]
        counts = pulse_counts(run, edges_s)
    assert counts.tolist() == [[1, 1, 0, 0], [0, 2, 1, 1], [0, 0, 0, 0], [1, 2, 1, 0]]
    writer = made_up.new_run(tmp_path, name="blocks.h5")
    made_up.blocks(writer, 10.0, (3, 15, 1, 1), 3200.0, 100)
    with open_run(writer.finish("done", 0)) as run:
        counts = pulse_counts(run, np.array([0.0, 10.5, 10.995, 20.0]))
    assert counts.tolist() == [[150, 750, 50, 50], [150, 750, 50, 50], [0, 0, 0, 0]]


def test_shares_are_those_while_cutting(tmp_path: Path) -> None:
    writer = made_up.new_run(tmp_path)
    made_up.blocks(writer, 0.0, (20, 0, 0, 0), 0.0, 5000)
    made_up.blocks(writer, 100.0, (5, 13, 1, 1), 3000.0, 2500)
    made_up.cut(writer, 100.0)
    told = texts("pulses", writer.finish("done", 0))
    # All with as many decimals, so that they can be compared.
    assert {"25.00 %", "65.00 %", "5.00 %", "(a)", "(b)", "(c)", "normal", "open", "arc", "short"} <= told
    assert {"pulses (%)", "shorts (%)", "time (s)"} <= told


def test_without_pulses_it_is_told_what_would_change_that(tmp_path: Path) -> None:
    writer = made_up.new_run(tmp_path)
    made_up.cut(writer, 0.0)
    path = writer.finish("done", 0)
    for kind in ("pulses", "energy", "laue"):
        assert "log.pulses" in why_not(kind, path)


def test_random_ignition_is_found_with_its_lag_and_mean_and_the_figure_says_it(random_pulses: Path) -> None:
    with open_run(random_pulses) as run:
        found = delays(run, np.array([[99.0, 200.0]]))
    fit = random_ignition(found)
    assert fit is not None
    assert fit.lag_us == pytest.approx(2.0, abs=0.2)
    assert abs(fit.mean_us - 60.0) < 1.5 * fit.mean_u95_us + 0.2
    assert fit.mean_u95_us == pytest.approx(1.96 * 60.0 / np.sqrt(fit.ignited), rel=0.05)
    assert found.ignited.sum() + found.censored.sum() == 40_000
    # Survivors at 62 µs: one e-th. Open pulses and not the ignited alone make the mean.
    assert found.surviving[620] == pytest.approx(np.exp(-1.0), abs=0.02)
    among_ignited_us = 0.1 * (found.ignited * np.arange(len(found.ignited))).sum() / found.ignited.sum()
    assert among_ignited_us < 50.0
    told = texts("laue", random_pulses)
    assert any(text.startswith("random ignition: mean ") and text.endswith(" µs") for text in told)
    assert any("ignited, " in text and text.endswith(" open") for text in told)
    assert {"ignition delay (µs)", "share not yet ignited"} <= told


def test_pulses_between_the_cuts_have_no_part_in_the_delays(tmp_path: Path) -> None:
    writer = made_up.new_run(tmp_path)
    for start_s in (0.0, 100.0):
        made_up.cut(writer, start_s)
    for start_s, delay_us in ((5.0, 60.0), (50.0, 140.0), (105.0, 60.0)):
        made_up.pulses(writer, start_s, np.ones(400, np.int64), np.full(400, delay_us))
    with open_run(writer.finish("done", 0)) as run:
        found = delays(run, cuts_s(run))
    assert found.ignited.sum() == 800
    assert np.flatnonzero(found.ignited).tolist() == [600]


@pytest.mark.parametrize(
    ("kinds", "delay_us", "arc_v", "edges_s", "sums_uj"),
    [
        # 20 V × 0.1 A × 100, 50 and 150 µs; the open pulse and the short have none.
        ([0, 1, 1, 2, 3], [150, 50, 100, 0, 0], 20.0, [0.0, 10.0, 10.001, 11.0], [0.0, 200.0, 400.0]),
        # (40 V − 20 V) / 0.1 A is 200 Ω, so an arc at 15 V has 0.125 A all through 150 µs.
        ([1, 2], [50, 0], 15.0, [10.0, 10.0004, 11.0], [200.0, 15.0 * 0.125 * 150.0]),
    ],
)
def test_energies_of_single_pulses_are_plateau_times_current_times_time(
    tmp_path: Path,
    kinds: list[int],
    delay_us: list[float],
    arc_v: float,
    edges_s: list[float],
    sums_uj: list[float],
) -> None:
    writer = made_up.new_run(tmp_path)
    made_up.pulses(writer, 10.0, np.array(kinds), np.array(delay_us, np.float64), arc_v=arc_v)
    with open_run(writer.finish("done", 0)) as run:
        found = spark_energies(run, np.array(edges_s))
    assert found is not None
    assert found.is_single
    assert found.sums_uj == pytest.approx(sums_uj, rel=1e-5)
    assert (found.normal.sum(), found.arc.sum()) == (kinds.count(1), 1)
    (used,) = np.flatnonzero(found.arc)
    arc_uj = 150.0 * arc_v * (40.0 - arc_v) / 200.0
    assert found.edges_uj[used] <= arc_uj <= found.edges_uj[used + 1]


def test_blocks_stand_at_their_mean_with_all_their_discharges(tmp_path: Path) -> None:
    writer = made_up.new_run(tmp_path)
    made_up.blocks(writer, 10.0, (4, 14, 2, 0), 1600.0, 10)
    with open_run(writer.finish("done", 0)) as run:
        found = spark_energies(run, np.array([10.0, 10.05, 11.0]))
    assert found is not None
    assert found.sums_uj == pytest.approx([8000.0, 8000.0])
    assert found.normal.sum() == 160
    (used,) = np.flatnonzero(found.normal)
    assert found.edges_uj[used] <= 100.0 <= found.edges_uj[used + 1]


def test_kappa_is_the_volume_of_touched_holes_over_their_energy(tmp_path: Path) -> None:
    writer = made_up.new_run(tmp_path)
    made_up.cut(writer, 0.0, 0.0, 15.0)
    made_up.measured(writer, 25.0, 15.0)
    made_up.cut(writer, 40.0, 15.0, 20.0)
    made_up.measured(writer, 65.0, 20.0)
    made_up.cut(writer, 80.0, 0.0, 22.0)
    made_up.measured(writer, 101.0, 22.0, RunEvent.SITE_ESTIMATED)
    with open_run(writer.finish("done", 0)) as run:
        found = removal(run)
    section_um2 = np.pi / 4.0 * 110.0**2
    assert found.hole.tolist() == [0, 0, 1]
    assert found.touched.tolist() == [True, True, False]
    volume_um3, u95_um3 = cumulated(found)
    assert volume_um3 == pytest.approx(section_um2 * np.array([15.0, 20.0, 42.0]))
    assert u95_um3 == pytest.approx(section_um2 * 0.4 * np.array([1.0, 1.0, np.sqrt(2.0)]))
    fit = kappa(found, np.array([3e6, 4e6, 5e6]))
    assert fit is not None
    assert fit.holes == 1
    assert fit.value == pytest.approx(20.0 * section_um2 / 4e6)
    assert fit.u95 == pytest.approx(0.4 * section_um2 / 4e6)


def test_kappa_of_a_resumed_run_is_of_what_it_removed_itself(tmp_path: Path) -> None:
    """What an earlier run of the job had cut was touched before any spark of this one."""
    writer = made_up.new_run(tmp_path)
    made_up.measured(writer, 5.0, 12.0)
    made_up.cut(writer, 40.0, 12.0, 20.0)
    made_up.measured(writer, 65.0, 20.0)
    with open_run(writer.finish("done", 0)) as run:
        found = in_this_run(removal(run), np.array([0.0, 2e6]))
    section_um2 = np.pi / 4.0 * 110.0**2
    assert found.time_s.tolist() == [65.0]
    fit = kappa(found, np.array([2e6]))
    assert fit is not None
    assert fit.value == pytest.approx(8.0 * section_um2 / 2e6)
    assert fit.u95 == pytest.approx(0.4 * np.sqrt(2.0) * section_um2 / 2e6)


@pytest.mark.parametrize("kind", tiers("blocks", slow=("full",)))
def test_kappa_of_a_virtual_run_is_that_of_its_process(request: pytest.FixtureRequest, kind: str) -> None:
    path: Path = request.getfixturevalue("run_file" if kind == "blocks" else "full_run_file")
    told = texts("energy", path)
    (label,) = [text for text in told if text.startswith("κ = ")]
    # 0.0424 µm³/µJ, of which the discharges at the wall and arcs take their share.
    assert 0.034 < float(label.split()[2]) < 0.0435
    assert "removed volume" in told
    of = ", mean of a block" if kind == "blocks" else ""
    assert f"energy per discharge{of} (µJ)" in told
    assert any(text.startswith("κ by ") and text.endswith("± of depth alone") for text in told)
    value, _, u95 = label.split()[2:5]
    assert len(value.partition(".")[2]) == len(u95.partition(".")[2])


def test_every_jump_is_counted_and_its_period_shown(run_file: Path, tmp_path: Path) -> None:
    told = texts("jumps", run_file)
    assert any(text.endswith(" jumps") for text in told)
    assert {"arcs", "shorts", "jump", "jump period (s)"} <= told
    writer = made_up.new_run(tmp_path)
    made_up.cut(writer, 0.0)
    writer.append(a_jump(5.0))
    told = texts("jumps", writer.finish("done", 0))
    assert "1 jump" in told
    assert "time since the jump before" not in told


def a_jump(time_s: float) -> EventRow:
    return EventRow(time_s, JUMP_DONE, EventLevel.DEBUG, "JUMP_DONE", {})


@pytest.mark.parametrize(("after_s", "scale"), [(5.0, "linear"), (0.2, "log")])
def test_a_narrow_range_of_jump_periods_has_an_even_scale_and_a_wide_one_powers(
    tmp_path: Path, after_s: float, scale: str
) -> None:
    writer = made_up.new_run(tmp_path)
    made_up.cut(writer, 0.0)
    for time_s in (5.0, 5.0 + after_s):
        writer.append(a_jump(time_s))
    periods = drawn("jumps", writer.finish("done", 0)).axes[1]
    low_s, high_s = periods.get_ylim()
    assert sum(low_s <= tick <= high_s for tick in periods.get_yticks()) >= 3
    assert periods.get_yscale() == scale


def test_the_first_jump_of_a_cut_has_no_jump_before_it() -> None:
    cuts = np.array([[0.0, 20.0], [100.0, 120.0]])
    since_s = since_the_last(np.array([4.0, 9.0, 105.0, 106.5]), cuts)
    assert since_s == pytest.approx([np.nan, 5.0, np.nan, 1.5], nan_ok=True)


@pytest.mark.slow
def test_pulses_of_a_cut_are_those_that_its_results_count(full_run_file: Path) -> None:
    with open_run(full_run_file) as run:
        (row,) = run.table("/entry/results")
    whole = f"{row['pulses']:,}".replace(",", " ")
    assert f"{whole} pulses while cutting" in texts("pulses", full_run_file)


def test_classes_are_told_apart_without_colours(tmp_path: Path) -> None:
    writer = made_up.new_run(tmp_path)
    made_up.blocks(writer, 0.0, (5, 13, 1, 1), 3000.0, 1000)
    made_up.cut(writer, 0.0)
    shares, rare, totals = drawn("pulses", writer.finish("done", 0)).axes
    hatches = [{patch.get_hatch() for patch in axes.patches} for axes in (shares, totals)]
    assert [len(found) for found in hatches] == [4, 4]
    assert len({str(patch.get_linestyle()) for patch in rare.patches}) == 2


def test_a_run_that_does_not_jump_says_why(tmp_path: Path) -> None:
    for mode, why in (("off", "jump.mode"), ("fixed", "before the first")):
        writer = made_up.new_run(tmp_path, {"jump": {"mode": mode}}, f"{mode}.h5")
        made_up.cut(writer, 0.0)
        assert why in why_not("jumps", writer.finish("done", 0))


def test_a_line_is_broken_between_cuts_and_keeps_its_extremes(tmp_path: Path) -> None:
    writer = made_up.new_run(tmp_path)
    made_up.cut(writer, 0.0)
    made_up.cut(writer, 100.0)
    with open_run(writer.finish("done", 0)) as run:
        cuts = cuts_s(run)
    assert cuts == pytest.approx(np.array([[0.0, 19.9], [99.9, 119.9]]))
    time_s = np.concatenate([np.arange(5000), np.arange(9000, 14000)]) * 0.1
    values = np.sin(time_s)
    values[[77, 8000]] = 5.0, -7.0
    line = broken(time_s, values, points=500)
    assert len(line.time_s) < 600
    assert np.isnan(line.low).sum() == 2
    assert np.nanmax(line.high) == 5.0
    assert np.nanmin(line.low) == -7.0


def test_a_running_mean_is_that_of_the_last_seconds() -> None:
    time_s = 0.1 * np.arange(1000.0)
    mean = running_mean(time_s, np.where(time_s < 50.0, 0.0, np.where(time_s < 60.0, 1.0, np.nan)))
    assert mean[400] == 0.0
    assert mean[549] == pytest.approx(0.5, abs=0.02)
    assert mean[599] == pytest.approx(1.0, abs=0.02)
    assert np.isnan(mean[-1])


def write_waveforms(folder: Path, *, fault: bool, begin_s: float = 0.0, end_s: float = 0.04) -> Path:
    time_s = np.arange(begin_s, end_s, 1e-6)
    on = (time_s % 5e-4) < 1.5e-4
    rows: list[Any] = [WaveformBatch(100.0 + time_s, np.where(on, 22.0, 0.0), np.where(on, 0.12, 0.0))]
    if fault:
        state = np.array([RecordedState.MACHINING, RecordedState.FAULT], np.uint8)
        signals = replace(made_up.a_cut(0.02), state=state)
        rows.append(replace(signals.block(), time_s=np.array([100.0, 100.032])))
    return made_up.finished(folder, *rows)


@pytest.mark.parametrize(
    ("begin_s", "end_s", "whole_ms", "detail_ms"),
    [
        (0.0, 0.04, (-32.0, 8.0), (-4.0, 1.0)),  # 8 periods before, 2 after
        (0.031, 0.03225, (-1.0, 0.25), (-1.0, 0.25)),  # a short memory
    ],
)
def test_waveforms_are_counted_from_the_fault(
    tmp_path: Path,
    begin_s: float,
    end_s: float,
    whole_ms: tuple[float, float],
    detail_ms: tuple[float, float],
) -> None:
    path = write_waveforms(tmp_path, fault=True, begin_s=begin_s, end_s=end_s)
    figure = drawn("waveforms", path)
    assert figure.axes[1].get_xlim() == pytest.approx(whole_ms, abs=0.05)
    assert figure.axes[3].get_xlim() == pytest.approx(detail_ms, abs=0.05)
    assert {"fault", "voltage (V)", "current (A)", "time after the fault (ms)"} <= texts("waveforms", path)
    assert not overlaps(figure)
    assert width_mm(figure) == pytest.approx(85.0, abs=0.2)


def test_the_pulses_of_a_real_short_end_at_the_fault_and_no_plateau_is_above_every_number(
    faulted_run_file: Path,
) -> None:
    figure = drawn("waveforms", faulted_run_file)
    for axes in figure.axes:
        ticks = axes.get_yticks()
        assert ticks[-1] >= max(data(line)[1].max() for line in axes.get_lines()[:1])
        low, high = axes.get_ylim()
        assert sum(low <= tick <= high for tick in ticks) >= 3
    time_ms, current_a = data(figure.axes[3].get_lines()[0])
    # 120 mA in a plain discharge, and more in a short
    assert current_a[time_ms < 0.0].max() > 0.1
    assert current_a[time_ms > 0.1].max() < 0.01
    assert not overlaps(figure)


def test_waveforms_without_a_known_fault_are_counted_from_their_end(tmp_path: Path) -> None:
    path = write_waveforms(tmp_path, fault=False)
    figure = drawn("waveforms", path)
    assert figure.axes[1].get_xlim()[1] == pytest.approx(0.0, abs=0.05)
    assert "fault" not in texts("waveforms", path)
