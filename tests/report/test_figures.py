"""Figures of every kind: their text lies within the canvas, which `conftest.py` checks, and files are repeatable."""

from __future__ import annotations

import importlib.util
import struct

import numpy as np
import pytest

pytest.importorskip("matplotlib")

from pathlib import Path

from edmctl.errors import PreconditionError, UsageError, installing
from edmctl.report import panels
from edmctl.report.figures.comparisons import Trial
from edmctl.report.figures.comparisons import draw_models as draw_trials
from edmctl.report.html import Picture
from edmctl.report.kinds import KINDS, check_figure
from edmctl.report.panels import Block, NothingToDraw, house_style, new_figure, rendered, time_unit
from edmctl.report.signals import broken
from tests.report.drawing import drawn, overlaps, texts, texts_of
from tests.tiers import tiers

T_S = np.arange(4000) / 1000.0
U_V = 60.0 * (1.0 - np.cos(2.0 * np.pi * T_S))


def test_every_figure_of_a_simulated_run_says_so_and_its_caption_names_the_panels(
    pictures: list[Picture],
) -> None:
    drawn_ones = [(picture, picture.figure) for picture in pictures if picture.figure is not None]
    assert len(drawn_ones) >= 9
    for picture, figure in drawn_ones:
        assert "simulated, seed 3" in [text.get_text() for text in figure.texts]
        letters = [axes.get_title(loc="left") for axes in figure.axes]
        if picture.name != "touching":  # its caption names the panels by their place
            assert all(letter in picture.sees for letter in letters if letter.startswith("("))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["full_run", "array_run", "faulted_run", "channel_run"])
def test_every_kind_of_figure_of_a_run_keeps_its_text(name: str, request: pytest.FixtureRequest) -> None:
    path: Path = request.getfixturevalue(f"{name}_file")
    made = 0
    for kind in KINDS:
        try:
            drawn(kind.name, path)
        except NothingToDraw:
            continue
        assert texts(kind.name, path)
        made += 1
    assert made >= 4


@pytest.mark.slow
@pytest.mark.parametrize("kind", [kind.name for kind in KINDS])
def test_no_text_of_a_figure_lies_on_another(kind: str, run_file: Path) -> None:
    try:
        assert not overlaps(drawn(kind, run_file))
    except NothingToDraw:
        pytest.skip("not of this run")


def test_texts_on_each_other_are_found() -> None:
    with house_style():
        figure = new_figure(50.0)
        axes = figure.subplots()
        axes.text(0.5, 0.5, "one")
        axes.text(0.52, 0.5, "another")
    assert overlaps(figure) == [("one", "another")]


@pytest.mark.parametrize("suffix", tiers(".png", slow=(".svg", ".pdf")))
def test_text_that_leaves_the_canvas_is_found(suffix: str) -> None:
    with house_style():
        figure, (axes,) = panels.panels(Block("x (s)", {"y (V)": 1.0}))
        rendered(figure, suffix)
        axes.set_title("far too many words for a figure of one column, and some more of them", loc="right")
        with pytest.raises(AssertionError):
            rendered(figure, suffix)


def trial(title: str = "sine 1 Hz") -> Trial:
    models_um = {"Maxwell, no creep": 3.1 * U_V, "edmctl": 3.01 * U_V}
    return Trial(title, T_S, U_V, 3.0 * U_V, models_um)


@pytest.mark.slow
@pytest.mark.parametrize(("count", "width_mm"), [(1, 85.0), (2, 180.0)])
def test_a_figure_of_waveforms_names_everything_and_fills_a_column_or_a_page(
    count: int, width_mm: float
) -> None:
    trials = [trial("one"), trial("two")][:count]
    (width,) = struct.unpack(">I", draw_trials(trials, "a.png")[16:20])
    assert 25.4 * width / panels.PNG_DPI == pytest.approx(width_mm, abs=0.2)
    shown = texts_of(draw_trials(trials, "a.svg", "simulated, seed 3"))
    axes = {"voltage (V)", "displacement (µm)", "error (µm)", "edmctl error (µm)", "time (s)"}
    assert axes | {"truth", "Maxwell, no creep", "edmctl", "one", "(a)", "simulated, seed 3"} <= shown


@pytest.mark.parametrize(
    ("name", "magic"), tiers(("a.SVG", b"<?xml"), slow=(("a.png", b"\x89PNG"), ("a.pdf", b"%PDF")))
)
def test_the_same_data_give_the_same_bytes(name: str, magic: bytes) -> None:
    first = draw_trials([trial()], name)
    assert first.startswith(magic)
    assert draw_trials([trial()], name) == first


@pytest.mark.parametrize("name", ["a.jpg", "a", "png", "a.csv"])
def test_other_types_of_file_are_refused(name: str) -> None:
    with pytest.raises(UsageError, match="ends in none of") as refused:
        check_figure(name)
    assert refused.value.code == "E2011"


def test_without_matplotlib_the_remedy_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(PreconditionError) as refused:
        check_figure("a.png")
    assert refused.value.hint == f"Install it: {installing('matplotlib')}."


def test_a_long_record_keeps_every_spike_in_few_points_and_a_short_one_all_of_them() -> None:
    t_s = np.arange(1_000_003) / 1000.0
    values = np.sin(t_s)
    values[[0, 123_456, 700_001, 1_000_002]] = 5.0, 9.0, -9.0, 7.0
    line = broken(t_s, values)
    assert line.time_s.size <= 1503
    assert np.all(np.diff(line.time_s[:-1]) > 0.0)
    assert {5.0, 9.0, 7.0} <= set(line.high)
    assert -9.0 in line.low
    for at, shown in ((123.456, line.high == 9.0), (700.001, line.low == -9.0)):
        assert line.time_s[shown] == pytest.approx([at], abs=0.4)
    short = broken(T_S[:2000], U_V[:2000])
    assert short.sampled
    assert np.array_equal(short.time_s[:-1], T_S[:2000])
    assert np.array_equal(short.high[:-1], U_V[:2000])


@pytest.mark.parametrize(("span_s", "label"), [(0.1, "ms"), (1.0, "s"), (900.0, "min"), (28_800.0, "h")])
def test_an_axis_of_time_has_the_unit_of_its_length(span_s: float, label: str) -> None:
    assert time_unit(span_s)[1] == f"time ({label})"
