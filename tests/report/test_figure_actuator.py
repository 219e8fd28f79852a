"""Figures of the actuator: sizes, types of file, and that they show what they are given."""

from __future__ import annotations

import importlib.util
import struct
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from edmctl.errors import PreconditionError, UsageError, installing
from edmctl.report import style
from edmctl.report.figures.actuator import Trial, draw
from edmctl.report.kinds import check_figure
from edmctl.report.signals import broken
from tests.tiers import tiers

pytest.importorskip("matplotlib")

T_S = np.arange(4000) / 1000.0
U_V = 60.0 * (1.0 - np.cos(2.0 * np.pi * T_S))


def trial(title: str = "sine 1 Hz") -> Trial:
    return Trial(title, T_S, U_V, 3.0 * U_V, 3.1 * U_V, 3.01 * U_V)


def png_size_mm(content: bytes) -> tuple[float, float]:
    assert content[:8] == b"\x89PNG\r\n\x1a\n"
    width, height = struct.unpack(">II", content[16:24])
    return 25.4 * width / style.PNG_DPI, 25.4 * height / style.PNG_DPI


def texts_of(svg: bytes) -> list[str]:
    return [(e.text or "").strip() for e in ET.fromstring(svg).iter("{http://www.w3.org/2000/svg}text")]


@pytest.mark.slow
def test_one_waveform_fills_a_column_of_a_journal_and_several_a_page() -> None:
    assert png_size_mm(draw([trial()], "a.png"))[0] == pytest.approx(85.0, abs=0.2)
    assert png_size_mm(draw([trial(), trial()], "a.png"))[0] == pytest.approx(180.0, abs=0.2)


@pytest.mark.slow
def test_every_axis_has_its_unit_and_every_line_its_name() -> None:
    texts = texts_of(draw([trial("one"), trial("two")], "a.svg", "simulated, seed 3"))
    assert "simulated, seed 3" in texts
    for text in ("voltage (V)", "displacement (µm)", "error (µm)", "edmctl error (µm)", "time (s)"):
        assert text in texts
    for text in ("truth", "Maxwell, no creep", "edmctl", "one", "two", "(a)", "(b)", "(c)", "(d)"):
        assert text in texts


@pytest.mark.parametrize(
    ("name", "magic"), tiers(("a.SVG", b"<?xml"), slow=(("a.png", b"\x89PNG"), ("a.pdf", b"%PDF")))
)
def test_the_same_data_give_the_same_bytes(name: str, magic: bytes) -> None:
    first = draw([trial()], name)
    assert first.startswith(magic)
    assert draw([trial()], name) == first


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


def test_a_long_record_keeps_every_spike_in_few_points() -> None:
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


def test_a_short_record_is_drawn_as_it_is() -> None:
    line = broken(T_S[:2000], U_V[:2000])
    assert line.sampled
    assert np.array_equal(line.time_s[:-1], T_S[:2000])
    assert np.array_equal(line.high[:-1], U_V[:2000])
