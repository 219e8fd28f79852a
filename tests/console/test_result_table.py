"""The closing table of a job."""

from __future__ import annotations

import math
from dataclasses import replace

from edmctl.console.result_table import render_job
from tests.console.views import Job, Site, Truth


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
    assert "2 010 334: 50.0 % open, 40.0 % normal, 2.0 % arc, 8.0 % short" in text
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
