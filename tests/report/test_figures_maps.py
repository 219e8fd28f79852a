"""Figures of depth and place: erosion, arrays and channels."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from edmctl.labels import Basis
from edmctl.process import channel as ways
from edmctl.record.events import RecordedCode
from edmctl.record.reader import open_run
from edmctl.record.rows import SlowRow, Summary, TouchRow, TruthMap
from edmctl.report.figures import array, channel, erosion, steps
from edmctl.report.figures.array import short_names
from edmctl.report.removal import along, hole_starts_s, known_depths, lengths_um, planned_path, removal
from edmctl.report.style import house_style
from tests.record.samples import a_site_row
from tests.report import made_up
from tests.report.test_figures_pulses import nothing, texts

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from edmctl.record.reader import RunFile

pytest.importorskip("matplotlib")

SQUARE = {
    "path": {"kind": "rectangle", "x_um": 500.0, "y_um": 100.0, "width_um": 200.0, "height_um": 100.0},
}
FLOOR = '{"channel": {"floor": [{"s_um": 50.0, "depth_um": 19.5}, {"s_um": 350.0, "depth_um": 20.5}]}}'


def panels(draw: Callable[[RunFile], Figure], path: Path) -> list[Axes]:
    """Draw, and return the panels."""
    with open_run(path) as run, house_style():
        return list(draw(run).axes)


def test_a_hole_has_its_estimates_and_its_measured_values(run_file: Path) -> None:
    told = texts(erosion.draw, run_file)
    assert {
        "estimated depth",
        "95 % band of depth",
        "estimated wear",
        "measured depth",
        "measured wear",
    } <= told
    assert {"depth and wear (µm)", "target 8 µm", "time (s)"} <= told


def test_measured_points_stand_at_their_depth_with_their_bars(tmp_path: Path) -> None:
    from matplotlib.container import ErrorbarContainer

    writer = made_up.new_run(tmp_path)
    made_up.cut(writer, 0.0)
    made_up.measured(writer, 30.0, 19.25)
    depth = panels(erosion.draw, writer.finish("done", 0))[0].containers[0]
    assert isinstance(depth, ErrorbarContainer)
    line, _, (bars,) = depth.lines
    assert np.asarray(line.get_xydata()).tolist() == [[30.0, 19.25]]
    (bar,) = bars.get_segments()
    assert bar[:, 1] == pytest.approx([18.85, 19.65])


def test_a_hole_that_was_not_touched_stands_at_the_depth_of_its_result(tmp_path: Path) -> None:
    writer = made_up.new_run(tmp_path)
    for k, (depth_um, told) in enumerate(
        ((20.0, RecordedCode.SITE_ESTIMATED), (19.0, RecordedCode.SITE_MEASURED))
    ):
        made_up.cut(writer, 100.0 * k)
        made_up.measured(writer, 100.0 * k + 30.0, depth_um, told)
    # The touch of the second hole has told that the first is less deep than was thought.
    first = replace(a_site_row(), name="1", depth_um=18.6, depth_u95_um=0.7, estimated_um=20.0)
    first = replace(first, depth_basis=Basis.ESTIMATED)
    writer.append(first)
    writer.append(replace(a_site_row(), name="2", depth_um=19.0, measuring_stops=1))
    path = writer.finish("done", 0)
    with open_run(path) as run:
        told_um = known_depths(run, hole_starts_s(run))
    assert [(one.hole, one.touched, one.depth_um) for one in told_um] == [(0, False, 18.6), (1, True, 19.0)]
    assert told_um[0].depth_u95_um == 0.7
    assert {"depth without a touch, corrected later", "measured depth"} <= texts(erosion.draw, path)


def test_the_band_of_a_depth_is_named_after_it_and_nothing_is_corrected_by_no_touch(tmp_path: Path) -> None:
    writer = made_up.new_run(tmp_path)
    made_up.cut(writer, 0.0)
    made_up.measured(writer, 30.0, 20.0, RecordedCode.SITE_ESTIMATED)
    _, labels = panels(erosion.draw, writer.finish("done", 0))[0].get_legend_handles_labels()
    assert labels[:2] == ["estimated depth", "95 % band of depth"]
    assert "depth without a touch" in labels


def test_a_hole_through_the_sheet_has_its_wear_and_the_sheet_but_no_depth(tmp_path: Path) -> None:
    writer = made_up.new_run(tmp_path, {"target": {"kind": "through"}})
    made_up.cut(writer, 0.0, 0.0, 900.0)
    row = replace(a_site_row(), depth_um=1080.0, wear_um=200.0, measuring_stops=1, through=True)
    row = replace(row, depth_basis=Basis.ESTIMATED)
    writer.append(TouchRow(31.0, "Z1", row.name, 20.0, 50.0, 49.0, 3, 0.3, 0.0, 1.0))
    writer.append(TouchRow(41.0, "Z3", row.name, 20.0, 250.0, 249.0, 3, 0.3, 0.0, 1.0))
    writer.append(row)
    path = writer.finish("done", 0)
    with open_run(path) as run:
        (told,) = known_depths(run, hole_starts_s(run))
        assert len(removal(run).time_s) == 0
    assert (told.time_s, told.wear_um, told.touched, told.wear_touched) == (41.0, 200.0, False, True)
    assert np.isnan(told.depth_um)
    words = texts(erosion.draw, path)
    assert {"measured wear", "sheet 1000 µm thick"} <= words
    assert not {"measured depth", "target 20 µm"} & words
    assert "through the sheet" in nothing(array.draw, path)
    assert {"tip at", "the end", "without a touch"} <= texts(steps.draw, path)


def test_a_target_far_above_what_was_cut_does_not_squash_it(tmp_path: Path) -> None:
    for to_um, drawn in ((4.0, False), (15.0, True)):
        writer = made_up.new_run(tmp_path, name=f"{to_um}.h5")
        made_up.cut(writer, 0.0, 0.0, to_um)
        path = writer.finish("done", 0)
        assert bool(panels(erosion.draw, path)[0].get_ylim()[1] > 20.0) is drawn
        assert any(text.startswith("target 20 µm") for text in texts(erosion.draw, path))


def test_the_highest_feed_is_told_with_its_time_wherever_it_is(tmp_path: Path) -> None:
    writer = made_up.new_run(tmp_path)
    for k in range(1000):
        feed_um_s = 0.5 if k < 920 else 6.0
        writer.append(SlowRow(0.1 * k, feed_um_s, 0.8, 0.8, 0.2, 0.7, 0.1, 0.0, 0.1 * k, 0.01 * k, 0.1))
    told = texts(erosion.draw, writer.finish("done", 0))
    (cut_off,) = [text for text in told if text.endswith("cut off")]
    assert cut_off.startswith("up to 4.9 µm/s at 99.9 s")


def test_one_hole_is_no_array(tmp_path: Path) -> None:
    writer = made_up.new_run(tmp_path)
    writer.append(a_site_row())
    assert "--kind steps" in nothing(array.draw, writer.finish("done", 0))


def test_what_was_not_touched_is_drawn_open(tmp_path: Path) -> None:
    from matplotlib.container import ErrorbarContainer

    writer = made_up.new_run(tmp_path)
    for stops, estimated_um in ((1, 0.0), (1, 2.0), (0, 20.0)):
        row = replace(a_site_row(), name=f"{stops}{estimated_um}", x_um=100.0 * estimated_um)
        basis = Basis.ESTIMATED if estimated_um else Basis.TOUCHED
        writer.append(replace(row, measuring_stops=stops, estimated_um=estimated_um, depth_basis=basis))
    path = writer.finish("done", 0)
    errors, *_ = panels(array.draw, path)
    points = [bars.lines[0] for bars in errors.containers if isinstance(bars, ErrorbarContainer)]
    faces = [str(line.get_markerfacecolor()) for line in points]
    numbers = [np.asarray(line.get_xdata()).tolist() for line in points]
    assert numbers == [[1], [2, 3]]
    assert faces[1] == "white" != faces[0]
    levels = [line for line in panels(steps.draw, path)[0].get_lines() if line.get_linewidth() == 1.2]
    # Z1 of none was touched, Z2 and Z3 of the first alone.
    assert [line.get_linestyle() == "-" for line in levels] == [False, True, True] + 6 * [False]


def test_without_a_sensor_there_is_one_line_of_readings(tmp_path: Path) -> None:
    writer = made_up.new_run(tmp_path)
    made_up.cut(writer, 0.0)
    made_up.measured(writer, 30.0, 20.0)
    for kind in ("Z1", "Z2", "Z3"):
        writer.append(TouchRow(25.0, kind, "A1", 20.0, math.nan, 50.0, 3, 0.3, 0.0, 1.0))
    writer.append(replace(a_site_row(), measuring_stops=1))
    path = writer.finish("done", 0)
    told = texts(steps.draw, path)
    assert "by contact, estimated displacement" in told
    assert not {"measured", "estimated from voltage"} & told
    assert "depth by contact, from voltage" in texts(erosion.draw, path)


def test_a_run_that_never_cut_has_no_erosion(tmp_path: Path) -> None:
    assert "Nothing was cut" in nothing(erosion.draw, made_up.new_run(tmp_path).finish("done", 0))


@pytest.mark.slow
def test_each_hole_of_an_array_is_shown_with_its_error(array_run_file: Path) -> None:
    with open_run(array_run_file) as run:
        rows = run.table("/entry/results")
    told = texts(array.draw, array_run_file)
    signed = {f"{row['depth'] - 5.0:+.2f}".replace("-", "−") for row in rows}
    assert signed <= {text.removeprefix("~") for text in told} | {"+0.00", "−0.00"}
    assert {f"± {row['depth_u95']:.2f}" for row in rows} <= told
    assert {"x (µm)", "y (µm)", "depth − target (µm)", "tool wear (µm)"} <= told


def test_holes_are_called_by_the_numbers_of_their_names(tmp_path: Path) -> None:
    writer = made_up.new_run(tmp_path)
    for place, number in enumerate((4, 1, 2)):
        writer.append(replace(a_site_row(), name=f"hole-{number}", x_um=300.0 * place))
    _, wear, places = panels(array.draw, writer.finish("done", 0))
    assert [text.get_text().partition("\n")[0] for text in places.texts] == ["4", "1", "2"]
    assert [text.get_text() for text in wear.get_xticklabels()] == ["4", "1", "2"]
    assert short_names(["left-1", "right-1"]) == ["left-1", "right-1"]


@pytest.mark.parametrize("holes", [2, 100])
def test_colours_are_centred_on_no_error_however_many_holes(tmp_path: Path, holes: int) -> None:
    writer = made_up.new_run(tmp_path)
    for k in range(holes):
        x_um, y_um = 300.0 * (k % 10), 300.0 * (k // 10)
        writer.append(replace(a_site_row(), x_um=x_um, y_um=y_um, depth_um=20.0 + 0.03 * k))
    map_axes = panels(array.draw, writer.finish("done", 0))[2]
    (discs,) = map_axes.collections
    low_um, high_um = discs.get_clim()
    assert low_um is not None
    assert high_um is not None
    assert low_um == -high_um
    assert np.asarray(discs.get_array()) == pytest.approx(0.03 * np.arange(holes))
    assert map_axes.get_aspect() == 1.0


def test_a_channel_is_no_array_and_a_hole_no_channel(tmp_path: Path, run_file: Path) -> None:
    path = made_up.new_run(tmp_path, SQUARE).finish("done", 0)
    assert "--kind channel" in nothing(array.draw, path)
    assert "not measured" in nothing(channel.draw, path)
    assert "no channel" in nothing(channel.draw, run_file)


@pytest.mark.parametrize(
    ("table", "way"),
    [
        (SQUARE["path"], ways.rectangle(500.0, 100.0, 200.0, 100.0)),
        ({"kind": "circle", "x_um": 9.0, "y_um": 0.0, "radius_um": 80.0}, ways.circle(9.0, 0.0, 80.0)),
        (
            {"kind": "spiral", "x_um": 0.0, "y_um": 5.0, "radius_um": 50.0, "pitch_um": 90.0, "turns": 2.5},
            ways.spiral(0.0, 5.0, 50.0, 90.0, 2.5),
        ),
    ],
)
def test_the_planned_path_is_that_of_the_job(
    tmp_path: Path, table: dict[str, object], way: np.ndarray[tuple[int, int], np.dtype[np.float64]]
) -> None:
    with open_run(made_up.new_run(tmp_path, {"path": table}).finish("done", 0)) as run:
        planned = planned_path(run)
    assert planned is not None
    assert planned[[0, -1]] == pytest.approx(way[[0, -1]], abs=1e-9)
    assert lengths_um(planned)[-1] == pytest.approx(ways.lengths_um(way)[-1], rel=3e-3)
    s_um = np.linspace(0.0, 0.99, 40)
    apart_um = [
        np.array([np.interp(s_um * lengths_um(points)[-1], lengths_um(points), axis) for axis in points.T])
        for points in (planned, way)
    ]
    assert np.abs(apart_um[0] - apart_um[1]).max() < 2.5


def test_places_along_a_path_are_evenly_spaced() -> None:
    s_um, places_um = along(np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0]]), 4.0)
    assert s_um.tolist() == [0.0, 4.0, 8.0, 12.0, 16.0]
    assert places_um[-1].tolist() == [10.0, 6.0]


@pytest.mark.slow
def test_a_channel_of_the_virtual_machine_has_its_truth_and_its_touches(channel_run_file: Path) -> None:
    with open_run(channel_run_file) as run:
        truth, summary = run.truth_map(), run.summary()
        told_um = known_depths(run, hole_starts_s(run))
    assert told_um
    assert all(one.depth_u95_um > 0.0 < one.wear_u95_um for one in told_um)
    assert truth is not None
    assert summary is not None
    assert float(np.median(truth.depth_um[truth.depth_um > 2.0])) == pytest.approx(4.0, abs=1.0)
    told = texts(channel.draw, channel_run_file)
    assert {
        "floor on the path, simulated truth",
        "touched by the tool, 95 % of the mean",
        "target 4 ± 2 µm",
    } <= told
    assert "depth − target, simulated truth (µm)" in told


def test_a_channel_of_a_real_machine_shows_what_was_touched(tmp_path: Path) -> None:
    from matplotlib.container import ErrorbarContainer

    writer = made_up.new_run(tmp_path, SQUARE)
    writer.append(Summary(FLOOR))
    path = writer.finish("done", 0)
    told = texts(channel.draw, path)
    assert "depth − target, touched (µm)" in told
    assert not any("truth" in text for text in told)
    floor = panels(channel.draw, path)[1]
    (touched,) = floor.containers
    assert isinstance(touched, ErrorbarContainer)
    assert touched.get_label() == "touched by the tool"
    assert np.asarray(touched.lines[0].get_xydata()).tolist() == [[0.05, 19.5], [0.35, 20.5]]


def test_the_floor_is_looked_up_under_the_path(tmp_path: Path) -> None:
    writer = made_up.new_run(tmp_path, SQUARE)
    x_um, y_um = np.arange(300.0, 701.0, 5.0), np.arange(0.0, 201.0, 5.0)
    # As deep as x says, so each place of the path has its own depth.
    writer.append(TruthMap(x_um, y_um, np.tile(0.04 * x_um, (len(y_um), 1))))
    floor = panels(channel.draw, writer.finish("done", 0))[1]
    line = next(line for line in floor.get_lines() if "simulated truth" in str(line.get_label()))
    s_mm, depth_um = np.asarray(line.get_xydata()).T
    assert depth_um[0] == pytest.approx(16.0)
    assert depth_um[s_mm == pytest.approx(0.1)] == pytest.approx(20.0)
    assert depth_um[np.searchsorted(s_mm, 0.2499)] == pytest.approx(24.0)
