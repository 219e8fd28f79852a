"""Channels: the keys of each kind, walls that stand, layers thinner than the gap, wear within the stroke."""

from __future__ import annotations

import math

import pytest

from edmctl.failures import Code
from edmctl.planning.channel import EVEN_OUT_PASSES, Channel, way_of_path
from edmctl.planning.forecast import forecast
from edmctl.planning.rules.load import load_profile
from edmctl.profile.setup import Setup
from edmctl.results.result import Forecast
from tests.planning.rules.documents import problems

DEEP = "limits.max_time_s=1e5 jump.height_um=70"
COPPER = "tool.material=Cu wear.expected_ratio=0.427"


def channel(name: str) -> Channel:
    profile = load_profile(f"channel-{name}").profile
    assert profile.path is not None
    return Channel(profile, profile.path)


def ahead(*overrides: str) -> Forecast:
    return forecast(load_profile("channel-circle", overrides).profile, Setup())


@pytest.mark.parametrize(
    ("name", "good", "bad", "code", "words"),
    [
        # tool 150 + 2 x 8 and a wall of 20
        ("spiral", "path.pitch_um=186", "path.pitch_um=185", Code.OVERLAP, "path.pitch_um"),
        ("spiral", "path.radius_um=41", "path.radius_um=40", Code.OVERLAP, "path.radius_um"),
        ("circle", "path.radius_um=93", "path.radius_um=92", Code.OVERLAP, "path.radius_um"),
        ("rectangle", "path.width_um=186", "path.width_um=185", Code.OVERLAP, "path.width_um"),
        ("rectangle", "path.height_um=186", "path.height_um=185", Code.OVERLAP, "path.height_um"),
        # the pad at (0, 0) wants 150 + 8 + 50 around it; sides at x - 300, x - 300 and x - 375
        ("rectangle", "path.x_um=508", "path.x_um=507", Code.OVERLAP, "207 µm"),
        ("rectangle", "path.x_um=300 path.y_um=408", "path.x_um=300 path.y_um=407", Code.OVERLAP, "pad"),
        (
            "rectangle",
            "path.x_um=0 path.width_um=416 path.height_um=420",
            "path.x_um=10 path.width_um=416",
            Code.OVERLAP,
            "pad",
        ),
        ("circle", "path.x_um=508", "path.x_um=507", Code.OVERLAP, "207 µm"),
        ("circle", "path.x_um=0", "path.x_um=0 path.radius_um=207", Code.OVERLAP, "207 µm"),
        ("spiral", "path.x_um=584", "path.x_um=582", Code.OVERLAP, "pad"),
        ("circle", "path.layer_um=3.0", "path.layer_um=3.2", Code.LAYER, "3.2 µm is thicker"),
        # 50 + 15 leave 291 µm for 1.634 µm per µm of depth
        (
            "circle",
            f"target.depth_um=178 {DEEP}",
            f"target.depth_um=179 {DEEP}",
            Code.STROKE,
            "113 µm of tool wear over its length",
        ),
        ("spiral", "target.depth_um=25", f"target.depth_um=25 {COPPER}", Code.STROKE, "tool wear"),
        ("circle", COPPER, "sites=[{x_um=500}]", Code.SITES_OR_PATH, "either holes or a channel"),
        ("circle", "path.layer_um=2", 'target={kind="feed",feed_um=30}', Code.TARGET_KIND, "cut to a depth"),
    ],
)
def test_a_channel_keeps_the_rules(name: str, good: str, bad: str, code: Code, words: str) -> None:
    assert problems(f"channel-{name}", *good.split()) == ()
    found = next(d for d in problems(f"channel-{name}", *bad.split()) if d.code == code)
    assert words in found.message
    assert found.is_warning == code.startswith("W")


@pytest.mark.parametrize(
    ("name", "key"),
    [("rectangle", "radius_um"), ("rectangle", "turns"), ("circle", "pitch_um"), ("spiral", "width_um")],
)
def test_a_key_of_another_kind_is_refused_where_it_stands(name: str, key: str) -> None:
    (found,) = problems(f"channel-{name}", f"path.{key}=3")
    assert found.code == Code.PATH_KEYS
    assert f"path.{key} does not go with a {name}" in found.message
    assert found.where is not None
    assert found.where.source_line == f"path.{key}=3"


@pytest.mark.parametrize(
    ("path", "missing"),
    [
        ('{kind="rectangle",x_um=900,width_um=500}', "path.height_um"),
        ('{kind="circle",x_um=900}', "path.radius_um"),
        ('{kind="spiral",x_um=900,radius_um=150,turns=2}', "path.pitch_um"),
    ],
)
def test_a_key_that_the_kind_needs_is_asked_for(path: str, missing: str) -> None:
    (found,) = problems("channel-circle", f"path={path}")
    assert found.code == Code.PATH_KEYS
    assert missing in found.message


@pytest.mark.parametrize(("speed_um_s", "is_slow"), [(5, True), (41, True), (43, False), (200, False)])
def test_a_scan_slower_than_its_sparks_is_named(speed_um_s: int, is_slow: bool) -> None:
    short = ("limits.max_time_s=1000", f"path.speed_um_s={speed_um_s}")
    (found,) = problems("channel-circle", *short)
    assert found.code == Code.TIME_LIMIT
    assert (f"raise path.speed_um_s from {speed_um_s} to 41.6 µm/s" in found.hint) == is_slow
    assert "three times the forecast" in found.hint


@pytest.mark.parametrize("name", ["rectangle", "circle", "spiral"])
def test_the_length_is_that_of_the_way_that_is_gone(name: str) -> None:
    whole = channel(name)
    assert whole.length_um == pytest.approx(way_of_path(whole.path).length_um, rel=1e-3)


def test_the_wear_of_a_channel_is_that_of_holes_of_its_volume() -> None:
    whole, volume_um3 = channel("circle"), 166.0 * 2.0 * math.pi * 300.0 * 20.0
    assert whole.volume_um3 == pytest.approx(volume_um3)
    tool_um3 = whole.wear_um * math.pi / 4.0 * 150.0**2
    assert tool_um3 / volume_um3 == pytest.approx(0.0438 * (150.0 / 166.0) ** 2)


def test_a_channel_takes_as_long_as_its_layers_and_is_measured_early_and_late() -> None:
    plain, slow = ahead(), ahead("path.speed_um_s=5", "limits.max_time_s=1e5")
    assert (plain.holes, plain.layers) == (0, 10)
    passes = 10 + EVEN_OUT_PASSES * slow.stops
    assert slow.machining_time_s == pytest.approx(passes * plain.channel_um / 5.0, rel=0.02)
    assert slow.stops > plain.stops
    assert ahead("path.layer_um=1").layers == 20
    after = channel("circle").stops_after(Setup())
    assert after[0] <= 2
    assert after[-2:] == [9, 10]


def test_a_fast_scan_passes_a_layer_as_often_as_its_sparks_need() -> None:
    times_s = {
        speed: ahead(f"path.speed_um_s={speed}").machining_time_s for speed in (10, 20, 30, 40, 200, 400)
    }
    assert times_s[400] == pytest.approx(times_s[200], rel=0.1)
    assert all(times_s[speed] > times_s[40] for speed in (10, 20, 30))
