"""The schema file is checked, hashed by meaning, and everything made from it is up to date."""

from __future__ import annotations

from pathlib import Path

import pytest

from edmctl.link.faults import FAULTS
from edmctl.link.messages import PARAMS, SCHEMA_HASH
from tools.generate.schema import SCHEMA_PATH, SchemaError, load_schema

SOURCE = SCHEMA_PATH.read_text(encoding="utf-8")


def changed(tmp_path: Path, old: str, new: str) -> Path:
    assert old in SOURCE
    path = tmp_path / "schema.toml"
    path.write_text(SOURCE.replace(old, new, 1), encoding="utf-8")
    return path


def test_the_hash_is_the_recorded_one() -> None:
    assert load_schema().hash == SCHEMA_HASH


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"PIEZO_SET"', '"PIEZO_SETS"'),
        ('["slew_v_s", "u32"', '["slew_v_per_s", "u32"'),
        ('["slew_v_s", "u32"', '["slew_v_s", "u16"'),
        ('"u16", "V", 0.0025', '"u16", "mV", 0.0025'),
        ('"u16", "V", 0.0025', '"u16", "V", 0.005'),
        ("ARC = 2", "ARC = 4"),
        ('[30, "short_stuck_s", "s", 0.001, 3.0', '[30, "short_stuck_s", "s", 0.001, 3.5'),
        (
            '["fault", "u16", "", 1, ""], ["rx_bad"'.replace(", [", ",\n  ["),
            '["rx_bad"',
        ),
    ],
)
def test_the_hash_changes_with_names_types_units_scales_enums_and_parameters(
    tmp_path: Path, old: str, new: str
) -> None:
    if old not in SOURCE:
        pytest.fail(f"the schema no longer holds {old}")
    assert load_schema(changed(tmp_path, old, new)).hash != SCHEMA_HASH


def test_the_hash_changes_with_the_order_of_fields(tmp_path: Path) -> None:
    path = changed(
        tmp_path,
        '["pulse_no", "u32", "", 1, "number of the first pulse"], ["t0_us"',
        '["t0_us"',
    )
    text = path.read_text(encoding="utf-8").replace(
        '["period_ns", "u32"', '["pulse_no", "u32", "", 1, ""], ["period_ns", "u32"', 1
    )
    path.write_text(text, encoding="utf-8")
    assert load_schema(path).hash != SCHEMA_HASH


def test_the_hash_ignores_notes_and_layout_of_the_file(tmp_path: Path) -> None:
    path = changed(tmp_path, 'note = "Text for people."', '\nnote = "For the log."\n')
    assert load_schema(path).hash == SCHEMA_HASH


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("id = 0x10", "id = 0x11", "message id used twice: 17"),
        ("id = 0x10", "id = 0x90", "does not suit its kind"),
        ('"ARM"', '"DISARM"', "message name used twice: DISARM"),
        ('["counter", "u16"', '["counter", "f32"', "unknown type f32"),
        ('"u16", "V", 0.0025', '"u16", "V", 0.003', "not 1/integer"),
        ('[1, "piezo_max_v"', '[2, "piezo_max_v"', "parameter id used twice: 2"),
        ("1000.0, 1.0, 20000.0", "0.5, 1.0, 20000.0", "out of order"),
        ('["level", "u8"', '["level", "utf8"', "text must be the last field"),
        ("max_payload = 246", "max_payload = 40", "payload exceeds 40 bytes"),
        ('["n", "u8", "", 1, ""], ["dropped"', '["dropped"', "records need a header field n"),
    ],
)
def test_a_schema_that_contradicts_itself_is_refused(
    tmp_path: Path, old: str, new: str, problem: str
) -> None:
    with pytest.raises(SchemaError, match=problem):
        load_schema(changed(tmp_path, old, new))


def test_braces_in_a_fault_text_name_parameters() -> None:
    defaults = {name: param.default for name, param in PARAMS.items()}
    for row in FAULTS.values():
        assert "{" not in row.message.format_map(defaults)
