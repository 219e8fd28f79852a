"""Places beyond the travel of the stages or beyond the workpiece are refused before anything moves."""

from pathlib import Path

import pytest

from edmctl.errors import ProfileError
from edmctl.failures import Code
from edmctl.planning.rules.load import load_profile
from edmctl.profile.setup import Setup, Stage, Surface, load_setup

SHALLOW = "target.depth_um=5.0"
BOXED = Setup(
    stage=Stage(x_min_um=-9000.0, x_max_um=9000.0, y_min_um=-9000.0, y_max_um=9000.0),
    surface=Surface(x_min_um=-2000.0, x_max_um=2000.0, y_min_um=-2000.0, y_max_um=2000.0),
)


def refused(override: str, setup: Setup | None = None) -> list[tuple[str, str]]:
    try:
        load_profile("cu270", [SHALLOW, override], setup)
    except ProfileError as error:
        return [(one.code, one.message) for one in error.diagnostics if one.where is not None]
    return []


@pytest.mark.parametrize("x_um", [-6000, -5000, -3000, -1900])
def test_a_place_towards_the_parking_place_is_not_on_the_workpiece(x_um: int) -> None:
    (found,) = refused(f"sites=[{{x_um=500}},{{x_um={x_um},y_um=300}}]")
    assert found[0] == Code.OUT_OF_REACH
    assert "2000 µm from the reference pad" in found[1]


@pytest.mark.parametrize("place", ["x_um=-1800", "x_um=49000", "x_um=0,y_um=-49000", "x_um=0,y_um=49000"])
def test_the_other_directions_have_no_edge_unless_the_setup_states_one(place: str) -> None:
    assert refused(f"sites=[{{{place}}}]") == []


@pytest.mark.parametrize(
    ("place", "key"),
    [
        ("x_um=-1900", "surface.x_min_um"),
        ("x_um=1900", "surface.x_max_um"),
        ("x_um=0,y_um=-1900", "surface.y_min_um"),
        ("x_um=0,y_um=1900", "surface.y_max_um"),
        ("x_um=-8960", "stage.x_min_um"),
        ("x_um=9001", "stage.x_max_um"),
        ("x_um=0,y_um=-8960", "stage.y_min_um"),
        ("x_um=0,y_um=9001", "stage.y_max_um"),
    ],
)
@pytest.mark.parametrize("way", ["point", "array", "channel"])
def test_every_edge_is_known_for_points_arrays_and_channels(place: str, key: str, way: str) -> None:
    override = {
        "point": f"sites=[{{{place}}}]",
        "array": f"sites=[{{kind='grid',name='g',{place},columns=2,rows=1,dx_um=400,dy_um=400}}]",
        "channel": f"path={{kind='circle',{place},radius_um=300}}",
    }[way]
    (found,) = refused(override, BOXED)
    assert found[0] == Code.OUT_OF_REACH
    assert f"{key} = " in found[1]


@pytest.mark.parametrize(
    "override", ["sites=[{x_um=-1800}]", "path={kind='circle',x_um=-1540,radius_um=300}"]
)
def test_up_to_the_edge_there_is_work(override: str) -> None:
    assert refused(override, BOXED) == []


@pytest.mark.parametrize("place", ["x_um=500000", "x_um=0,y_um=60000", "x_um=0,y_um=-60000"])
def test_stages_have_a_travel_if_the_setup_states_none(place: str) -> None:
    (found,) = refused(f"sites=[{{{place}}}]")
    assert "50000 µm" in found[1]
    wide = Setup(stage=Stage(x_min_um=-1e6, x_max_um=1e6, y_min_um=-1e6, y_max_um=1e6))
    assert refused(f"sites=[{{{place}}}]", wide) == []


@pytest.mark.parametrize("theta_deg", [0, 1, -5, 180, 360])
def test_the_edges_apply_at_every_angle(theta_deg: int) -> None:
    for x_um, setup in ((-2500, None), (2500, BOXED)):
        (found,) = refused(f"sites=[{{x_um={x_um},theta_deg={theta_deg}}}]", setup)
        assert found[0] == Code.OUT_OF_REACH
    (found,) = refused(f"sites=[{{x_um=20,theta_deg={theta_deg}}}]")
    assert found[0] == Code.OVERLAP
    assert refused(f"sites=[{{x_um=500,theta_deg={theta_deg}}}]") == []


def test_the_single_hole_beside_the_pad_counts_too() -> None:
    ((code, message),) = refused("measure.site_dx_um=3000", BOXED)
    assert code == Code.OUT_OF_REACH
    assert "beside the pad" in message


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[stage]\npark_x_um = 0.0\n", "parking place is over the workpiece"),
        ("[surface]\nx_min_um = -6000.0\n", "parking place is over the workpiece"),
        (
            "[surface]\nx_max_um = 900.0\ny_min_um = -9.0\ny_max_um = 9.0\n",
            "parking place is over the workpiece",
        ),
        (
            "[stage]\nreference_x_um = -2500.0\n[surface]\nx_min_um = -2000.0\n",
            "reference pad is 500 µm beyond",
        ),
        ("[stage]\nx_max_um = -50.0\n", "reference pad is 50 µm beyond the travel"),
        ("[stage]\nx_min_um = -5000.0\n", "parking place is 50 µm beyond the travel"),
        ("[stage]\ny_max_um = 10.0\nreference_y_um = 20.0\n", "reference pad is 10 µm beyond the travel"),
    ],
)
def test_pad_and_parking_place_are_checked_with_the_setup(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "setup.toml"
    path.write_text(text)
    with pytest.raises(ProfileError, match=words) as caught:
        load_setup(path)
    assert {one.code for one in caught.value.diagnostics} == {Code.OUT_OF_REACH}
