"""The closing table of a job."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import pytest

from edmctl.cli.render.result_table import render_job
from edmctl.cli.render.terminal import Style
from edmctl.labels import Basis, Seen
from edmctl.results.job import Belief, SiteResult
from tests.cli.render.views import CHANNEL_TRUTH, TRUTH, made_channel, made_job, made_site


def words_of(text: str) -> str:
    return " ".join(text.split())


def of_one(**changes: object) -> str:
    """The table of a job with one hole, without what lays it out."""
    return words_of(render_job(made_job(sites=(made_site(**changes),))))


def test_measured_modelled_and_true_values_stand_side_by_side() -> None:
    sites = (made_site(), made_site(name="site 2"))
    text = render_job(made_job(sites=sites), [TRUTH, TRUTH])
    lines = text.splitlines()
    assert [words_of(line) for line in lines[:4]] == [
        "site 1 measured from voltage truth",
        "depth 180.21 ± 0.62 µm 180.94 ± 1.60 µm 180.05 µm",
        "tool wear 70.03 ± 0.55 µm 70.41 ± 2.10 µm 70.11 µm",
        "feed 250.24 µm 250.16 µm",
    ]
    assert lines[3].index("250.16") == lines[1].index("180.05")
    assert {line.index("µm") for line in lines[1:3]} == {lines[1].index("µm")}
    assert text.index("site 1") < text.index("site 2")
    assert text.count("Z2 bottom") == 2
    assert "15 min 02 s in 3 cuts" in text
    assert "2 010 334: 50.00 % open, 40.00 % normal, 2.00 % arc, 8.00 % short" in words_of(text)
    assert "Whole job 19 min 01 s; the tool is 70.03 µm shorter." in text
    assert "truth" not in render_job(made_job())


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"face_um": 1.5}, "face below the pad 1.50 µm"),
        ({"depth_um": math.nan, "depth_u95_um": math.nan}, "depth – 180.94"),
        ({"feed_u95_um": 0.81}, "feed 250.24 ± 0.81 µm"),
        ({"estimated_um": 12.3}, "the last 12.30 µm were not touched"),
        ({"verdict": "not shown"}, "verdict not shown"),
    ],
)
def test_a_row_of_one_hole(changes: dict[str, object], words: str) -> None:
    assert words in of_one(**changes)
    for absent in ("face below", "not touched", "verdict"):
        assert absent not in of_one(face_um=0.001)


def test_lengths_by_the_model_alone_stand_there_once() -> None:
    alone = {"depth_model_um": 180.21, "wear_model_um": 70.03}
    assert "from voltage" not in of_one(depth_basis="model", wear_basis="model", **alone)


def test_many_sites_make_a_table_with_a_line_each() -> None:
    sites = tuple(made_site(name=f"grid-{i}") for i in range(1, 10))
    wide, usual, narrow = (
        render_job(made_job(sites=sites), [TRUTH] * 9, columns=columns).splitlines()[:10]
        for columns in (120, None, 60)
    )
    assert words_of(usual[0]) == "site depth µm tool wear µm feed µm stops machining true µm"
    assert [line.split()[0] for line in usual[1:]] == [site.name for site in sites]
    assert "feed µm" in wide[0]
    assert words_of(narrow[0]) == "site depth µm tool wear µm true µm"
    assert max(map(len, usual)) <= 80
    assert max(map(len, narrow)) <= 60
    assert "truth" not in render_job(made_job(sites=sites))


def test_a_line_of_many_sites_marks_what_was_not_touched_or_missed() -> None:
    estimated = made_site(name="b", depth_basis="estimated", wear_basis="estimated")
    sites = (made_site(name="a"), estimated, made_site(name="c", verdict="missed"))
    text = render_job(made_job(sites=sites), columns=120)
    rows = {line.split()[0]: line for line in text.splitlines()[1:4]}
    for marked in ("~180.21 ± 0.62", "~70.03 ± 0.55", "~250.24"):
        assert marked in rows["b"]
    assert "~" not in rows["a"]
    assert rows["c"].endswith("missed")
    assert "~ estimated by feed and energy, not touched." in text


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


def test_a_channel_has_its_floor_and_what_is_true_of_it() -> None:
    text = render_job(made_job(sites=(), channel=made_channel()), (), channel_truth=CHANNEL_TRUTH)
    assert "25.10 ± 0.60 µm" in text
    assert "24.70 µm" in text
    assert re.search(r"floor, rms about its mean +0\.\d\d µm +0\.81 µm", text)
    assert "12 layers in 19 passes" in text
    doubtful = render_job(made_job(sites=(), channel=made_channel(verdict="not shown")))
    assert "truth" not in doubtful
    assert "not shown" in doubtful


def test_a_through_hole_has_no_depth_and_no_bottom() -> None:
    beyond = {"beyond_exit_um": 12.3, "beyond_exit_u95_um": 1.2}
    text = of_one(through=True, depth_um=math.nan, depth_u95_um=math.nan, **beyond)
    assert text.startswith("site 1 measured from voltage feed beyond the exit 12.30 ± 1.20 µm")
    assert "Z2 bottom" not in text
    assert "through the sheet" in text


@pytest.mark.parametrize(
    ("changes", "row"),
    [
        pytest.param(
            {"drift_left_u_um": 0.25}, "drift ± 0.49 µm of the wear; see `edmctl measure-drift`", id="costly"
        ),
        pytest.param({"drift_left_u_um": 0.05}, "", id="small"),
        pytest.param({"drift_left_u_um": math.nan}, "", id="unknown"),
        pytest.param({"drift_left_u_um": 0.25, "wear_basis": Basis.MODEL}, "", id="no sensor to correct"),
        pytest.param(
            {"drift_correction_um": 1.5, "drift_left_u_um": 0.1, "drift_by_rests": True},
            "drift 1.50 ± 0.20 µm by the rests, taken off wear and Z values",
            id="corrected",
        ),
        pytest.param(
            {"drift_correction_um": 0.0, "drift_left_u_um": 0.25, "drift_by_rests": True},
            "drift nothing taken off: touches do not see it; ± 0.49 µm left",
            id="touches do not see it",
        ),
    ],
)
def test_drift_in_the_wear_of_a_hole_is_a_row(changes: dict[str, object], row: str) -> None:
    lines = render_job(made_job(sites=(made_site(**changes),))).splitlines()
    assert next((words_of(line) for line in lines if line.startswith("drift")), "") == row


def test_drift_in_the_wear_of_many_holes_is_one_sentence() -> None:
    def told(*sites: SiteResult) -> str:
        return words_of(render_job(made_job(sites=sites)))

    costly = tuple(made_site(name=f"hole-{i}", drift_left_u_um=0.2 + 0.01 * i) for i in range(5))
    assert "Drift: up to ± 0.47 µm of the wear; see `edmctl measure-drift`." in told(*costly)
    corrected = [
        replace(s, drift_correction_um=-0.5 - s.drift_left_u_um, drift_by_rests=True) for s in costly
    ]
    assert "Wear is corrected by the rests, for a drift of −0.74 µm at most." in told(*corrected)
    unseen = told(*(replace(site, drift_correction_um=0.0, drift_by_rests=True) for site in costly))
    assert "Drift: touches do not see it, nothing is taken off." in unseen
    assert "measure-drift" not in unseen


@pytest.mark.parametrize(
    ("pause_s", "words"), [(125.0, "after a pause of 2 min 05 s"), (math.nan, "after an unknown pause")]
)
def test_a_job_that_was_taken_up_tells_the_time_before_and_the_pause(pause_s: float, words: str) -> None:
    text = render_job(made_job(earlier_time_s=600.0, pause_s=pause_s))
    told = " ".join(text.split())
    assert f"Whole job 19 min 01 s, 10 min 00 s before it was taken up {words}; the tool is" in told
    assert max(map(len, text.splitlines())) <= 80


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


@pytest.mark.parametrize("columns", [40, 60, 80, 120])
def test_a_result_fits_the_terminal_and_loses_nothing(columns: int) -> None:
    style = Style(colour=False, live=True, columns=columns)
    job = replace(made_job(), channel=made_channel())
    said = render_job(job, [TRUTH], style, CHANNEL_TRUTH)
    assert max(map(len, said.splitlines())) <= columns
    words = set(render_job(job, [TRUTH], channel_truth=CHANNEL_TRUTH).split())
    assert words <= set(said.split())
