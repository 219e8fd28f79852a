"""Profiles for people: forecasts of a hole, of an array and of a channel, and the list of profiles."""

from __future__ import annotations

from edmctl.cli.render.profile_tables import render_forecast, render_forecasts, render_profiles
from edmctl.cli.render.style import Style
from edmctl.planning.forecast import forecast
from edmctl.planning.rules.load import load_profile, summaries
from edmctl.profile.setup import Setup


def table_of(name: str, *overrides: str) -> dict[str, list[str]]:
    """Rows by their name; the last of a name holds."""
    loaded = load_profile(name, overrides)
    text = render_forecast(name, forecast(loaded.profile, Setup(), loaded.places))
    rows = [line.split("   ") for line in text.splitlines()[1:]]
    return {row[0].strip(): [cell.strip() for cell in row[1:] if cell.strip()] for row in rows}


def test_one_hole_has_no_row_of_holes() -> None:
    table = table_of("cu270")
    assert "holes" not in table
    assert table["depth"] == ["180.00 µm"]
    assert table["tool wear"] == ["70.02 µm"]
    assert table["feed"][1].endswith("µm/s")
    assert table["measuring"][1] == "2 stops"


def test_an_array_tells_its_holes_and_the_wear_of_all() -> None:
    table = table_of("array-3x3")
    assert table["holes"] == ["9"]
    assert table["depth"] == ["20.00 µm", "each"]
    assert table["tool wear"] == ["76.86 µm", "in all"]


def test_places_of_their_own_depths_are_told_as_a_range() -> None:
    sites = "sites=[{x_um=500},{x_um=900,depth_um=12.5},{x_um=1300,depth_um=40}]"
    table = table_of("array-3x3", sites)
    assert table["depth"] == ["12.50 to 40.00 µm"]
    assert table["feed"][1] == "at most"


def test_holes_that_do_not_fit_need_no_stroke_that_there_is_not() -> None:
    table = table_of("array-3x3", "target.depth_um=100", "limits={stroke_v_max=120}", "tool.max_wear_um=400")
    assert table["stroke"] == ["356.04 µm", "for the first 4 holes only"]


def test_a_channel_tells_its_length_layers_and_wear() -> None:
    table = table_of("channel-rectangle")
    assert table["channel"] == ["2000.00 µm", "10 layers"]
    assert table["tool wear"] == ["13.44 µm", "over the whole channel"]
    assert "cut" not in table["machining"][1]


def test_a_hole_through_a_foil_feeds_on_beyond_it() -> None:
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
