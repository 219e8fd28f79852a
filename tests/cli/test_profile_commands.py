"""`profile list`, `check`, `show`, `new` and `schema`."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import pytest

from edmctl.errors import ExitCode, ProfileError
from edmctl.planning.rules.load import load_profile
from edmctl.profile.folders import shipped_profiles
from edmctl.toml_text import toml_value
from tests.cli.commands import ROOT, Here
from tests.tiers import tiers


def test_one_bad_file_does_not_hide_the_others(here: Here) -> None:
    said = here("profile", "check", "cu270", "cu150", "w252")
    assert (said.exit_code, said.out) == (0, "cu270: ok\ncu150: ok\nw252: ok\n")
    Path("bad.toml").write_text("[meta]\n", encoding="utf-8")
    said = here("profile", "check", "bad.toml", "nowhere", "cu270", "--json")
    assert said.exit_code == 3
    verdicts = {v["profile"]: v["ok"] for v in said.document["result"]["profiles"]}
    assert verdicts == {"bad.toml": False, "nowhere": False, "cu270": True}
    assert "no shipped profile 'nowhere'" in said.err


def test_profiles_are_checked_and_listed_for_a_setup(here: Here) -> None:
    Path("weak.toml").write_text("[actuator]\nstroke_v = 100.0\n", encoding="utf-8")
    Path("wrong.toml").write_text("[actuator]\nstroke_kv = 100.0\n", encoding="utf-8")
    for setup, code in (("weak.toml", "E3121"), ("wrong.toml", "E3003")):
        said = here("profile", "check", "cu270", "--setup", setup, "--json")
        assert (said.exit_code, said.document["error"]["code"]) == (3, code)
    assert said.document["error"]["file"] == "wrong.toml"
    listed = here("profile", "list", "--setup", "weak.toml")
    assert listed.exit_code == 0
    assert "stroke_v_max 120 V is above the actuator's 100 V" in listed.out


def test_shipped_profiles_are_listed_with_what_they_take(here: Here) -> None:
    lines = here("profile", "list").out.splitlines()
    assert [line.split()[0] for line in lines[1:]] == list(shipped_profiles())
    (row,) = (line for line in lines if line.startswith("array-3x3"))
    assert "3 x 3 holes" in row
    assert "77 µm" in row
    listed = here("profile", "list", "--json").document["result"]["profiles"]
    (array,) = (one for one in listed if one["holes"] == 9)
    assert array["profile"] == "array-3x3"
    assert array["tool_wear_um"] == pytest.approx(9 * 0.427 * 20.0)


def test_show_is_a_profile_that_loads_again_and_json_has_defaults_and_the_schema_every_table(
    here: Here,
) -> None:
    changed = ("w252", "--set", "servo.reference=0.75")
    shown = here("profile", "show", *changed)
    assert (shown.exit_code, tomllib.loads(shown.out)["servo"]["reference"]) == (0, 0.75)
    result = here("profile", "show", *changed, "--json").document["result"]
    assert (result["meta"]["schema"], result["pulse"]["discharge_voltage_v"]) == (1, 22.0)
    assert "spread" in result["sim"]
    Path("again.toml").write_text(shown.out, encoding="utf-8")
    assert here("profile", "show", "again.toml", "--json").document["result"] == result
    schema = json.loads(here("profile", "schema").out)
    assert {"meta", "tool", "pulse", "servo", "target", "sim", "extends"} <= set(schema["properties"])
    assert here("profile", "schema", "--json").document["result"] == schema


def outcome_of(name: str, *overrides: str) -> object:
    """What decides a job and its run file, or why there is none."""
    try:
        loaded = load_profile(name, overrides)
    except ProfileError as error:
        return [(d.code, d.message) for d in error.diagnostics]
    by_option = [line for line in loaded.overrides if line.endswith("--set)")]
    return (loaded.sha256, loaded.sim_sha256, loaded.places, repr(loaded.forecast), by_option)


def changed(value: object) -> object:
    """Another value of the same kind, near enough to be accepted mostly."""
    if isinstance(value, bool):
        return not value
    return value + 1 if isinstance(value, int) else 1.07 * value + 0.01 if isinstance(value, float) else value


WORDS = (
    *('tool.material="W"', 'work.material="steel"', 'pulse.polarity="tool-positive"', 'servo.mode="pi"'),
    *('jump.mode="off"', 'target={kind="feed",feed_um=30.0}', 'target={kind="depth",depth_um=20.0}'),
    *("servo={reference_v=9.6}", 'pulse.mode="isopulse"', "adaptive.seek_reference=true"),
)


OTHER_PROFILES = [name for name in shipped_profiles() if name not in ("cu270", "channel-circle")]


@pytest.mark.parametrize("name", tiers("cu270", "channel-circle", slow=OTHER_PROFILES))
def test_a_profile_from_show_follows_every_later_override_as_the_original(here: Here, name: str) -> None:
    Path("again.toml").write_text(here("profile", "show", name).out, encoding="utf-8")
    loaded = load_profile(name)
    tables = {**loaded.profile.model_dump(by_alias=True), "sim": loaded.sim.model_dump()}
    numbers = [
        f"{table}.{key}={toml_value(changed(value))}"
        for table, values in tables.items()
        for key, value in (values.items() if isinstance(values, dict) else ())
        if isinstance(value, bool | int | float) and value == value
    ]
    assert len(numbers) > 100
    for override in ("", *numbers, *WORDS):
        overrides = [override] if override else []
        assert outcome_of("again.toml", *overrides) == outcome_of(name, *overrides), override


def test_show_comments_out_what_the_profile_does_not_state_and_names_no_path(here: Here) -> None:
    Path("mine.toml").write_text('extends = "w252"\n', encoding="utf-8")
    mine = str(Path("mine.toml").resolve())
    shown = here("profile", "show", mine, "--set", "servo={reference_v=9.6}").out
    stated = tomllib.loads(shown)
    assert stated["servo"]["reference_v"] == 9.6
    assert "reference" not in stated["servo"]
    assert "removal_um3_per_uj" not in stated["work"]
    assert "\n# removal_um3_per_uj = " in shown
    assert "sim" not in stated
    assert "\n# [sim]\n" in shown
    assert str(Path.cwd()) not in shown
    assert str(ROOT) not in shown


def test_new_copies_a_shipped_profile_and_never_overwrites(here: Here) -> None:
    for name in shipped_profiles():
        said = here("profile", "new", f"my-{name}.toml", "--from", name)
        assert (said.exit_code, f"edmctl profile check my-{name}.toml" in said.out) == (0, True)
        copied = Path(f"my-{name}.toml").read_bytes()
        assert copied == (ROOT / "profiles" / f"{name}.toml").read_bytes()
    assert outcome_of("my-array-3x3.toml") == outcome_of("array-3x3")
    assert here("profile", "new", f"my-{name}.toml", "--from", "cu150").exit_code == ExitCode.RUN_FILE
    assert Path(f"my-{name}.toml").read_bytes() == copied
    assert here("profile", "new", "other.toml", "--from", f"./my-{name}.toml").exit_code == ExitCode.USAGE


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
    assert "extends" in written or set(schema["anyOf"][1]["required"]) <= set(written)
