"""Figures of signals over time: what they show of a real run, of a short one, and of one without a sensor."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from functools import cache
from importlib import import_module
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
import pytest

pytest.importorskip("matplotlib")

from edmctl.record.events import RecordedState
from edmctl.record.reader import open_run
from edmctl.record.rows import SlowRow, TouchRow
from edmctl.record.run_meta import profile_leaves
from edmctl.report.figures.spectrum import segment_size, welch
from edmctl.report.kinds import KINDS as KINDS_OF_FIGURES
from edmctl.report.kinds import draw, kind_called
from edmctl.report.signals import Spans, envelopes, rows_worked
from edmctl.report.style import NothingToDraw, house_style, new_figure, rendered, time_unit
from edmctl.results.telemetry import WaveformBatch
from tests.report.servo_signals import IDLE, JUMP, MACHINING, TOUCH, a_cut, sites, write_run
from tests.tiers import tiers

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.text import Text
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

KINDS = ("gap", "displacement", "steps", "touching", "spectrum")


@cache
def drawn(kind: str, path: Path) -> Figure:
    """The figure, made in the house's style, once."""
    with open_run(path) as run, house_style():
        figure: Figure = import_module(f"edmctl.report.figures.{kind}").draw(run)
        return figure


def texts(figure: Figure) -> list[str]:
    with house_style():
        svg = rendered(figure, ".svg")
    return [(e.text or "").strip() for e in ET.fromstring(svg).iter("{http://www.w3.org/2000/svg}text")]


def width_mm(figure: Figure) -> float:
    return 25.4 * float(figure.get_figwidth())


def legend_of(figure: Figure) -> set[str]:
    legends = [*(axes.get_legend() for axes in figure.axes), *figure.legends]
    return {text.get_text() for legend in legends if legend is not None for text in legend.get_texts()}


def line_called(figure: Figure, label: str) -> tuple[Array, Array]:
    (found,) = [line for axes in figure.axes for line in axes.get_lines() if line.get_label() == label]
    return data(found)


def data(line: Line2D) -> tuple[Array, Array]:
    return np.asarray(line.get_xdata(), np.float64), np.asarray(line.get_ydata(), np.float64)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("which", tiers("array_run_file", slow=("run_file", "full_run_file")))
def test_real_runs_are_drawn_with_units_on_every_axis_and_no_text_on_another(
    kind: str, which: str, request: pytest.FixtureRequest
) -> None:
    figure = drawn(kind, request.getfixturevalue(which))
    for axes in figure.axes:
        if axes.get_ylabel():
            assert "(" in axes.get_ylabel()
    assert not overlaps(figure)
    wide = kind == "steps" and which == "array_run_file"
    assert width_mm(figure) == pytest.approx(180.0 if wide else 85.0, abs=0.2)


def overlaps(figure: Figure) -> list[tuple[str, str]]:
    """Pairs of texts of a figure whose boxes lie on each other. Fails where one is cut off."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.text import Text

    with house_style():
        canvas = FigureCanvasAgg(figure)
        canvas.draw()  # type: ignore[no-untyped-call]
        renderer = canvas.get_renderer()  # type: ignore[no-untyped-call]
        hidden = {id(label) for axes in figure.axes for label in labels_out_of_sight(axes)}
        boxes = [
            (text.get_text(), text.get_window_extent(renderer))
            for text in figure.findobj(Text)
            if text.get_visible() and text.get_text().strip() and id(text) not in hidden
        ]
    for text, box in boxes:
        assert figure.bbox.x0 - 1.0 < box.x0 < box.x1 < figure.bbox.x1 + 1.0, f"{text!r} is cut off"
    shrunk = [(text, box.shrunk(0.98, 0.9)) for text, box in boxes]
    return [(one, other) for (one, box), (other, its) in combinations(shrunk, 2) if box.overlaps(its)]


def labels_out_of_sight(axes: Axes) -> list[Text]:
    """Labels of ticks that lie outside their axis."""
    found = []
    for axis in (axes.xaxis, axes.yaxis):
        low, high = sorted(axis.get_view_interval())
        ticks = (*axis.get_major_ticks(), *axis.get_minor_ticks())
        away = [tick for tick in ticks if not low <= tick.get_loc() <= high]
        found += [label for tick in away for label in (tick.label1, tick.label2)]
    return found


@pytest.mark.slow
def test_every_figure_of_a_simulated_run_says_so_with_its_seed(run_file: Path) -> None:
    said = []
    with open_run(run_file) as run, house_style():
        for kind in KINDS_OF_FIGURES:
            try:
                figure = draw(kind, run)
            except NothingToDraw:
                continue
            said.append("simulated, seed 3" in [text.get_text() for text in figure.texts])
            assert not overlaps(figure), kind.name
    assert len(said) >= 9
    assert all(said)


def test_every_panel_is_named_in_the_caption(run_file: Path) -> None:
    with open_run(run_file) as run, house_style():
        for name in ("gap", "displacement", "pulses", "erosion", "jumps", "energy", "spectrum"):
            kind = kind_called(name)
            panels = [axes for axes in draw(kind, run).axes if axes.get_title(loc="left").startswith("(")]
            assert len(panels) >= 2
            for axes in panels:
                assert axes.get_title(loc="left") in kind.sees


def test_texts_on_each_other_are_found() -> None:
    with house_style():
        figure = new_figure(50.0)
        axes = figure.subplots()
        axes.text(0.5, 0.5, "one")
        axes.text(0.52, 0.5, "another")
    assert overlaps(figure) == [("one", "another")]


@pytest.mark.parametrize("kind", tiers("steps", slow=[kind for kind in KINDS if kind != "steps"]))
def test_vector_files_are_made_too(kind: str, run_file: Path) -> None:
    with house_style():
        for suffix, magic in ((".svg", b"<?xml"), (".pdf", b"%PDF")):
            assert rendered(drawn(kind, run_file), suffix).startswith(magic)


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
    signals = a_cut(20.0)
    writer = write_run(tmp_path / "a.h5", signals)
    for k in range(200):
        writer.append(SlowRow(0.1 * k, 1.0, 0.8, 0.8 if k < 100 else 0.9, 0.2, 0.7, 0.1, 0.0, 0.0, 0.0, 0.1))
    figure = drawn("gap", writer.finish("done", 0))
    time_s, reference_v = line_called(figure, "reference")
    assert reference_v[time_s < 9.8] == pytest.approx(9.6, abs=0.01)
    assert reference_v[time_s > 10.2] == pytest.approx(10.8, abs=0.01)


def error_note(figure: Figure) -> str:
    (note,) = [text.get_text() for text in figure.axes[1].texts]
    return note


def test_steps_tell_the_feed_with_its_interval(run_file: Path) -> None:
    with open_run(run_file) as run:
        (result,) = run.table("/entry/results")
    told = texts(drawn("steps", run_file))
    assert f"± {result['feed_u95']:.1f} µm" in told
    assert f"{result['feed']:.1f}" in told


def test_the_error_of_the_estimate_is_that_of_the_results(run_file: Path) -> None:
    with open_run(run_file) as run:
        (result,) = run.table("/entry/results")
    rms = f"rms {result['err_feed_rms']:.2f} µm ({result['err_feed_rms_pct']:.2g} %)"
    most = f"max {result['err_feed_max']:.2f} µm ({result['err_feed_max_pct']:.2g} % of feed)"
    figure = drawn("displacement", run_file)
    assert error_note(figure) == f"{rms}\n{most}"
    texts(figure)  # the second axis follows the first when it is drawn
    (percent,) = figure.axes[1].child_axes
    scale = np.diff(percent.get_ylim())[0] / np.diff(figure.axes[1].get_ylim())[0]
    assert scale == pytest.approx(100.0 / result["feed"])


def test_several_holes_have_the_largest_error_and_no_common_percentage(tmp_path: Path) -> None:
    holes = [
        replace(
            one,
            feed_model_error_max_um=1.0 + k,
            feed_model_error_rms_um=0.5,
            feed_model_error_max_pct=2.0 * k,
        )
        for k, one in enumerate(sites(3))
    ]
    figure = drawn("displacement", write_run(tmp_path / "a.h5", a_cut(20.0), holes).finish("done", 0))
    assert error_note(figure).startswith("largest of 3 holes: rms 0.50 µm")
    assert error_note(figure).endswith("max 3.00 µm (4 % of feed)")
    assert not figure.axes[1].child_axes


def test_without_a_result_no_number_is_claimed_for_the_error(tmp_path: Path) -> None:
    axes = drawn("displacement", write_run(tmp_path / "a.h5", a_cut(20.0)).finish("done", 0)).axes[1]
    assert not axes.texts
    assert not axes.child_axes


def test_the_retreat_from_a_short_is_no_machining(tmp_path: Path) -> None:
    signals = a_cut(20.0)
    signals.gap_v[1000:1100] = 0.3
    signals.model_um[1000:1100] += 30.0
    figure = drawn("displacement", write_run(tmp_path / "a.h5", signals).finish("done", 0))
    time_s, error_um = line_called(figure, "machining, mean")
    assert np.isnan(error_um[(time_s > 10.02) & (time_s < 10.98)]).all()
    assert np.nanmax(error_um) < 3.0


def test_a_run_without_a_sensor_is_drawn_by_its_estimate(tmp_path: Path) -> None:
    signals = a_cut(20.0)
    blind = replace(signals, sensor_um=np.full(len(signals.state), np.nan))
    path = write_run(tmp_path / "a.h5", blind).finish("done", 0)
    assert "estimated" in legend_of(drawn("gap", path))
    with pytest.raises(NothingToDraw, match="no displacement sensor"):
        drawn("displacement", path)
    labels = [axes.get_ylabel() for axes in drawn("spectrum", path).axes]
    assert "power density of\nactuator voltage (V²/Hz)" in labels


def test_a_run_without_an_estimate_says_so(tmp_path: Path) -> None:
    signals = a_cut(20.0)
    bare = replace(signals, model_um=np.full(len(signals.state), np.nan))
    path = write_run(tmp_path / "a.h5", bare).finish("done", 0)
    with pytest.raises(NothingToDraw, match="conditioned or calibrated"):
        drawn("displacement", path)


@pytest.mark.parametrize("kind", [*KINDS, "waveforms"])
def test_an_empty_run_has_nothing_to_draw_and_says_why(kind: str, tmp_path: Path) -> None:
    path = write_run(tmp_path / "a.h5").finish("stopped by Ctrl-C", 130)
    with pytest.raises(NothingToDraw) as nothing:
        drawn(kind, path)
    assert str(nothing.value).endswith(".")


def test_a_second_of_data_is_enough(tmp_path: Path) -> None:
    path = write_run(tmp_path / "a.h5", a_cut(1.0)).finish("done", 0)
    time_s, gap_v = line_called(drawn("gap", path), "gap voltage")
    assert len(time_s) == 100
    assert gap_v == pytest.approx(a_cut(1.0).gap_v, abs=1e-5)
    drawn("displacement", path)


@pytest.mark.slow
def test_a_run_that_ended_in_a_fault_is_drawn_up_to_it(faulted_run_file: Path) -> None:
    figure = drawn("gap", faulted_run_file)
    with open_run(faulted_run_file) as run:
        last = run.table("/entry/events")["message"][-1].decode()
    told = re.search(r"at ([\d.]+) s\)$", last)
    assert told is not None, last
    assert figure.axes[1].get_xlim()[1] == pytest.approx(float(told[1]), abs=0.2)
    with pytest.raises(NothingToDraw, match="No site of this run was measured"):
        drawn("steps", faulted_run_file)
    assert "Touches of Z1: cu270-cu" in texts(drawn("touching", faulted_run_file))


@pytest.mark.parametrize("count", tiers(1, 4, slow=(3, 12, 13), full=(60,)))
def test_steps_stay_readable_however_many_sites_there_are(count: int, tmp_path: Path) -> None:
    path = write_run(tmp_path / "a.h5", results=sites(count)).finish("done", 0)
    figure = drawn("steps", path)
    assert width_mm(figure) == pytest.approx(85.0 if count <= 3 else 180.0, abs=0.2)
    assert not overlaps(figure)
    if count <= 12:
        assert sum("180.0" in text for text in texts(figure)) == count


def test_steps_are_the_readings_and_the_estimate_begins_at_its_own_reading(tmp_path: Path) -> None:
    writer = write_run(tmp_path / "a.h5", results=sites(1))
    writer.append(TouchRow(1.0, "Z1", "A1", 16.0, 50.0, 48.0, 3, 0.1, 0.0, 1.0))
    figure = drawn("steps", writer.finish("done", 0))
    levels_um = [data(line)[1][0] for line in figure.axes[0].get_lines() if line.get_linewidth() == 1.2]
    assert levels_um == [50.0, 300.0, 120.0]
    # The row's estimate: 178 µm deep, 69 µm of wear.
    levels = [data(line)[1][0] for line in figure.axes[0].get_lines() if line.get_linewidth() == 1.0]
    assert levels == pytest.approx([48.0, 48.0 + 69.0 + 178.0, 48.0 + 69.0])


def test_touching_marks_the_contacts_of_the_last_bottom(run_file: Path) -> None:
    with open_run(run_file) as run:
        events = run.table("/entry/events")
        readings = run.table("/entry/touches")
    bottom_s = readings["time"][readings["kind"] == b"Z2"][-1]
    before_s = readings["time"][readings["time"] < bottom_s][-1]
    contacts_s = [t for t in events["time"][events["code"] == 6] if before_s + 1e-3 < t <= bottom_s + 1e-3]
    figure = drawn("touching", run_file)
    zoom = figure.axes[2]
    upright = [data(line)[0] for line in zoom.get_lines()]
    marked_s = [time_s[0] for time_s in upright if time_s[0] == time_s[-1]]
    assert marked_s == pytest.approx(contacts_s)
    assert len(marked_s) == 3
    # The way back to rest is not shown: it would flatten everything else.
    low_v, high_v = zoom.get_ylim()
    assert high_v - low_v < 5.0


def test_touching_shows_the_whole_way_from_the_first_surface_to_the_last(run_file: Path) -> None:
    with open_run(run_file) as run:
        touches = run.table("/entry/touches")
    whole = drawn("touching", run_file)
    for axes, column in ((whole.axes[0], "v_cmd"), (whole.axes[1], "z_sensor")):
        for row in touches[touches["accepted"] == 1]:
            kind = row["kind"].decode()
            (marks,) = [line for line in axes.get_lines() if line.get_label() == kind]
            time_s, values = data(marks)
            assert row["time"] in time_s * (60.0 if "min" in whole.axes[1].get_xlabel() else 1.0)
            assert values[-1] == touches[touches["kind"] == row["kind"]][column][-1]
    begin, end = whole.axes[1].get_xlim()
    assert begin < touches["time"][0] < touches["time"][-1] < end


@pytest.mark.slow
def test_a_long_name_of_a_site_lies_on_nothing(tmp_path: Path) -> None:
    writer = write_run(tmp_path / "a.h5", a_cut(20.0))
    for k, kind in enumerate(("Z1", "Z2", "Z3")):
        name = "3141 µm along the path of the left one of two spirals"
        writer.append(TouchRow(5.0 + 5.0 * k, kind, name, 16.0, 50.0, 48.0, 3, 0.1, 0.0, 1.0))
    figure = drawn("touching", writer.finish("done", 0))
    assert "Touches of Z2: 3141 µm along the path of the left one o…" in texts(figure)
    assert not overlaps(figure)


@pytest.mark.slow
def test_a_spectrum_of_one_segment_is_one_segment(tmp_path: Path) -> None:
    path = write_run(tmp_path / "a.h5", a_cut(6.0)).finish("done", 0)
    assert "1 segment of 5.12 s, 100 Hz" in texts(drawn("spectrum", path))


@pytest.mark.slow
def test_what_is_folded_into_a_spectrum_is_told(run_file: Path, full_run_file: Path) -> None:
    told = "faster than 50 Hz: folded in"
    assert told in texts(drawn("spectrum", run_file))
    assert not any("folded" in text for text in texts(drawn("spectrum", full_run_file)))


def test_the_power_of_a_spectrum_is_that_of_the_signal() -> None:
    rng = np.random.default_rng(3)
    _, density = welch([rng.normal(0.0, 2.0, 1024) for _ in range(200)], 100.0)
    assert density.sum() * 100.0 / 1024 == pytest.approx(4.0, rel=0.02)
    time_s = np.arange(1024) / 100.0
    frequency_hz, density = welch([3.0 * np.sin(2.0 * np.pi * 12.5 * time_s)], 100.0)
    assert density.sum() * 100.0 / 1024 == pytest.approx(4.5, rel=0.01)
    assert frequency_hz[np.argmax(density)] == 12.5


def test_jumps_are_no_part_of_a_spectrum(tmp_path: Path) -> None:
    calm = a_cut(120.0)
    jumping = replace(calm, gap_v=calm.gap_v.copy(), sensor_um=calm.sensor_um.copy(), state=calm.state.copy())
    for start in range(1000, 12000, 1000):
        jumping.state[start : start + 20] = JUMP
        jumping.sensor_um[start : start + 20] -= 60.0
    paths = [write_run(tmp_path / f"{n}.h5", s).finish("done", 0) for n, s in (("a", calm), ("b", jumping))]
    spectra = [data(drawn("spectrum", path).axes[1].get_lines()[0])[1] for path in paths]
    highest = [float(density.max()) for density in spectra]
    # The density of a line is proportional to the length of the segments, here 10 s and 5 s.
    assert 2.0 * highest[1] == pytest.approx(highest[0], rel=0.2)


def test_a_segment_fits_half_of_the_samples() -> None:
    assert segment_size([100, 100, 5000], 100.0) == 1024  # no longer than 16 s
    assert segment_size([150] * 50, 100.0) == 128
    assert segment_size([20, 20], 100.0) == 0


def write_waveforms(path: Path, *, fault: bool, begin_s: float = 0.0, end_s: float = 0.04) -> Path:
    writer = write_run(path, leaves=profile_leaves({"pulse": {"frequency_hz": 2000.0}}))
    time_s = np.arange(begin_s, end_s, 1e-6)
    on = (time_s % 5e-4) < 1.5e-4
    writer.append(WaveformBatch(100.0 + time_s, np.where(on, 22.0, 0.0), np.where(on, 0.12, 0.0)))
    if fault:
        signals = replace(a_cut(0.02), state=np.array([MACHINING, int(RecordedState.FAULT)], np.uint8))
        writer.append(replace(signals.block(), time_s=np.array([100.0, 100.032])))
    return writer.finish("machine fault", 6)


def test_waveforms_are_counted_from_the_fault(tmp_path: Path) -> None:
    figure = drawn("waveforms", write_waveforms(tmp_path / "a.h5", fault=True))
    whole, detail = figure.axes[1], figure.axes[3]
    assert whole.get_xlim() == pytest.approx((-32.0, 8.0), abs=0.05)
    assert detail.get_xlim() == pytest.approx((-4.0, 1.0), abs=0.05)  # 8 periods before, 2 after
    assert {"fault", "voltage (V)", "current (A)", "time after the fault (ms)"} <= set(texts(figure))
    assert not overlaps(figure)
    assert width_mm(figure) == pytest.approx(85.0, abs=0.2)


def test_waveforms_of_a_short_memory_are_drawn_as_far_as_they_go(tmp_path: Path) -> None:
    path = write_waveforms(tmp_path / "a.h5", fault=True, begin_s=0.031, end_s=0.03225)
    figure = drawn("waveforms", path)
    for axes in (figure.axes[1], figure.axes[3]):  # two pulses before and half a period after
        assert axes.get_xlim() == pytest.approx((-1.0, 0.25), abs=0.01)
    assert "fault" in texts(figure)
    assert not overlaps(figure)


def test_no_plateau_of_a_waveform_is_above_every_number_of_its_axis(faulted_run_file: Path) -> None:
    for axes in drawn("waveforms", faulted_run_file).axes:
        ticks = axes.get_yticks()
        assert ticks[-1] >= max(data(line)[1].max() for line in axes.get_lines()[:1])
        low, high = axes.get_ylim()
        assert sum(low <= tick <= high for tick in ticks) >= 3


def test_the_pulses_of_a_real_short_end_at_the_fault(faulted_run_file: Path) -> None:
    figure = drawn("waveforms", faulted_run_file)
    time_ms, current_a = data(figure.axes[3].get_lines()[0])
    # 120 mA in a plain discharge, and more in a short
    assert current_a[time_ms < 0.0].max() > 0.1
    assert current_a[time_ms > 0.1].max() < 0.01
    assert not overlaps(figure)


def test_waveforms_without_a_known_fault_are_counted_from_their_end(tmp_path: Path) -> None:
    figure = drawn("waveforms", write_waveforms(tmp_path / "a.h5", fault=False))
    assert figure.axes[1].get_xlim()[1] == pytest.approx(0.0, abs=0.05)
    assert "fault" not in texts(figure)


@pytest.fixture
def long_run(tmp_path: Path) -> Path:
    """Ten thousand samples with a single high one, an idle begin, and a touch."""
    signals = a_cut(100.0)
    signals.state[:500] = IDLE
    signals.state[500:1000] = TOUCH
    signals.gap_v[7777] = 39.0
    return write_run(tmp_path / "a.h5", signals).finish("done", 0)


def test_a_single_high_sample_is_not_lost_in_a_long_run(long_run: Path) -> None:
    with open_run(long_run) as run:
        lines = envelopes(
            run,
            "/entry/servo",
            ["v_gap_avg"],
            lambda c: {"gap": c["v_gap_avg"].astype(np.float32)},
            points=100,
        )
    assert len(lines["gap"].time_s) == 100
    assert np.nanmax(lines["gap"].high) == 39.0
    assert lines["gap"].mean == pytest.approx(a_cut(100.0).gap_v.reshape(100, 100).mean(axis=1), abs=0.4)


def test_an_interval_of_nothing_but_nan_is_nan(tmp_path: Path) -> None:
    signals = a_cut(100.0)
    signals.sensor_um[:150] = np.nan
    path = write_run(tmp_path / "a.h5", signals).finish("done", 0)
    with open_run(path) as run:
        line = envelopes(
            run, "/entry/servo", ["z_sensor"], lambda c: {"z": c["z_sensor"].astype(np.float32)}, points=100
        )["z"]
    assert np.isnan(line.mean[0])
    assert np.isnan(line.low[0])
    assert line.mean[1] == pytest.approx(signals.sensor_um[150:200].mean(), abs=1e-3)


def test_what_comes_before_the_first_touch_is_left_out(long_run: Path) -> None:
    with open_run(long_run) as run:
        assert rows_worked(run) == (500, 10_000)


def test_spans_go_on_from_block_to_block() -> None:
    spans = Spans([RecordedState.TOUCH])
    spans.take(np.arange(4.0), np.array([0, 6, 6, 6]))
    spans.take(np.arange(4.0, 8.0), np.array([6, 0, 6, 6]))
    assert spans.joined() == [(1.0, 5.0), (6.0, 7.0)]
    assert spans.joined(within_s=1.0) == [(1.0, 7.0)]


@pytest.mark.parametrize(("span_s", "label"), [(0.1, "ms"), (1.0, "s"), (900.0, "min"), (28_800.0, "h")])
def test_an_axis_of_time_has_the_unit_of_its_length(span_s: float, label: str) -> None:
    assert time_unit(span_s)[1] == f"time ({label})"


def test_a_long_hold_is_shown_whole_with_the_voltage_that_sinks_and_the_sensor_that_stays(
    held_run_file: Path,
) -> None:
    figure = drawn("touching", held_run_file)
    voltage, _, displacement, _ = figure.axes[-4:]
    contacts_s = [data(line)[0][0] for line in voltage.get_lines() if line.get_linewidth() == 0.6]
    assert voltage.get_xlim()[1] > contacts_s[-1] + 5.0
    sunk_v = [float(text.get_text().split()[0].replace("−", "-")) for text in voltage.texts]
    moved_um = [float(text.get_text().split()[0].replace("−", "-")) for text in displacement.texts]
    assert len(sunk_v) == len(moved_um) == len(contacts_s) > 1
    assert sunk_v[0] < -0.05
    assert max(map(abs, moved_um)) <= 0.2


def test_of_short_holds_nothing_is_written(run_file: Path) -> None:
    assert not [
        text for axes in drawn("touching", run_file).axes for text in axes.texts if " V" in text.get_text()
    ]
