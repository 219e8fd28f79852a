"""Figures of depth and place: erosion, arrays, holes in section, and channels."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

pytest.importorskip("matplotlib")

from pathlib import Path

from edmctl.labels import Basis
from edmctl.process import channel as ways
from edmctl.record.reader import open_run
from edmctl.record.rows import RunEvent, SlowRow, Summary, TruthMap
from edmctl.report.figures.channel import Channel, channel_figure
from edmctl.report.figures.holes import scale_of, sections_of, short_names
from edmctl.report.panels import house_style, rendered
from edmctl.report.removal import along, hole_starts_s, known_depths, lengths_um, planned_path, removal
from edmctl.results.job import SiteResult
from tests.record.samples import a_site_row
from tests.report import made_up
from tests.report.drawing import drawn, points_of, texts, texts_of, why_not
from tests.report.made_up import finished

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SQUARE: dict[str, dict[str, object]] = {
    "path": {"kind": "rectangle", "x_um": 500.0, "y_um": 100.0, "width_um": 200.0, "height_um": 100.0},
}
FLOOR = '{"channel": {"floor": [{"s_um": 50.0, "depth_um": 19.5}, {"s_um": 350.0, "depth_um": 20.5}]}}'
TRUTH = {
    **{"depth_um": 20.4, "wear_um": 5.0, "side_gap_um": 7.0, "taper_um": 3.0},
    **{"ra_um": 0.2, "rz_um": 1.2, "corner_um": 2.5},
}


def panels(kind: str, path: Path) -> list[Axes]:
    return list(drawn(kind, path).axes)


def test_a_hole_has_its_estimates_and_its_measured_values(run_file: Path) -> None:
    estimated = {"estimated depth", "95 % band of depth", "estimated wear"}
    measured = {"measured depth", "measured wear", "target 8 µm"}
    assert estimated | measured | {"depth and wear (µm)", "time (s)"} <= texts("erosion", run_file)


def test_measured_points_stand_at_their_depth_with_their_bars_and_a_far_target_is_written(
    tmp_path: Path,
) -> None:
    for to_um, is_drawn in ((4.0, False), (15.0, True)):
        writer = made_up.new_run(tmp_path, name=f"{to_um}.h5")
        made_up.cut(writer, 0.0, 0.0, to_um)
        made_up.measured(writer, 30.0, to_um - 0.75)
        path = writer.finish("done", 0)
        axes = panels("erosion", path)[0]
        assert np.asarray(points_of(axes)[0].get_xydata()).tolist() == [[30.0, to_um - 0.75]]
        bars = axes.containers[0].lines[2][0]  # type: ignore[attr-defined]
        assert bars.get_segments()[0][:, 1] == pytest.approx([to_um - 1.15, to_um - 0.35])
        assert bool(axes.get_ylim()[1] > 20.0) is is_drawn
        assert any(text.startswith("target 20 µm") for text in texts("erosion", path))


def test_a_hole_that_was_not_touched_stands_at_the_depth_of_its_result(tmp_path: Path) -> None:
    writer = made_up.new_run(tmp_path)
    codes = (RunEvent.SITE_ESTIMATED, RunEvent.SITE_MEASURED)
    for k, (depth_um, told) in enumerate(zip((20.0, 19.0), codes, strict=True)):
        made_up.cut(writer, 100.0 * k)
        made_up.measured(writer, 100.0 * k + 30.0, depth_um, told)
    # The touch of the second hole has shown that the first is less deep than estimated.
    first = replace(a_site_row(), name="1", depth_um=18.6, depth_u95_um=0.7, estimated_um=20.0)
    writer.append(replace(first, depth_basis=Basis.ESTIMATED))
    writer.append(replace(a_site_row(), name="2", depth_um=19.0, measuring_stops=1))
    path = writer.finish("done", 0)
    with open_run(path) as run:
        known = known_depths(run, hole_starts_s(run))
    assert [(one.hole, one.touched, one.depth_um) for one in known] == [(0, False, 18.6), (1, True, 19.0)]
    assert known[0].depth_u95_um == 0.7
    assert {"depth without a touch, corrected later", "measured depth"} <= texts("erosion", path)
    alone = made_up.new_run(tmp_path, name="alone.h5")
    made_up.cut(alone, 0.0)
    made_up.measured(alone, 30.0, 20.0, RunEvent.SITE_ESTIMATED)
    _, labels = panels("erosion", alone.finish("done", 0))[0].get_legend_handles_labels()
    assert labels[:2] == ["estimated depth", "95 % band of depth"]
    assert "depth without a touch" in labels  # nothing corrects it


def test_a_hole_through_the_sheet_has_its_wear_and_the_sheet_but_no_depth(tmp_path: Path) -> None:
    writer = made_up.new_run(tmp_path, {"target": {"kind": "through"}})
    made_up.cut(writer, 0.0, 0.0, 900.0)
    row = replace(a_site_row(), depth_um=1080.0, wear_um=200.0, measuring_stops=1, through=True)
    for kind, time_s, z_um in (("Z1", 31.0, 50.0), ("Z3", 41.0, 250.0)):
        writer.append(made_up.a_touch(kind, time_s, z_um, row.name))
    writer.append(replace(row, depth_basis=Basis.ESTIMATED))
    path = writer.finish("done", 0)
    with open_run(path) as run:
        (known,) = known_depths(run, hole_starts_s(run))
        assert len(removal(run).time_s) == 0
    assert (known.time_s, known.wear_um, known.touched, known.wear_touched) == (41.0, 200.0, False, True)
    assert np.isnan(known.depth_um)
    words = texts("erosion", path)
    assert {"measured wear", "sheet 1000 µm thick"} <= words
    assert not {"measured depth", "target 20 µm"} & words
    assert "through the sheet" in why_not("array", path)
    assert {"tip at", "the end", "without a touch"} <= texts("steps", path)


def test_the_highest_feed_is_told_with_its_time_wherever_it_is(tmp_path: Path) -> None:
    shares = (0.8, 0.8, 0.2, 0.7, 0.1, 0.0)
    rows = [
        SlowRow(0.1 * k, 0.5 if k < 920 else 6.0, *shares, depth_um=0.1 * k, wear_um=0.01 * k, power_w=0.1)
        for k in range(1000)
    ]
    shown = texts("erosion", finished(tmp_path, *rows))
    assert [text[:22] for text in shown if text.endswith("cut off")] == ["up to 4.9 µm/s at 99.9"]


def test_what_was_not_touched_is_drawn_open(tmp_path: Path) -> None:
    rows = []
    for stops, estimated_um in ((1, 0.0), (1, 2.0), (0, 20.0)):
        basis = Basis.ESTIMATED if estimated_um else Basis.TOUCHED
        row = replace(a_site_row(), name=f"{stops}{estimated_um}", x_um=100.0 * estimated_um)
        rows.append(replace(row, measuring_stops=stops, estimated_um=estimated_um, depth_basis=basis))
    path = finished(tmp_path, *rows)
    points = points_of(panels("array", path)[0])
    assert [np.asarray(line.get_xdata()).tolist() for line in points] == [[1], [2, 3]]
    faces = [str(line.get_markerfacecolor()) for line in points]
    assert faces[1] == "white" != faces[0]
    levels = [line for line in panels("steps", path)[0].get_lines() if line.get_linewidth() == 1.2]
    # Z1 of none was touched, Z2 and Z3 of the first alone.
    assert [line.get_linestyle() == "-" for line in levels] == [False, True, True] + 6 * [False]


def test_without_a_sensor_there_is_one_line_of_readings(tmp_path: Path) -> None:
    writer = made_up.new_run(tmp_path)
    made_up.cut(writer, 0.0)
    made_up.measured(writer, 30.0, 20.0)
    for kind in ("Z1", "Z2", "Z3"):
        writer.append(made_up.a_touch(kind, 25.0, math.nan))
    writer.append(replace(a_site_row(), measuring_stops=1))
    path = writer.finish("done", 0)
    shown = texts("steps", path)
    assert "by contact, estimated displacement" in shown
    assert not {"measured", "estimated from voltage"} & shown
    assert "depth by contact, from voltage" in texts("erosion", path)


@pytest.mark.parametrize("holes", [3, 100])
def test_holes_of_an_array_have_their_numbers_and_colours_centred_on_no_error(
    tmp_path: Path, holes: int
) -> None:
    rows = [
        replace(a_site_row(), name=f"hole-{holes - k}", x_um=300.0 * (k % 10), y_um=300.0 * (k // 10))
        for k in range(holes)
    ]
    rows = [replace(row, depth_um=20.0 + 0.03 * k) for k, row in enumerate(rows)]
    _, wear, places = panels("array", finished(tmp_path, *rows))
    (discs,) = places.collections
    low_um, high_um = discs.get_clim()
    assert low_um is not None
    assert high_um == -low_um
    assert np.asarray(discs.get_array()) == pytest.approx(0.03 * np.arange(holes))
    assert places.get_aspect() == 1.0
    if holes == 3:
        assert [text.get_text().partition("\n")[0] for text in places.texts] == ["3", "2", "1"]
        assert [text.get_text() for text in wear.get_xticklabels()] == ["3", "2", "1"]
    assert short_names(["left-1", "right-1"]) == ["left-1", "right-1"]


def test_what_a_run_has_nothing_for_is_said_with_the_remedy(tmp_path: Path, run_file: Path) -> None:
    empty, one = finished(tmp_path), finished(tmp_path, a_site_row(), name="one.h5")
    square = finished(tmp_path, profile=SQUARE, name="square.h5")
    for kind, path, said in (
        ("erosion", empty, "Nothing was cut"),
        ("section", empty, "first measuring stop"),
        ("section", square, "--kind channel"),
        ("array", square, "--kind channel"),
        ("array", one, "--kind steps"),
        ("channel", square, "not measured"),
        ("channel", run_file, "no channel"),
    ):
        assert said in why_not(kind, path)


def hole(**changes: Any) -> SiteResult:
    return replace(a_site_row(), depth_um=20.0, depth_u95_um=0.4, wear_um=5.0, **changes)


def summary(*rows: SiteResult, **values: object) -> Summary:
    return Summary(json.dumps({"sites": [{"name": row.name, **values} for row in rows]}))


def line(axes: Axes, label: str) -> np.ndarray:
    (found,) = [one for one in axes.get_lines() if one.get_label() == label]
    return np.asarray(found.get_xydata())


def test_floor_wear_and_walls_are_those_of_touches_and_profile(tmp_path: Path) -> None:
    path = finished(tmp_path, hole())
    (axes,) = panels("section", path)
    with open_run(path) as run:
        wall_um = 0.5 * run.number("/entry/tool/diameter") + float(run.profile_values()["work.side_gap_um"])
    assert line(axes, "floor, touched").tolist() == [[-wall_um, 20.0], [wall_um, 20.0]]
    assert line(axes, "wall by the profile's side gap").tolist() == [[wall_um, 0.0], [wall_um, 20.0]]
    assert "truth (simulated)" not in axes.get_legend_handles_labels()[1]
    told = "\n".join(texts("section", path))
    # 20 µm deep and wide as the tool: not to scale, and said so
    assert all(words in told for words in ("20.0 ± 0.4 µm", "side gap by the profile 5.0 µm", "depth × "))


def test_the_true_hole_is_a_line_of_its_own_with_gap_taper_and_corner(tmp_path: Path) -> None:
    path = finished(tmp_path, hole(), summary(hole(), truth=TRUTH))
    (axes,) = panels("section", path)
    with open_run(path) as run:
        radius_um = 0.5 * run.number("/entry/tool/diameter")
    outline = line(axes, "truth (simulated)")
    assert outline[0] == pytest.approx([radius_um + 10.0, 0.0])
    assert outline[-1] == pytest.approx([-radius_um - 10.0, 0.0])
    assert outline[1] == pytest.approx([radius_um + 7.0, 17.9])
    assert outline[:, 1].max() == pytest.approx(20.4)
    assert np.abs(outline[outline[:, 1] > 20.39, 0]).max() < radius_um + 7.0 - 2.0
    told = "\n".join(texts("section", path))
    assert "truth: side gap 7.0 µm" in told
    assert "taper 3.0 µm, corner 2.5 µm" in told


@pytest.mark.parametrize("corner_um", [0.0, 2.5, 30.0])
def test_the_tool_lies_within_the_true_hole(tmp_path: Path, corner_um: float) -> None:
    path = finished(tmp_path, hole(), summary(hole(), truth=TRUTH | {"corner_um": corner_um}))
    with open_run(path) as run:
        ((one,), _) = sections_of(run)
    outline = one.true_outline()
    assert outline is not None
    wall = outline[: len(outline) // 2]
    for across_um, depth_um in one.tool_tip():
        assert abs(across_um) <= np.interp(depth_um, wall[:, 1], wall[:, 0]) + 1e-9


@pytest.mark.parametrize(
    ("basis", "label", "number"),
    [
        (Basis.ESTIMATED, "floor, estimated", "~20.0 ± 0.4 µm"),
        (Basis.MODEL, "floor, touched, by the actuator's model", "≈20.0 ± 0.4 µm"),
    ],
)
def test_a_section_has_the_working_gap_and_says_what_was_not_touched_with_a_sensor(
    tmp_path: Path, basis: Basis, label: str, number: str
) -> None:
    path = finished(tmp_path, hole(depth_basis=basis), summary(hole(), working_gap_um=3.25))
    (axes,) = panels("section", path)
    assert line(axes, "tip while sparking")[:, 1].tolist() == [16.75, 16.75]
    assert label in axes.get_legend_handles_labels()[1]
    assert number in "\n".join(texts("section", path))
    assert "working gap 3.2 µm" in texts("section", path)


def test_a_hole_through_the_sheet_has_no_floor(tmp_path: Path) -> None:
    row = replace(a_site_row(), depth_um=np.nan, beyond_exit_um=80.0, wear_um=200.0, through=True)
    path = finished(tmp_path, row)
    (axes,) = panels("section", path)
    assert not [name for name in axes.get_legend_handles_labels()[1] if name.startswith("floor")]
    assert line(axes, "wall by the profile's side gap")[:, 1].tolist() == [0.0, 1000.0]
    assert "beyond" in "\n".join(texts("section", path))


@pytest.mark.parametrize(("count", "depth_um"), [(1, 1.5), (1, 400.0), (5, 1.5), (5, 20.0), (5, 400.0)])
def test_a_section_keeps_its_text_and_of_many_holes_the_last_three_are_drawn(
    tmp_path: Path, count: int, depth_um: float
) -> None:
    row = replace(a_site_row(), depth_um=depth_um, wear_um=0.4 * depth_um, depth_basis=Basis.MODEL)
    rows = [replace(row, name=f"hole-{k}") for k in range(count)]
    path = finished(tmp_path, *rows, summary(*rows, truth=TRUTH))
    assert texts("section", path)
    titles = [axes.get_title().split(",")[0] for axes in panels("section", path)]
    many = ["(a) hole-2 (3 of 5)", "(b) hole-3 (4 of 5)", "(c) hole-4 (5 of 5)"]
    assert titles == (["hole-0"] if count == 1 else many)


def test_the_figure_of_one_hole_is_as_high_as_it_needs(tmp_path: Path) -> None:
    heights = []
    for depth_um in (60.0, 180.0, 500.0):
        row = replace(a_site_row(), depth_um=depth_um, wear_um=0.3 * depth_um)
        figure = drawn("section", finished(tmp_path, row, name=f"{depth_um}.h5"))
        heights.append(25.4 * float(figure.get_figheight()))
    assert min(heights) + 3.0 < max(heights) < 115.0


@pytest.mark.parametrize(
    ("ratio", "scale"), [(1.0, 1.0), (0.5, 1.0), (0.2, 5.0), (0.01, 50.0), (3.0, 0.2), (30.0, 0.05)]
)
def test_what_is_flat_or_deep_is_stretched_by_a_round_number(ratio: float, scale: float) -> None:
    assert scale_of(ratio) == scale


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
    with open_run(finished(tmp_path, profile={"path": table})) as run:
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


def channel(floor_um: float = 20.0) -> Channel:
    x_um = np.arange(-140.0, 141.0, 5.0)
    xs, ys = np.meshgrid(x_um, x_um)
    depth_um = np.where(np.abs(np.hypot(xs, ys) - 100.0) < 30.0, floor_um, 0.0)
    path_um = ways.circle(0.0, 0.0, 100.0)
    return Channel(TruthMap(x_um, x_um, depth_um), path_um, np.array([[50.0, 20.3]]), 0.4, 20.0, 2.0)


def test_axes_of_a_channel_have_units_and_everything_drawn_its_name() -> None:
    axes = {"x (µm)", "y (µm)", "length along the path (mm)", "depth of the floor (µm)"}
    lines = {"planned path of the tool's axis", "start", "target 20 ± 2 µm"}
    found = {"floor on the path, simulated truth", "touched by the tool, 95 % of the mean"}
    with house_style():
        told = texts_of(rendered(channel_figure(channel()), ".svg"))
    assert axes | lines | found | {"depth − target, simulated truth (µm)"} <= told


def test_colours_are_symmetric_about_the_target_the_rim_has_none_and_a_far_floor_is_within_the_axes() -> None:
    with house_style():
        places = channel_figure(channel(21.0)).axes[0]
        floor = channel_figure(channel(31.0)).axes[1]
    (image,) = places.get_images()
    assert image.get_clim() == (-2.0, 2.0)
    array: Any = image.get_array()
    shown = array.filled(np.nan)
    assert np.isfinite(shown).any()
    assert not np.isfinite(shown[[0, -1]]).any()
    assert float(np.nanmin(shown)) >= -2.0
    assert floor.get_ylim()[0] > 31.0


@pytest.mark.slow
def test_a_channel_of_the_virtual_machine_has_its_truth_and_its_touches(channel_run_file: Path) -> None:
    with open_run(channel_run_file) as run:
        truth = run.truth_map()
        told_um = known_depths(run, hole_starts_s(run))
    assert told_um
    assert all(one.depth_u95_um > 0.0 < one.wear_u95_um for one in told_um)
    assert truth is not None
    assert float(np.median(truth.depth_um[truth.depth_um > 2.0])) == pytest.approx(4.0, abs=1.0)
    found = {"floor on the path, simulated truth", "touched by the tool, 95 % of the mean"}
    assert found | {"target 4 ± 2 µm"} <= texts("channel", channel_run_file)


def test_a_channel_of_a_real_machine_shows_what_was_touched(tmp_path: Path) -> None:
    path = finished(tmp_path, Summary(FLOOR), profile=SQUARE)
    told = texts("channel", path)
    assert "depth − target, touched (µm)" in told
    assert not any("truth" in text for text in told)
    floor = panels("channel", path)[1]
    assert [one.get_label() for one in floor.containers] == ["touched by the tool"]
    assert np.asarray(points_of(floor)[0].get_xydata()).tolist() == [[0.05, 19.5], [0.35, 20.5]]


def test_the_floor_is_looked_up_under_the_path(tmp_path: Path) -> None:
    x_um, y_um = np.arange(300.0, 701.0, 5.0), np.arange(0.0, 201.0, 5.0)
    # As deep as x says, so each place of the path has its own depth.
    truth = TruthMap(x_um, y_um, np.tile(0.04 * x_um, (len(y_um), 1)))
    floor = panels("channel", finished(tmp_path, truth, profile=SQUARE))[1]
    s_mm, depth_um = line(floor, "floor on the path, simulated truth").T
    assert depth_um[0] == pytest.approx(16.0)
    assert depth_um[s_mm == pytest.approx(0.1)] == pytest.approx(20.0)
    assert depth_um[np.searchsorted(s_mm, 0.2499)] == pytest.approx(24.0)
