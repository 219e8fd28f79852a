"""The closing table of a job."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import pytest

from edmctl.cli.render.result_table import render_job
from edmctl.cli.render.style import Style
from edmctl.labels import Basis, Seen
from edmctl.results.job import Belief
from tests.cli.render.views import CHANNEL_TRUTH, TRUTH, made_channel, made_job, made_site


def test_measured_modelled_and_true_values_stand_side_by_side() -> None:
    lines = render_job(made_job(), [TRUTH]).splitlines()
    assert lines[0].split() == ["site", "1", "measured", "from", "voltage", "truth"]
    assert " ".join(lines[1].split()) == "depth 180.21 ± 0.62 µm 180.94 ± 1.60 µm 180.05 µm"
    assert " ".join(lines[2].split()) == "tool wear 70.03 ± 0.55 µm 70.41 ± 2.10 µm 70.11 µm"
    assert lines[3].split() == ["feed", "250.24", "µm", "250.16", "µm"]
    assert lines[3].index("250.16") == lines[1].index("180.05")


def test_hardware_has_no_truth() -> None:
    assert "truth" not in render_job(made_job())


def test_time_cuts_pulses_and_tool_are_told() -> None:
    text = render_job(made_job(), [TRUTH])
    assert "15 min 02 s in 3 cuts" in text
    assert "2 010 334: 50.00 % open, 40.00 % normal, 2.00 % arc, 8.00 % short" in " ".join(text.split())
    assert "Whole job 19 min 01 s; the tool is 70.03 µm shorter." in text


def test_each_site_has_its_block() -> None:
    text = render_job(made_job(sites=(made_site(), made_site(name="site 2"))), [TRUTH, TRUTH])
    assert text.index("site 1") < text.index("site 2")
    assert text.count("Z2 bottom") == 2


def test_a_face_at_another_height_makes_the_rows_add_up() -> None:
    below = render_job(made_job(sites=(made_site(face_um=1.5),)))
    assert "face below the pad 1.50 µm" in " ".join(below.split())
    assert "face below" not in render_job(made_job(sites=(made_site(face_um=0.001),)))


def test_columns_are_aligned() -> None:
    lines = render_job(made_job(), [TRUTH]).splitlines()[:3]
    assert {line.index("µm") for line in lines[1:]} == {lines[1].index("µm")}


def test_what_was_not_measured_is_a_dash() -> None:
    site = replace(made_site(), depth_um=math.nan, depth_u95_um=math.nan)
    assert "depth                –" in render_job(made_job(sites=(site,))) or "–" in render_job(
        made_job(sites=(site,))
    )


def test_many_sites_make_a_table_with_a_line_each() -> None:
    sites = tuple(made_site(name=f"grid-{i}") for i in range(1, 10))
    lines = render_job(made_job(sites=sites), [TRUTH] * 9).splitlines()
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
    assert "truth" not in render_job(made_job(sites=sites))


def test_a_wide_terminal_shows_all_columns_and_a_narrow_one_the_results() -> None:
    sites = tuple(made_site(name=f"grid-{i}") for i in range(1, 10))
    wide, narrow = (
        render_job(made_job(sites=sites), [TRUTH] * 9, columns=columns).splitlines() for columns in (120, 60)
    )
    assert "feed µm" in wide[0]
    assert narrow[0].split() == ["site", "depth", "µm", "tool", "wear", "µm", "true", "µm"]
    assert max(map(len, narrow[:10])) <= 60


def test_no_line_of_a_result_is_wider_than_a_terminal() -> None:
    text = render_job(made_job(sites=(made_site(estimated_um=12.3, through=True),)), [TRUTH])
    assert max(map(len, text.splitlines())) <= 80
    assert "8.00 % short" in " ".join(text.split())


def test_a_depth_that_was_not_touched_at_the_end_says_so() -> None:
    text = render_job(made_job(sites=(made_site(estimated_um=12.3),)))
    assert "the last 12.30 µm were not touched" in " ".join(text.split())
    assert "not touched" not in render_job(made_job())


def test_what_was_not_touched_does_not_stand_under_measured() -> None:
    def first_lines(depth_basis: str, wear_basis: str) -> str:
        site = made_site(depth_basis=depth_basis, wear_basis=wear_basis)
        return "\n".join(render_job(made_job(sites=(site,))).splitlines()[:3])

    assert "measured" in first_lines("touched", "touched")
    assert "measured" not in first_lines("estimated", "estimated")
    assert "by model" in first_lines("model", "model")
    mixed = first_lines("estimated", "touched")
    assert "measured" not in mixed
    assert "~180.21 ± 0.62 µm" in mixed
    assert "  70.03 ± 0.55 µm" in mixed
    through = made_site(through=True, depth_basis=None, depth_um=math.nan, beyond_exit_um=74.4)
    assert "measured" in render_job(made_job(sites=(through,))).splitlines()[0]
    assert "~" not in render_job(made_job(sites=(through,)))
    assert "~ estimated" in render_job(made_job(sites=(made_site(depth_basis="estimated"),)))


def test_lengths_by_the_model_alone_stand_there_once() -> None:
    alone = made_site(depth_basis="model", wear_basis="model", depth_model_um=180.21, wear_model_um=70.03)
    assert "from voltage" not in render_job(made_job(sites=(alone,)))
    text = render_job(made_job())
    assert "from voltage" in text
    assert "180.94 ± 1.60 µm" in text
    assert "70.41 ± 2.10 µm" in text


def test_a_line_of_many_sites_marks_what_was_not_touched() -> None:
    sites = (
        made_site(name="a"),
        made_site(name="b", depth_basis="estimated", wear_basis="estimated"),
        made_site(name="c"),
    )
    text = render_job(made_job(sites=sites))
    rows = {line.split()[0]: line for line in text.splitlines()[1:4]}
    assert "~180.21 ± 0.62" in rows["b"]
    assert "~70.03 ± 0.55" in rows["b"]
    assert "~250.24" in rows["b"]
    assert "~" not in rows["a"]
    assert "~ estimated by feed and energy, not touched." in text


def test_a_depth_that_is_missed_or_not_shown_says_so() -> None:
    assert "verdict" not in render_job(made_job())
    assert "verdict              not shown" in render_job(made_job(sites=(made_site(verdict="not shown"),)))
    many = render_job(
        made_job(sites=(made_site(), made_site(), made_site(name="bad", verdict="missed"))), columns=120
    )
    assert next(line for line in many.splitlines() if line.startswith("bad")).endswith("missed")
    assert "not shown" in render_job(made_job(sites=(), channel=made_channel(verdict="not shown")))


def test_a_channel_has_its_floor_and_what_is_true_of_it() -> None:
    text = render_job(made_job(sites=(), channel=made_channel()), (), channel_truth=CHANNEL_TRUTH)
    assert "25.10 ± 0.60 µm" in text
    assert "24.70 µm" in text
    assert re.search(r"floor, rms about its mean +0\.\d\d µm +0\.81 µm", text)
    assert "12 layers in 19 passes" in text
    assert "truth" not in render_job(made_job(sites=(), channel=made_channel()))


@pytest.mark.parametrize(
    ("pause_s", "words"), [(125.0, "after a pause of 2 min 05 s"), (math.nan, "after an unknown pause")]
)
def test_a_job_that_was_taken_up_tells_the_time_before_and_the_pause(pause_s: float, words: str) -> None:
    text = render_job(made_job(earlier_time_s=600.0, pause_s=pause_s))
    told = " ".join(text.split())
    assert f"Whole job 19 min 01 s, 10 min 00 s before it was taken up {words}; the tool is" in told
    assert max(map(len, text.splitlines())) <= 80


def test_a_through_hole_has_no_depth_and_no_bottom() -> None:
    site = made_site(
        through=True, depth_um=math.nan, depth_u95_um=math.nan, beyond_exit_um=12.3, beyond_exit_u95_um=1.2
    )
    text = render_job(made_job(sites=(site,)))
    assert "feed beyond the exit" in text
    assert "12.30 ± 1.20 µm" in text
    assert not any(line.lstrip().startswith("depth") for line in text.splitlines())
    assert "Z2 bottom" not in text
    assert "through the sheet" in text


def drift_row(**changes: float | Basis | bool) -> str:
    """What the table says of drift in a hole whose wear is known within 0.55 µm."""
    lines = render_job(made_job(sites=(made_site(**changes),))).splitlines()
    return next((" ".join(line.split()) for line in lines if line.startswith("drift")), "")


def test_what_drift_costs_is_told_with_the_command_that_mends_it() -> None:
    assert drift_row(drift_left_u_um=0.25) == "drift ± 0.49 µm of the wear; see `edmctl measure-drift`"
    assert drift_row(drift_left_u_um=0.05) == ""
    assert drift_row(drift_left_u_um=math.nan) == ""
    assert drift_row(drift_left_u_um=0.25, wear_basis=Basis.MODEL) == ""


def test_what_was_corrected_and_what_is_left_is_told() -> None:
    row = drift_row(drift_correction_um=1.5, drift_left_u_um=0.1, drift_by_rests=True)
    assert row == "drift 1.50 ± 0.20 µm by the rests, taken off wear and Z values"


def test_a_drift_that_touches_do_not_see_is_told_and_no_command_that_was_given_already() -> None:
    """A share of 0: the rests are known, and nothing of what they show is in the wear."""
    unseen = made_site(drift_correction_um=0.0, drift_left_u_um=0.25, drift_by_rests=True)
    row = drift_row(drift_correction_um=0.0, drift_left_u_um=0.25, drift_by_rests=True)
    assert row == "drift nothing taken off: touches do not see it; ± 0.49 µm left"
    many = " ".join(render_job(made_job(sites=(unseen,) * 5)).split())
    assert "Drift: touches do not see it, nothing is taken off." in many
    assert "measure-drift" not in many


def test_drift_in_the_wear_of_many_holes_is_one_sentence() -> None:
    costly = tuple(made_site(name=f"hole-{i}", drift_left_u_um=0.2 + 0.01 * i) for i in range(5))
    text = " ".join(render_job(made_job(sites=costly)).split())
    assert "Drift: up to ± 0.47 µm of the wear; see `edmctl measure-drift`." in text
    mended = tuple(
        replace(site, drift_correction_um=-0.5 - site.drift_left_u_um, drift_by_rests=True) for site in costly
    )
    text = " ".join(render_job(made_job(sites=mended)).split())
    assert "Wear is corrected by the rests, for a drift of -0.74 µm at most." in text.replace("−", "-")


def test_a_contradicted_belief_is_told_with_what_no_run_can_show() -> None:
    drift = Belief("sensor.drift_um_per_s", 0.0017, 0.006, 0.0004, Seen.CONTRADICTED)
    gain = Belief("sensor.gain_u_rel", 0.003, math.nan, math.nan, Seen.NEVER)
    text = " ".join(render_job(made_job(beliefs=(drift, gain))).split())
    assert "The setup believes sensor.drift_um_per_s = 0.0017" in text
    assert "has found 0.00600 ± 0.00078." in text
    assert "has found −0.00600 ± 0.00078." in replace(drift, found=-0.006).message
    assert "No run can show whether sensor.gain_u_rel is right." in text
    held = replace(drift, seen=Seen.HELD)
    assert "believes" not in render_job(made_job(beliefs=(held, gain)))


def test_a_feed_has_an_interval() -> None:
    text = " ".join(render_job(made_job(sites=(made_site(feed_u95_um=0.81),))).split())
    assert "feed 250.24 ± 0.81 µm" in text


@pytest.mark.parametrize("columns", [40, 60, 80, 120])
def test_a_result_fits_the_terminal_and_loses_nothing(columns: int) -> None:
    style = Style(colour=False, live=True, columns=columns)
    job = replace(made_job(), channel=made_channel())
    said = render_job(job, [TRUTH], style, CHANNEL_TRUTH)
    assert max(map(len, said.splitlines())) <= columns
    words = set(render_job(job, [TRUTH], channel_truth=CHANNEL_TRUTH).split())
    assert words <= set(said.split())
