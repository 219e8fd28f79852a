"""The figure of a channel: its size, its words, and that it shows what it is given."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np
import pytest

from edmctl.process.channel import circle
from edmctl.record.rows import TruthMap
from edmctl.report.figures.channel import Channel, channel_figure
from edmctl.report.style import house_style, rendered

pytest.importorskip("matplotlib")

PATH_UM = circle(0.0, 0.0, 100.0)


def channel(floor_um: float = 20.0) -> Channel:
    x_um = np.arange(-140.0, 141.0, 5.0)
    xs, ys = np.meshgrid(x_um, x_um)
    depth_um = np.where(np.abs(np.hypot(xs, ys) - 100.0) < 30.0, floor_um, 0.0)
    return Channel(TruthMap(x_um, x_um, depth_um), PATH_UM, np.array([[50.0, 20.3]]), 0.4, 20.0, 2.0)


def picture(shown: Channel, suffix: str) -> bytes:
    with house_style():
        return rendered(channel_figure(shown), suffix)


def texts_of(svg: bytes) -> list[str]:
    return [(e.text or "").strip() for e in ET.fromstring(svg).iter("{http://www.w3.org/2000/svg}text")]


def test_axes_have_units_and_everything_drawn_its_name() -> None:
    texts = texts_of(picture(channel(), ".svg"))
    for text in (
        "x (µm)",
        "y (µm)",
        "depth − target, simulated truth (µm)",
        "length along the path (mm)",
        "depth of the floor (µm)",
        "planned path of the tool's axis",
        "start",
        "target 20 ± 2 µm",
        "floor on the path, simulated truth",
        "touched by the tool, 95 % of the mean",
    ):
        assert text in texts


@pytest.mark.slow
def test_another_floor_is_another_picture_and_the_same_the_same_bytes() -> None:
    assert picture(channel(), ".png") == picture(channel(), ".png")
    assert picture(channel(), ".png") != picture(channel(21.0), ".png")


def test_a_floor_far_from_the_target_is_still_within_the_axes() -> None:
    ticks = [
        float(t.replace("\N{MINUS SIGN}", "-"))
        for t in texts_of(picture(channel(31.0), ".svg"))
        if t.isdigit()
    ]
    assert any(tick in range(29, 33) for tick in ticks)


def test_colours_are_symmetric_about_the_target_and_the_rim_has_none() -> None:
    with house_style():
        axes = channel_figure(channel(21.0)).axes[0]
    (image,) = axes.get_images()
    assert image.get_clim() == (-2.0, 2.0)
    array = image.get_array()
    assert array is not None
    shown = np.ma.filled(array, np.nan)
    assert np.isfinite(shown).any()
    assert not np.isfinite(shown[[0, -1]]).any()
    assert float(np.nanmin(shown)) >= -2.0
