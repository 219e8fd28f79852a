"""`profile list`, `check`, `show` and `schema`."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from edmctl.profile.folders import shipped_profiles
from tests.cli.commands import CU270, ROOT

if TYPE_CHECKING:
    from tests.cli.commands import Here


def test_sound_profiles_are_ok(here: Here) -> None:
    said = here("profile", "check", "cu270", "cu150", "w252")
    assert said.exit_code == 0
    assert said.out == "cu270: ok\ncu150: ok\nw252: ok\n"


def test_one_bad_file_does_not_hide_the_others(here: Here) -> None:
    Path("bad.toml").write_text("[meta]\n", encoding="utf-8")
    said = here("profile", "check", "bad.toml", "nowhere", "cu270", "--json")
    assert said.exit_code == 3
    verdicts = said.document["result"]["profiles"]
    assert [(v["profile"], v["ok"]) for v in verdicts] == [
        ("bad.toml", False),
        ("nowhere", False),
        ("cu270", True),
    ]
    assert "no shipped profile 'nowhere'" in said.err


def test_show_is_a_profile_that_loads_again(here: Here) -> None:
    shown = here("profile", "show", "w252", "--set", "servo.reference=0.75")
    assert shown.exit_code == 0
    assert "servo.reference" in shown.out
    assert tomllib.loads(shown.out)["servo"]["reference"] == 0.75
    Path("again.toml").write_text(shown.out, encoding="utf-8")
    again = here("profile", "show", "again.toml", "--json")
    first = here("profile", "show", "w252", "--set", "servo.reference=0.75", "--json")
    assert again.document["result"] == first.document["result"]


@pytest.mark.parametrize("name", shipped_profiles())
def test_every_shipped_profile_is_shown_so_that_it_loads_again(here: Here, name: str) -> None:
    Path("again.toml").write_text(here("profile", "show", name).out, encoding="utf-8")
    again = here("profile", "show", "again.toml", "--json")
    assert again.document["result"] == here("profile", "show", name, "--json").document["result"]


def test_shipped_profiles_are_listed_with_what_they_take(here: Here) -> None:
    lines = here("profile", "list").out.splitlines()
    assert [line.split()[0] for line in lines[1:]] == list(shipped_profiles())
    (row,) = (line for line in lines if line.startswith("array-3x3"))
    assert "3 x 3 holes" in row
    assert "77 µm" in row
    (one,) = (
        one for one in here("profile", "list", "--json").document["result"]["profiles"] if one["holes"] == 9
    )
    assert one["profile"] == "array-3x3"
    assert one["tool_wear_um"] == pytest.approx(9 * 0.427 * 20.0)


def test_the_list_says_what_a_machine_cannot_run(here: Here) -> None:
    Path("weak.toml").write_text("[actuator]\nstroke_v = 100.0\n", encoding="utf-8")
    said = here("profile", "list", "--setup", "weak.toml")
    assert said.exit_code == 0
    assert "stroke_v_max 120 V is above the actuator's 100 V" in said.out


def test_show_json_holds_defaults(here: Here) -> None:
    result = here("profile", "show", CU270, "--json").document["result"]
    assert result["meta"]["schema"] == 1
    assert result["pulse"]["discharge_voltage_v"] == 22.0
    assert "spread" in result["sim"]


def test_schema_describes_every_table(here: Here) -> None:
    schema = json.loads(here("profile", "schema").out)
    assert {"meta", "tool", "pulse", "servo", "target", "sim", "extends"} <= set(schema["properties"])
    assert here("profile", "schema", "--json").document["result"] == schema


def keys_of(schema: dict[str, Any], table: str) -> set[str]:
    """Keys that the schema knows in a table, whatever its kind."""
    description = schema["properties"][table]
    description = description.get("items", description)
    either = description.get("oneOf", description.get("anyOf", [description]))
    kinds = [kind["$ref"].rpartition("/")[2] for kind in either if "$ref" in kind]
    return {key for kind in kinds for key in schema["$defs"][kind]["properties"]}


@pytest.mark.parametrize("name", shipped_profiles())
def test_shipped_profiles_fit_the_schema_as_they_are_written(here: Here, name: str) -> None:
    schema = json.loads(here("profile", "schema").out)
    written = tomllib.loads((ROOT / "profiles" / f"{name}.toml").read_text(encoding="utf-8"))
    assert set(written) <= set(schema["properties"])
    for table, values in written.items():
        for held in values if isinstance(values, list) else [values] if table != "extends" else []:
            assert set(held) <= keys_of(schema, table)
    assert "required" not in schema
    if "extends" not in written:
        assert set(schema["then"]["required"]) <= set(written)
        optional = schema["properties"].keys() - written.keys() - set(schema["then"]["required"])
        for table, asked in schema["then"]["properties"].items():
            assert table in optional or any(
                set(keys["required"]) <= set(written.get(table, {})) for keys in asked["anyOf"]
            )


def test_a_setup_is_checked_with_the_profiles(here: Here) -> None:
    Path("weak.toml").write_text("[actuator]\nstroke_v = 100.0\n", encoding="utf-8")
    said = here("profile", "check", "cu270", "--setup", "weak.toml", "--json")
    assert said.exit_code == 3
    assert said.document["error"]["code"] == "E3121"
    Path("wrong.toml").write_text("[actuator]\nstroke_kv = 100.0\n", encoding="utf-8")
    said = here("profile", "check", "cu270", "--setup", "wrong.toml", "--json")
    assert (said.exit_code, said.document["error"]["code"]) == (3, "E3003")
    assert said.document["error"]["file"] == "wrong.toml"
