"""Numbers as people read them, with the marks of estimated values, which are the same wherever they are shown."""

from __future__ import annotations

import math

import pytest

from edmctl.labels import basis_of, heading, marked, meanings
from edmctl.wording import (
    UNKNOWN,
    about,
    coordinates,
    count,
    decimal,
    duration,
    escaped,
    facts,
    iso_of,
    length,
    named_with_unit,
    percent,
    printable,
    removal_rate,
    signed,
    significant,
    start_utc,
    utc_of,
    with_u95,
)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (decimal(-0.001), "0.00"),
        (decimal(-1.5, 1), "−1.5"),
        (with_u95(1.0, 0.25), "1.00 ± 0.25"),
        (with_u95(1.0, math.nan), "1.00"),
        (with_u95(math.nan, 0.2), UNKNOWN),
        (length(12.345, 0.5), "12.35 ± 0.50 µm"),
        (length(math.nan, 0.5), UNKNOWN),
        (signed(0.24), "+0.24"),
        (signed(-0.13), "−0.13"),
        (signed(-0.001), "0.00"),
        (signed(math.nan), UNKNOWN),
        (coordinates(-5000.0, -0.2), "(−5000, 0) µm"),
        (percent(0.0294, 2), "2.94 %"),
        (percent(math.nan), UNKNOWN),
        (count(1981705), "1 981 705"),
        (count(1981705, "\u202f"), "1\u202f981\u202f705"),
        (significant(6.8e-4), "6.80·10⁻⁴"),
        (significant(0.0), "0"),
        (removal_rate(8.01e-4), "0.801 × 10⁻³ mm³/min"),
        (removal_rate(math.nan), UNKNOWN),
        (about(153.06, 6.5), "about 153.1 ± 6.5 µm (estimated)"),
        (named_with_unit("jump.height_um", "um"), "jump.height_um"),
        (named_with_unit("limits.max_time_s", "s"), "limits.max_time_s"),
        (named_with_unit("pulse.current_a", "A"), "pulse.current_a"),
        (named_with_unit("flush.max_temp_c", "degC"), "flush.max_temp_c"),
        (named_with_unit("flush.min_flow_lpm", "L/min"), "flush.min_flow_lpm"),
        (named_with_unit("servo.gain", "um/s"), "servo.gain, um/s"),
        (escaped("a\nb\x1b[2J"), r"a\nb\x1b[2J"),
        (duration(902.4), "15 min 02 s"),
        (duration(math.inf), UNKNOWN),
        (printable("a\x1b[2Jb"), "a?[2Jb"),
    ],
)
def test_a_number_is_written_in_one_way(text: str, expected: str) -> None:
    assert text == expected


def test_a_result_is_told_in_words_with_units() -> None:
    result = {
        "kind": "spark gap",
        "travel_s": 65.257,
        "actuator_v": 21.9425,
        "reference": {"z1_um": 49.499, "z1_model_um": 48.47, "touches": 3, "sd_um": None},
        "removal_um3_per_uj": -1.25,
        "feed_um_s": 0.5,
        "z3_before_um": 53.281,
        "wear_um": 3.468,
        "wear_u95_um": 0.991,
        "wear_model_um": 4.29,
        "summary": {"height_mean_um": 63.86},
        "calibration": {"alone": False},
        "link": {"frames_sent": 1},
        "time_s": 80.6,
        "sites": [1],
    }
    assert list(facts(result)) == [
        ("kind", "spark gap"),
        ("travel", "65.26 s"),
        ("actuator", "21.94 V"),
        ("reference, Z1", "49.50 µm"),
        ("reference, Z1 from voltage", "48.47 µm"),
        ("reference, touches", "3"),
        ("removal", "−1.25 µm³/µJ"),
        ("feed", "0.5 µm/s"),
        ("Z3 before", "53.28 µm"),
        ("wear", "3.47 ± 0.99 µm"),
        ("wear from voltage", "4.29 µm"),
        ("height mean", "63.86 µm"),
    ]


@pytest.mark.parametrize(
    ("name", "depth", "wear", "basis"),
    [
        ("depth_um", "touched", "estimated", "touched"),
        ("wear_um", "touched", "estimated", "estimated"),
        ("feed_um", "touched", "estimated", "estimated"),
        ("wear_ratio_lin", "touched", "model", "model"),
        ("mrr_mm3_min", "estimated", "touched", "estimated"),
        ("depth_um", None, "touched", ""),
        ("feed_um", None, "touched", "touched"),
    ],
)
def test_what_follows_from_depth_and_wear_has_the_weaker_basis(
    name: str, depth: str | None, wear: str, basis: str
) -> None:
    assert basis_of(name, depth, wear) == basis


def test_a_value_is_marked_unless_it_is_unknown_or_its_heading_states_the_basis() -> None:
    assert heading((None, "touched")) == "measured"
    assert heading(("estimated", "touched")) == "result"
    assert marked("1.0", "estimated") == "~1.0"
    assert marked("–", "estimated") == "–"
    assert marked("1.0", "estimated", "estimated") == "1.0"
    assert marked("1.0", None) == "1.0"
    assert meanings(("estimated", "estimated"), "estimated") == []


@pytest.mark.parametrize("time_s", [3e11, -1e13, float("inf"), float("nan"), 1e300])
def test_the_time_of_a_file_may_be_anything(time_s: float) -> None:
    assert iso_of(time_s) == ""
    assert iso_of(0.0) == "1970-01-01T00:00:00.000+00:00"


@pytest.mark.parametrize("text", ["0001-01-01T00:00:00+23:00", "9999-12-31T23:59:59-23:00", "never", ""])
def test_a_start_that_is_no_time_is_shown_as_it_is(text: str) -> None:
    assert utc_of(text) is None
    assert start_utc(text) in {text, "–"}
