"""Figures as they are written: their text lies within the canvas, which `conftest.py` checks for every figure."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from edmctl.labels import Basis
from edmctl.record.reader import open_run
from edmctl.record.rows import Summary
from edmctl.report.figures import section
from edmctl.report.kinds import KINDS, draw
from edmctl.report.style import Block, NothingToDraw, house_style, panels, rendered
from tests.record.samples import a_site_row
from tests.report import made_up
from tests.report.test_figure_section import TRUTH, a_hole

if TYPE_CHECKING:
    from pathlib import Path

pytest.importorskip("matplotlib")


@pytest.mark.parametrize(
    "fixture",
    ["run_file", "held_run_file", "full_run_file", "array_run_file", "faulted_run_file", "channel_run_file"],
)
def test_every_kind_of_figure_of_a_run_keeps_its_text(fixture: str, request: pytest.FixtureRequest) -> None:
    drawn = []
    with open_run(request.getfixturevalue(fixture)) as run, house_style():
        for kind in KINDS:
            try:
                figure = draw(kind, run)
            except NothingToDraw:
                continue
            drawn.append(kind.name)
            assert rendered(figure, ".png")
    assert len(drawn) >= 4


@pytest.mark.parametrize("depth_um", [1.5, 20.0, 400.0])
@pytest.mark.parametrize("count", [1, 3])
def test_a_section_keeps_its_text_at_every_depth(tmp_path: Path, count: int, depth_um: float) -> None:
    writer = made_up.new_run(tmp_path)
    row = replace(a_site_row(), depth_um=depth_um, wear_um=0.4 * depth_um)
    row = replace(row, depth_basis=Basis.MODEL, wear_basis=Basis.MODEL)
    rows = [replace(row, name=f"hole-{number}") for number in range(count)]
    for one in rows:
        writer.append(one)
    truths = [json.loads(TRUTH.replace("NAME", one.name))["sites"][0] for one in rows]
    writer.append(Summary(json.dumps({"sites": truths})))
    with open_run(writer.finish("done", 0)) as run, house_style():
        assert rendered(section.draw(run), ".png")


@pytest.mark.parametrize("corner_um", [0.0, 2.5, 30.0])
def test_the_tool_lies_within_the_true_hole(tmp_path: Path, corner_um: float) -> None:
    path = a_hole(tmp_path, summary=TRUTH.replace('"corner_um": 2.5', f'"corner_um": {corner_um}'))
    with open_run(path) as run:
        ((one,), _) = section._sections(run)
    hole = one.true_outline()
    assert hole is not None
    for across_um, depth_um in one.tool_tip():
        wall = hole[: len(hole) // 2]
        assert abs(across_um) <= np.interp(depth_um, wall[:, 1], wall[:, 0]) + 1e-9


@pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf"])
def test_text_that_leaves_the_canvas_is_found(suffix: str) -> None:
    with house_style():
        figure, (axes,) = panels(Block("x (s)", {"y (V)": 1.0}))
        rendered(figure, suffix)
        axes.set_title("far too many words for a figure of one column, and some more of them", loc="right")
        with pytest.raises(AssertionError):
            rendered(figure, suffix)
