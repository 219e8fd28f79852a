"""Figures of the servo's signals and of touches: what they show of a real run, a short one, one without a sensor."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

pytest.importorskip("matplotlib")

from pathlib import Path

from edmctl.record.reader import RecordedState, open_run
from edmctl.report.signals import envelopes, rows_worked, spans_in
from tests.record.samples import slow_row
from tests.report.drawing import data, drawn, legend_of, line_called, overlaps, texts, why_not, width_mm
from tests.report.made_up import IDLE, TOUCH, a_cut, a_touch, finished, sites
from tests.tiers import tiers

if TYPE_CHECKING:
    from matplotlib.figure import Figure

KINDS = ("gap", "displacement", "steps", "touching")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("which", tiers("array_run_file", slow=("run_file", "full_run_file")))
def test_real_runs_are_drawn_with_units_on_every_axis_and_no_text_on_another(
    kind: str, which: str, request: pytest.FixtureRequest
) -> None:
    figure = drawn(kind, request.getfixturevalue(which))
    assert all("(" in axes.get_ylabel() for axes in figure.axes if axes.get_ylabel())
    assert not overlaps(figure)
    wide = kind == "steps" and which == "array_run_file"
    assert width_mm(figure) == pytest.approx(180.0 if wide else 85.0, abs=0.2)


def test_the_gap_figure_shows_reference_jumps_and_readings(run_file: Path) -> None:
    figure = drawn("gap", run_file)
    assert {"mean", "range", "reference", "touching", "sensor", "jump", "Z1", "Z2", "Z3"} <= legend_of(figure)
    _, reference_v = line_called(figure, "reference")
    # 0.8 of 30 % of 40 V
    assert np.nanmin(reference_v) == pytest.approx(9.6, abs=0.02)
    assert np.nanmax(reference_v) == pytest.approx(9.6, abs=0.02)
    _, gap_v = line_called(figure, "mean")
    assert np.isnan(gap_v).any()  # no voltage is drawn where the generator is off
    # The swings of the conditioning would take all the room.
    assert figure.axes[1].get_ylim()[1] < 100.0


def test_a_reference_that_follows_the_duty_factor_is_in_volts(tmp_path: Path) -> None:
    rows = [replace(slow_row(k), gap_ratio_ref=0.8 if k < 100 else 0.9) for k in range(200)]
    time_s, reference_v = line_called(drawn("gap", finished(tmp_path, a_cut(20.0), *rows)), "reference")
    assert reference_v[time_s < 9.8] == pytest.approx(9.6, abs=0.01)
    assert reference_v[time_s > 10.2] == pytest.approx(10.8, abs=0.01)


def error_note(figure: Figure) -> str:
    (note,) = [text.get_text() for text in figure.axes[1].texts]
    return note


def test_feed_and_error_of_the_estimate_are_those_of_the_results(run_file: Path) -> None:
    with open_run(run_file) as run:
        (result,) = run.table("/entry/results")
    assert {f"{result['feed']:.1f}", f"± {result['feed_u95']:.1f} µm"} <= texts("steps", run_file)
    rms = f"rms {result['err_feed_rms']:.2f} µm ({result['err_feed_rms_pct']:.2g} %)"
    most = f"max {result['err_feed_max']:.2f} µm ({result['err_feed_max_pct']:.2g} % of feed)"
    figure = drawn("displacement", run_file)
    assert error_note(figure) == f"{rms}\n{most}"
    texts("displacement", run_file)  # the second axis follows the first when it is drawn
    (percent,) = figure.axes[1].child_axes
    scale = np.diff(percent.get_ylim())[0] / np.diff(figure.axes[1].get_ylim())[0]
    assert scale == pytest.approx(100.0 / result["feed"])


def test_several_holes_have_the_largest_error_and_no_common_percentage_and_none_no_number(
    tmp_path: Path,
) -> None:
    holes = [
        replace(one, feed_model_error_max_um=1.0 + k, feed_model_error_rms_um=0.5, feed_model_error_max_pct=2.0 * k)
        for k, one in enumerate(sites(3))
    ]  # fmt: skip
    figure = drawn("displacement", finished(tmp_path, a_cut(20.0), *holes))
    assert error_note(figure).startswith("largest of 3 holes: rms 0.50 µm")
    assert error_note(figure).endswith("max 3.00 µm (4 % of feed)")
    assert not figure.axes[1].child_axes
    axes = drawn("displacement", finished(tmp_path, a_cut(20.0), name="none.h5")).axes[1]
    assert not axes.texts
    assert not axes.child_axes


def test_the_retreat_from_a_short_is_no_machining(tmp_path: Path) -> None:
    signals = a_cut(20.0)
    signals.gap_v[1000:1100] = 0.3
    signals.model_um[1000:1100] += 30.0
    figure = drawn("displacement", finished(tmp_path, signals))
    time_s, error_um = line_called(figure, "machining, mean")
    assert np.isnan(error_um[(time_s > 10.02) & (time_s < 10.98)]).all()
    assert np.nanmax(error_um) < 3.0


def test_a_run_without_a_sensor_is_drawn_by_its_estimate_and_one_without_an_estimate_says_so(
    tmp_path: Path,
) -> None:
    signals = a_cut(20.0)
    unknown = np.full(len(signals.state), np.nan)
    blind = finished(tmp_path, replace(signals, sensor_um=unknown), name="blind.h5")
    assert "estimated" in legend_of(drawn("gap", blind))
    assert "no displacement sensor" in why_not("displacement", blind)
    bare = finished(tmp_path, replace(signals, model_um=unknown), name="bare.h5")
    assert "conditioned or calibrated" in why_not("displacement", bare)


@pytest.mark.parametrize("kind", [*KINDS, "waveforms"])
def test_an_empty_run_has_nothing_to_draw_and_says_why(kind: str, tmp_path: Path) -> None:
    assert why_not(kind, finished(tmp_path)).endswith(".")


def test_a_second_of_data_is_enough(tmp_path: Path) -> None:
    path = finished(tmp_path, a_cut(1.0))
    time_s, gap_v = line_called(drawn("gap", path), "gap voltage")
    assert len(time_s) == 100
    assert gap_v == pytest.approx(a_cut(1.0).gap_v, abs=1e-5)
    drawn("displacement", path)


@pytest.mark.slow
def test_a_run_that_ended_in_a_fault_is_drawn_up_to_it(faulted_run_file: Path) -> None:
    with open_run(faulted_run_file) as run:
        last = run.table("/entry/events")["message"][-1].decode()
    told = re.search(r"at ([\d.]+) s\)$", last)
    assert told is not None, last
    assert drawn("gap", faulted_run_file).axes[1].get_xlim()[1] == pytest.approx(float(told[1]), abs=0.2)
    assert "No site of this run was measured" in why_not("steps", faulted_run_file)
    assert "Touches of Z1: cu270-cu" in texts("touching", faulted_run_file)


@pytest.mark.parametrize("count", tiers(1, 4, slow=(3, 12, 13), full=(60,)))
def test_steps_stay_readable_however_many_sites_there_are(count: int, tmp_path: Path) -> None:
    path = finished(tmp_path, *sites(count))
    figure = drawn("steps", path)
    assert width_mm(figure) == pytest.approx(85.0 if count <= 3 else 180.0, abs=0.2)
    assert not overlaps(figure)
    numbers = [text for text in figure.findobj(match=lambda one: "180.0" in getattr(one, "get_text", str)())]
    assert len(numbers) == (count if count <= 12 else 0)


def test_steps_are_the_readings_and_the_estimate_begins_at_its_own_reading(tmp_path: Path) -> None:
    (axes,) = drawn("steps", finished(tmp_path, *sites(1), a_touch("Z1"))).axes
    levels_um = [data(line)[1][0] for line in axes.get_lines() if line.get_linewidth() == 1.2]
    assert levels_um == [50.0, 300.0, 120.0]
    # The row's estimate: 178 µm deep, 69 µm of wear.
    (estimates,) = axes.collections
    levels_um = [line[0, 1] for line in estimates.get_segments()]  # type: ignore[attr-defined]
    assert levels_um == pytest.approx([48.0, 48.0 + 69.0 + 178.0, 48.0 + 69.0])


def test_touching_marks_the_contacts_of_the_last_bottom_below_all_readings(run_file: Path) -> None:
    with open_run(run_file) as run:
        events, readings = run.table("/entry/events"), run.table("/entry/touches")
    bottom_s = readings["time"][readings["kind"] == b"Z2"][-1]
    before_s = readings["time"][readings["time"] < bottom_s][-1]
    contacts_s = [t for t in events["time"][events["code"] == 6] if before_s + 1e-3 < t <= bottom_s + 1e-3]
    figure = drawn("touching", run_file)
    upper, lower, zoom = figure.axes[:3]
    upright = [data(line)[0] for line in zoom.get_lines()]
    marked_s = [time_s[0] for time_s in upright if time_s[0] == time_s[-1]]
    assert marked_s == pytest.approx(contacts_s)
    assert len(marked_s) == 3
    # The way back to rest is not shown: it would flatten everything else.
    low_v, high_v = zoom.get_ylim()
    assert high_v - low_v < 5.0
    for axes, column in ((upper, "v_cmd"), (lower, "z_sensor")):
        for row in readings[readings["accepted"] == 1]:
            (marks,) = [line for line in axes.get_lines() if line.get_label() == row["kind"].decode()]
            time_s, values = data(marks)
            assert row["time"] in time_s * (60.0 if "min" in lower.get_xlabel() else 1.0)
            assert values[-1] == readings[readings["kind"] == row["kind"]][column][-1]
    begin, end = lower.get_xlim()
    assert begin < readings["time"][0] < readings["time"][-1] < end


def test_a_single_high_sample_is_not_lost_in_a_long_run_whose_idle_begin_is_left_out(tmp_path: Path) -> None:
    signals = a_cut(100.0)
    signals.state[:500] = IDLE
    signals.state[500:1000] = TOUCH
    signals.gap_v[7777] = 39.0
    signals.sensor_um[:150] = np.nan

    with open_run(finished(tmp_path, signals)) as run:
        assert rows_worked(run) == (500, 10_000)
        assert spans_in(run, [RecordedState.TOUCH, RecordedState.IDLE]).tolist() == [[0, 1000]]
        names = ["v_gap_avg", "z_sensor"]
        lines = envelopes(
            run, "/entry/servo", names, lambda c: {n: c[n].astype(np.float32) for n in names}, points=100
        )
    gap, sensor = lines.values()
    assert len(gap.time_s) == 100
    assert np.nanmax(gap.high) == 39.0
    assert gap.mean == pytest.approx(a_cut(100.0).gap_v.reshape(100, 100).mean(axis=1), abs=0.4)
    # An interval of nothing but NaN is NaN.
    assert np.isnan([sensor.mean[0], sensor.low[0]]).all()
    assert sensor.mean[1] == pytest.approx(signals.sensor_um[150:200].mean(), abs=1e-3)
