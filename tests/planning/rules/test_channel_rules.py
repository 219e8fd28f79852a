"""Channels: the keys of each kind, walls that stand, layers thinner than the gap, wear within the stroke."""

from __future__ import annotations

import math

import pytest

from edmctl.failures import Code
from edmctl.planning.channel import EVEN_OUT_PASSES, Channel
from edmctl.planning.forecast import forecast
from edmctl.planning.rules.load import load_profile
from edmctl.process.channel import circle, lengths_um, rectangle, spiral
from edmctl.profile.setup import Setup
from tests.planning.rules.documents import problems

DEEP = ("limits.max_time_s=1e5", "jump.height_um=70")


def codes(name: str, *overrides: str) -> list[str]:
    return [d.code for d in problems(f"channel-{name}", *overrides)]


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


def test_a_job_makes_holes_or_a_channel() -> None:
    assert Code.SITES_OR_PATH in codes("circle", "sites=[{x_um=500}]")


@pytest.mark.parametrize(("speed_um_s", "is_slow"), [(5, True), (41, True), (43, False), (200, False)])
def test_a_scan_slower_than_its_sparks_is_named(speed_um_s: int, is_slow: bool) -> None:
    short = ("limits.max_time_s=1000", f"path.speed_um_s={speed_um_s}")
    (found,) = problems("channel-circle", *short)
    assert found.code == Code.TIME_LIMIT
    assert (f"raise path.speed_um_s from {speed_um_s} to 41.6 µm/s" in found.hint) == is_slow
    assert "three times the forecast" in found.hint


def test_no_scan_takes_less_time_than_one_as_fast_as_its_sparks() -> None:
    least_um_s, *others = (
        forecast(
            load_profile("channel-circle", [f"path.speed_um_s={speed}"]).profile, Setup()
        ).machining_time_s
        for speed in (40, 10, 20, 30)
    )
    assert all(time_s > least_um_s for time_s in others)


def test_a_channel_has_a_depth() -> None:
    assert Code.TARGET_KIND in codes("circle", 'target={kind="feed",feed_um=30}')


@pytest.mark.parametrize(
    ("name", "good", "bad", "key"),
    [
        # tool 150 + 2 x 8 and a wall of 20
        ("spiral", "path.pitch_um=186", "path.pitch_um=185", "pitch_um"),
        ("spiral", "path.radius_um=41", "path.radius_um=40", "radius_um"),
        ("circle", "path.radius_um=93", "path.radius_um=92", "radius_um"),
        ("rectangle", "path.width_um=186", "path.width_um=185", "width_um"),
        ("rectangle", "path.height_um=186", "path.height_um=185", "height_um"),
    ],
)
def test_walls_stand(name: str, good: str, bad: str, key: str) -> None:
    assert codes(name, good) == []
    (found,) = problems(f"channel-{name}", bad)
    assert found.code == Code.OVERLAP
    assert f"path.{key}" in found.message
    assert "186 µm" in found.message


@pytest.mark.parametrize(
    ("name", "good", "bad"),
    [
        # the pad at (0, 0) wants 150 + 8 + 50 around it; sides at x - 300, x - 300 and x - 375
        ("rectangle", ("path.x_um=508",), ("path.x_um=507",)),
        ("rectangle", ("path.x_um=300", "path.y_um=408"), ("path.x_um=300", "path.y_um=407")),
        (
            "rectangle",
            ("path.x_um=0", "path.width_um=416", "path.height_um=420"),
            ("path.x_um=10", "path.width_um=416"),
        ),
        ("circle", ("path.x_um=508",), ("path.x_um=507",)),
        ("circle", ("path.x_um=0",), ("path.x_um=0", "path.radius_um=207")),
        ("spiral", ("path.x_um=584",), ("path.x_um=582",)),
    ],
)
def test_a_channel_keeps_clear_of_the_pad(name: str, good: tuple[str, ...], bad: tuple[str, ...]) -> None:
    assert codes(name, *good) == []
    assert codes(name, *bad) == [Code.OVERLAP]


def test_a_layer_is_thinner_than_the_working_gap() -> None:
    assert codes("circle", "path.layer_um=3.0") == []
    (found,) = problems("channel-circle", "path.layer_um=3.2")
    assert found.code == Code.LAYER
    assert found.is_warning
    assert "3 µm" in found.hint


def test_depth_and_wear_of_the_whole_way_are_within_the_stroke() -> None:
    # 50 + 15 leave 291 µm for 1.634 µm per µm of depth
    assert codes("circle", "target.depth_um=178", *DEEP) == []
    (found,) = problems("channel-circle", "target.depth_um=179", *DEEP)
    assert found.code == Code.STROKE
    assert "113 µm of tool wear over its length" in found.message


def test_copper_wears_too_much_for_a_long_channel() -> None:
    copper = ("tool.material=Cu", "wear.expected_ratio=0.427")
    assert codes("circle", *copper) == []
    assert codes("spiral", *copper, "target.depth_um=25") == [Code.STROKE]


@pytest.mark.parametrize("name", ["rectangle", "circle", "spiral"])
def test_the_length_is_that_of_the_way_that_is_gone(name: str) -> None:
    profile = load_profile(f"channel-{name}").profile
    path = profile.path
    assert path is not None
    points = {
        "rectangle": lambda: rectangle(0, 0, path.width_um or 0, path.height_um or 0),
        "circle": lambda: circle(0, 0, path.radius_um or 0),
        "spiral": lambda: spiral(0, 0, path.radius_um or 0, path.pitch_um or 0, path.turns or 0),
    }[name]()
    assert Channel(profile, path).length_um == pytest.approx(lengths_um(points)[-1], rel=1e-3)


def test_the_wear_of_a_channel_is_that_of_holes_of_its_volume() -> None:
    profile = load_profile("channel-circle").profile
    assert profile.path is not None
    whole = Channel(profile, profile.path)
    volume_um3 = 166.0 * 2.0 * math.pi * 300.0 * 20.0
    assert whole.volume_um3 == pytest.approx(volume_um3)
    tool_um3 = whole.wear_um * math.pi / 4.0 * 150.0**2
    assert tool_um3 / volume_um3 == pytest.approx(0.0438 * (150.0 / 166.0) ** 2)


def test_a_channel_takes_as_long_as_its_layers() -> None:
    loaded = load_profile("channel-circle")
    plain = forecast(loaded.profile, Setup())
    assert (plain.holes, plain.layers) == (0, 10)
    slow = forecast(load_profile("channel-circle", ["path.speed_um_s=5", *DEEP[:1]]).profile, Setup())
    passes = 10 + EVEN_OUT_PASSES * slow.stops
    assert slow.machining_time_s == pytest.approx(passes * plain.channel_um / 5.0, rel=0.02)
    assert slow.stops > plain.stops
    thin = forecast(load_profile("channel-circle", ["path.layer_um=1"]).profile, Setup())
    assert thin.layers == 20


def test_a_fast_scan_passes_a_layer_as_often_as_its_sparks_need() -> None:
    times = [
        forecast(
            load_profile("channel-circle", [f"path.speed_um_s={speed}"]).profile, Setup()
        ).machining_time_s
        for speed in (200, 400)
    ]
    assert times[1] == pytest.approx(times[0], rel=0.1)


def test_a_channel_is_measured_early_before_the_last_layer_and_after_it() -> None:
    loaded = load_profile("channel-circle")
    assert loaded.profile.path is not None
    after = Channel(loaded.profile, loaded.profile.path).stops_after(Setup())
    assert after[0] <= 2
    assert after[-2:] == [9, 10]
