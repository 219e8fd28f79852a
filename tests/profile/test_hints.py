"""Hints for values in other units and for characters that look like others."""

from __future__ import annotations

import math

import pytest
from pydantic import ValidationError

from edmctl.errors import ProfileError
from edmctl.profile.diagnose import schema_diagnostics, schema_problems
from edmctl.profile.model import ProfileFile
from edmctl.profile.read import Merged, Source, Sources, apply_overrides, parse
from edmctl.profile.tables import NO_UNIT, split, unit_of
from tests.planning.rules.documents import place_of


def hint_for(table: str, key: str, value: object) -> str:
    """The hint for that key with that value in a table of a profile."""
    data: dict[str, object] = {table: {key: value} | ({"kind": "depth"} if table == "target" else {})}
    with pytest.raises(ValidationError) as caught:
        ProfileFile.model_validate(data)
    problems = schema_problems(caught.value, ProfileFile, data)
    source = Source("x.toml", "")
    (found,) = schema_diagnostics(
        {(table, key): problems[table, key]}, ProfileFile, data, Sources((source,), source)
    )
    return found.hint


@pytest.mark.parametrize(
    ("key", "value", "hint"),
    [
        ("tool.diameter_mm", 0.27, "write diameter_um = 270"),
        ("tool.diameter_um", "0.27 mm", "write diameter_um = 270"),
        ("tool.diameter_um", "0.27 s", "write a number from 20 to 1000 (diameter, µm)"),
        ("pulse.duty", "55 %", "write duty = 0.55"),
        ("pulse.duty", 55, "write a number from 0.05 to 0.85 (on-time over period)"),
        ("pulse.frequency_khz", 2.3, "write frequency_hz = 2300"),
        ("servo.forward_mm_min", 0.3, "write forward_um_s = 5"),
        ("work.removal_mm3_per_j", 1e-4, "write removal_um3_per_uj = 0.1"),
        ("target.depth", 20, "did you mean depth_um?"),
        ("measure.touch", 3, "did you mean touches?"),
    ],
)
def test_a_value_in_another_unit_is_converted(key: str, value: object, hint: str) -> None:
    table, _, name = key.partition(".")
    assert hint_for(table, name, value) == hint


def test_units_are_those_at_the_end_of_keys() -> None:
    assert split("duty_min") == ("duty_min", NO_UNIT)
    assert split("period_min_s")[1].ending == "s"
    assert split("stroke_v_max") == ("stroke_max", unit_of("v"))
    removal, speed = unit_of("um3_per_uj"), unit_of("mm_min")
    assert removal is not None
    assert removal.scale == pytest.approx(1e-12)
    assert speed is not None
    assert math.isclose(speed.scale, 1e-3 / 60.0)


@pytest.mark.parametrize(
    ("written", "hint"),
    [
        ("depth_um = 20um", "write depth_um = 20, without"),
        ("depth = 20 µm # deep", "write depth_um = 20, without"),
        ("depth_um = 0.02 mm", "write depth_um = 20, without"),
        ("duty = 55%", "write duty = 0.55, without"),
        ("depth_um = 2.3kHz", "write a number, without a unit"),
        ("depth_um = 5°", "write a number, without a unit"),
        ("depth_um = 5 %", "write a number, without a unit"),
        ("depth = 5°", "write a number, without a unit"),
        ("frequency = 2.3 kHz", "write frequency_hz = 2300, without"),
        ("forward_um_s = 0.3 mm/min", "write forward_um_s = 5, without"),
        ("depth_um = 2,5", "not a comma: 2.5"),
        ("material = “Cu”", "U+201C (LEFT DOUBLE QUOTATION MARK) is not TOML here: write plain ASCII"),
        ('material = "Cu”', "U+201D (RIGHT DOUBLE QUOTATION MARK) is not TOML here: write plain ASCII"),
        ("material = ″Cu″", "U+2033 (DOUBLE PRIME) is not TOML here: write plain ASCII"),
        ("depth_um = −20", "U+2212 (MINUS SIGN) is not TOML here: write plain ASCII"),
        ("depth_um = –20", "U+2013 (EN DASH) is not TOML here: write plain ASCII"),
        ("depth_um =\u00a020", "U+00A0 (NO-BREAK SPACE) is not TOML here: write plain ASCII"),
        ("depth_um = 20\u200b", "U+200B (ZERO WIDTH SPACE) is not TOML here: write plain ASCII"),
        ("material = Кu", "U+041A (CYRILLIC CAPITAL LETTER KA) is not TOML here: write plain ASCII"),
        ('name = = "3 × 3" # 0.7–0.9', "texts are in quotes"),
    ],
)
def test_a_usual_mistake_of_syntax_is_named_in_files_and_in_overrides(written: str, hint: str) -> None:
    with pytest.raises(ProfileError) as in_file:
        parse(Source("x.toml", f"[target]\n{written}\n"))
    assert hint in in_file.value.hint
    assert place_of(in_file.value)[1] == 2
    if "#" not in written:
        source = Source("x.toml", "")
        with pytest.raises(ProfileError) as in_override:
            apply_overrides(Merged((source,), {}, ()), [f"target.{written}"])
        assert hint in in_override.value.hint
