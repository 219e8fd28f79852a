"""Profiles for people: as TOML, forecasts of a hole, of an array and of a channel, and the list of profiles."""

from __future__ import annotations

import tomllib

import pytest

from edmctl.cli.render.profile_tables import render_forecast, render_forecasts, render_profiles, render_toml
from edmctl.cli.render.terminal import Style
from edmctl.planning.forecast import forecast
from edmctl.planning.rules.load import load_profile, summaries
from edmctl.profile.setup import Setup
from edmctl.toml_text import Scalar


def table_of(name: str, *overrides: str) -> dict[str, list[str]]:
    """Rows by their name; the last of a name holds."""
    loaded = load_profile(name, overrides)
    text = render_forecast(name, forecast(loaded.profile, Setup(), loaded.places))
    rows = [line.split("   ") for line in text.splitlines()[1:]]
    return {row[0].strip(): [cell.strip() for cell in row[1:] if cell.strip()] for row in rows}


@pytest.mark.parametrize(
    ("job", "rows"),
    [
        pytest.param(
            ("cu270",), {"depth": ["180.00 µm"], "tool wear": ["70.02 µm"], "holes": None}, id="one hole"
        ),
        pytest.param(
            ("array-3x3",),
            {"holes": ["9"], "depth": ["20.00 µm", "each"], "tool wear": ["76.86 µm", "in all"]},
            id="an array",
        ),
        pytest.param(
            ("array-3x3", "sites=[{x_um=500},{x_um=900,depth_um=12.5},{x_um=1300,depth_um=40}]"),
            {"depth": ["12.50 to 40.00 µm"]},
            id="places with depths of their own",
        ),
        pytest.param(
            ("array-3x3", "target.depth_um=100", "limits={stroke_v_max=120}", "tool.max_wear_um=400"),
            {"stroke": ["356.04 µm", "for the first 4 holes only"]},
            id="holes that the stroke does not reach",
        ),
        pytest.param(
            ("channel-rectangle",),
            {"channel": ["2000.00 µm", "10 layers"], "tool wear": ["13.44 µm", "over the whole channel"]},
            id="a channel",
        ),
    ],
)
def test_a_forecast_has_the_rows_of_its_job(job: tuple[str, ...], rows: dict[str, list[str] | None]) -> None:
    table = table_of(*job)
    assert {name: table.get(name) for name in rows} == rows


def test_remarks_beside_the_values_of_a_forecast() -> None:
    hole = table_of("cu270")
    assert hole["feed"][1].endswith("µm/s")
    assert hole["measuring"][1] == "2 stops"
    assert table_of("array-3x3", "sites=[{x_um=500,depth_um=9},{x_um=900}]")["feed"][1] == "at most"
    assert "cut" not in table_of("channel-rectangle")["machining"][1]
    assert table_of("foil-through")["feed"][0] == "146.35 µm"


def test_the_list_of_profiles_and_a_sweep_fit_a_narrow_terminal() -> None:
    found = summaries(Setup())
    loaded = load_profile("cu270")
    sweep = [(f"servo.reference=0.7{i}", forecast(loaded.profile, Setup(), loaded.places)) for i in range(3)]
    for columns in (None, 80, 70):
        style = Style(colour=False, live=False, columns=columns)
        profiles, forecasts = render_profiles(found, style), render_forecasts(sweep, style)
        assert ("tool wear" in profiles) == ("stroke µm" in forecasts) == (columns is None)
        assert columns is None or max(map(len, [*profiles.splitlines(), *forecasts.splitlines()])) <= columns
        assert "17 min 15 s" in profiles
    assert "…" not in profiles


TABLES: dict[str, dict[str, Scalar]] = {
    "meta": {"schema": 1, "name": 'quote " back \\ tab \t µ'},
    "servo": {"reference": 0.8, "forward_um_s": 5.0, "tiny": 1e-9},
    "flush": {"required": True},
}


def test_shown_toml_loads_again_with_comments_behind_its_keys() -> None:
    assert tomllib.loads(render_toml(TABLES, TABLES, {})) == TABLES
    text = render_toml(TABLES, TABLES, {"servo.reference": "mean gap voltage over its open value"})
    assert "reference = 0.8" in text
    assert "# mean gap voltage over its open value" in text
    assert tomllib.loads(text) == TABLES
