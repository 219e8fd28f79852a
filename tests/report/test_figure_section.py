"""The hole in section."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from edmctl.labels import Basis
from edmctl.record.reader import open_run
from edmctl.record.rows import Summary
from edmctl.report.figures import section
from edmctl.report.style import house_style
from tests.record.samples import a_site_row
from tests.report import made_up
from tests.report.test_figures_pulses import nothing, texts

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes

pytest.importorskip("matplotlib")

TRUTH = (
    '{"sites": [{"name": "NAME", "truth": {"depth_um": 20.4, "wear_um": 5.0, "side_gap_um": 7.0, "taper_um": 3.0, '
    '"ra_um": 0.2, "rz_um": 1.2, "corner_um": 2.5}}]}'
)


def panels(path: Path) -> list[Axes]:
    with open_run(path) as run, house_style():
        return list(section.draw(run).axes)


def line(axes: Axes, label: str) -> np.ndarray:
    (found,) = [one for one in axes.get_lines() if one.get_label() == label]
    return np.asarray(found.get_xydata())


def a_hole(tmp_path: Path, name: str = "a.h5", summary: str = "", **changes: object) -> Path:
    writer = made_up.new_run(tmp_path, name=name)
    row = replace(a_site_row(), depth_um=20.0, depth_u95_um=0.4, wear_um=5.0, **changes)  # type: ignore[arg-type]
    writer.append(row)
    if summary:
        writer.append(Summary(summary.replace("NAME", row.name)))
    return writer.finish("done", 0)


def test_floor_wear_and_walls_are_those_of_touches_and_profile(tmp_path: Path) -> None:
    path = a_hole(tmp_path)
    (axes,) = panels(path)
    with open_run(path) as run:
        wall_um = 0.5 * run.number("/entry/tool/diameter") + float(run.profile_values()["work.side_gap_um"])
    assert line(axes, "floor, touched").tolist() == [[-wall_um, 20.0], [wall_um, 20.0]]
    assert line(axes, "wall by the profile's side gap").tolist() == [[wall_um, 0.0], [wall_um, 20.0]]
    assert "truth (simulated)" not in axes.get_legend_handles_labels()[1]
    told = "\n".join(texts(section.draw, path))
    assert "20.0 ± 0.4 µm" in told
    assert "side gap by the profile 5.0 µm" in told
    assert "depth × " in told  # 20 µm deep and wide as the tool: not to scale, and said so


def test_the_true_hole_is_a_line_of_its_own_with_gap_taper_and_corner(tmp_path: Path) -> None:
    path = a_hole(tmp_path, summary=TRUTH)
    (axes,) = panels(path)
    with open_run(path) as run:
        radius_um = 0.5 * run.number("/entry/tool/diameter")
    outline = line(axes, "truth (simulated)")
    assert outline[0] == pytest.approx([radius_um + 10.0, 0.0])
    assert outline[-1] == pytest.approx([-radius_um - 10.0, 0.0])
    assert outline[1] == pytest.approx([radius_um + 7.0, 17.9])
    assert outline[:, 1].max() == pytest.approx(20.4)
    assert np.abs(outline[outline[:, 1] > 20.39, 0]).max() < radius_um + 7.0 - 2.0
    told = "\n".join(texts(section.draw, path))
    assert "truth: side gap 7.0 µm" in told
    assert "taper 3.0 µm, corner 2.5 µm" in told


def test_the_working_gap_is_between_the_floor_and_where_the_tip_sparked(tmp_path: Path) -> None:
    path = a_hole(tmp_path, summary='{"sites": [{"name": "NAME", "working_gap_um": 3.25}]}')
    (axes,) = panels(path)
    assert line(axes, "tip while sparking")[:, 1].tolist() == [16.75, 16.75]
    assert "working gap 3.2 µm" in texts(section.draw, path)


@pytest.mark.parametrize(
    ("basis", "label", "number"),
    [
        (Basis.ESTIMATED, "floor, estimated", "~20.0 ± 0.4 µm"),
        (Basis.MODEL, "floor, touched, by the actuator's model", "≈20.0 ± 0.4 µm"),
    ],
)
def test_what_was_not_touched_with_a_sensor_is_said(
    tmp_path: Path, basis: Basis, label: str, number: str
) -> None:
    path = a_hole(tmp_path, depth_basis=basis)
    assert label in panels(path)[0].get_legend_handles_labels()[1]
    assert number in "\n".join(texts(section.draw, path))


def test_a_hole_through_the_sheet_has_no_floor(tmp_path: Path) -> None:
    writer = made_up.new_run(tmp_path)
    writer.append(replace(a_site_row(), depth_um=np.nan, beyond_exit_um=80.0, wear_um=200.0, through=True))
    path = writer.finish("done", 0)
    (axes,) = panels(path)
    assert not [name for name in axes.get_legend_handles_labels()[1] if name.startswith("floor")]
    assert line(axes, "wall by the profile's side gap")[:, 1].tolist() == [0.0, 1000.0]
    assert "beyond" in "\n".join(texts(section.draw, path))


def test_of_many_holes_the_last_three_are_drawn_and_counted(tmp_path: Path) -> None:
    writer = made_up.new_run(tmp_path)
    for k in range(5):
        writer.append(replace(a_site_row(), name=f"hole-{k}"))
    titles = [axes.get_title() for axes in panels(writer.finish("done", 0))]
    expected = [f"({letter}) hole-{k} ({k + 1} of 5)" for letter, k in zip("abc", (2, 3, 4), strict=True)]
    assert [title.split(",")[0] for title in titles] == expected


def test_the_figure_of_one_hole_is_as_high_as_it_needs(tmp_path: Path) -> None:
    heights = []
    for depth_um in (60.0, 180.0, 500.0):
        writer = made_up.new_run(tmp_path, name=f"{depth_um}.h5")
        writer.append(replace(a_site_row(), depth_um=depth_um, wear_um=0.3 * depth_um))
        with open_run(writer.finish("done", 0)) as run, house_style():
            heights.append(float(section.draw(run).get_size_inches()[1]) * 25.4)
    assert min(heights) + 3.0 < max(heights) < 115.0


@pytest.mark.parametrize(
    ("ratio", "scale"), [(1.0, 1.0), (0.5, 1.0), (0.2, 5.0), (0.01, 50.0), (3.0, 0.2), (30.0, 0.05)]
)
def test_what_is_flat_or_deep_is_stretched_by_a_round_number(ratio: float, scale: float) -> None:
    assert section.scale_of(ratio) == scale


def test_without_a_depth_or_with_a_channel_the_remedy_is_told(tmp_path: Path) -> None:
    empty = made_up.new_run(tmp_path, name="empty.h5").finish("done", 0)
    assert "first measuring stop" in nothing(section.draw, empty)
    square = {
        "path": {"kind": "rectangle", "x_um": 500.0, "y_um": 100.0, "width_um": 200.0, "height_um": 100.0}
    }
    channel = made_up.new_run(tmp_path, square, name="channel.h5").finish("done", 0)
    assert "--kind channel" in nothing(section.draw, channel)
