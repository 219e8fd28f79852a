"""The closing table of a job."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from edmctl.console.result_table import render_job
from tests.console.views import Channel, ChannelTruth, Job, Site, Truth


def test_measured_modelled_and_true_values_stand_side_by_side() -> None:
    lines = render_job(Job(), [Truth()]).splitlines()
    assert lines[0].split() == ["site", "1", "measured", "from", "voltage", "truth"]
    assert lines[1].split() == ["depth", "180.21", "±", "0.62", "µm", "180.94", "µm", "180.05", "µm"]
    assert lines[2].split() == ["tool", "wear", "70.03", "±", "0.55", "µm", "70.41", "µm", "70.11", "µm"]


def test_hardware_has_no_truth() -> None:
    assert "truth" not in render_job(Job())


def test_time_cuts_pulses_and_tool_are_told() -> None:
    text = render_job(Job(), [Truth()])
    assert "15 min 02 s in 3 cuts" in text
    assert "2 010 334: 50.00 % open, 40.00 % normal, 2.00 % arc, 8.00 % short" in " ".join(text.split())
    assert "Whole job 19 min 01 s; the tool is 70.03 µm shorter." in text


def test_each_site_has_its_block() -> None:
    text = render_job(Job(sites=(Site(), Site(name="site 2"))), [Truth(), Truth()])
    assert text.index("site 1") < text.index("site 2")
    assert text.count("Z2 bottom") == 2


def test_columns_are_aligned() -> None:
    lines = render_job(Job(), [Truth()]).splitlines()[:3]
    assert {line.index("µm") for line in lines[1:]} == {lines[1].index("µm")}


def test_what_was_not_measured_is_a_dash() -> None:
    site = replace(Site(), depth_um=math.nan, depth_u95_um=math.nan)
    assert "depth                –" in render_job(Job(sites=(site,))) or "–" in render_job(Job(sites=(site,)))


def test_many_sites_make_a_table_with_a_line_each() -> None:
    sites = tuple(Site(name=f"grid-{i}") for i in range(1, 10))
    lines = render_job(Job(sites=sites), [Truth()] * 9).splitlines()
    assert lines[0].split() == [
        "site",
        "depth",
        "µm",
        "tool",
        "wear",
        "µm",
        "feed",
        "µm",
        "stops",
        "machining",
        "true",
        "µm",
    ]
    assert max(map(len, lines)) <= 80
    assert [line.split()[0] for line in lines[1:10]] == [site.name for site in sites]
    assert "truth" not in render_job(Job(sites=sites))


def test_a_wide_terminal_shows_all_columns_and_a_narrow_one_the_results() -> None:
    sites = tuple(Site(name=f"grid-{i}") for i in range(1, 10))
    wide, narrow = (
        render_job(Job(sites=sites), [Truth()] * 9, columns=columns).splitlines() for columns in (120, 60)
    )
    assert "feed µm" in wide[0]
    assert narrow[0].split() == ["site", "depth", "µm", "tool", "wear", "µm", "true", "µm"]
    assert max(map(len, narrow[:10])) <= 60


def test_no_line_of_a_result_is_wider_than_a_terminal() -> None:
    text = render_job(Job(sites=(Site(estimated_um=12.3, through=True),)), [Truth()])
    assert max(map(len, text.splitlines())) <= 80
    assert "8.00 % short" in " ".join(text.split())


def test_a_depth_that_was_not_touched_at_the_end_says_so() -> None:
    text = render_job(Job(sites=(Site(estimated_um=12.3),)))
    assert "the last 12.30 µm were not touched" in " ".join(text.split())
    assert "not touched" not in render_job(Job())


def test_a_channel_has_its_floor_and_what_is_true_of_it() -> None:
    text = render_job(Job(sites=(), channel=Channel()), (), channel_truth=ChannelTruth())
    assert "25.10 ± 0.60 µm" in text
    assert "24.70 µm" in text
    assert "0.81 µm from the target" in text
    assert "12 layers in 19 passes" in text
    assert "truth" not in render_job(Job(sites=(), channel=Channel()))


@pytest.mark.parametrize(
    ("pause_s", "words"), [(125.0, "after a pause of 2 min 05 s"), (math.nan, "after an unknown pause")]
)
def test_a_job_that_was_taken_up_tells_the_time_before_and_the_pause(pause_s: float, words: str) -> None:
    text = render_job(Job(earlier_time_s=600.0, pause_s=pause_s))
    told = " ".join(text.split())
    assert f"Whole job 19 min 01 s, 10 min 00 s before it was taken up {words}; the tool is" in told
    assert max(map(len, text.splitlines())) <= 80


def test_a_through_hole_has_a_tip_below_the_face_and_no_bottom() -> None:
    text = render_job(Job(sites=(Site(through=True),)))
    assert "tip below the face" in text
    assert "Z2 bottom" not in text
    assert "through the sheet" in text
