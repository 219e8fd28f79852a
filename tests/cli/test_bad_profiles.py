"""Profiles that cannot be run: message, place, exit code 3, and nothing touched."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.commands import CU270, Here

SOUND = Path(CU270).read_text(encoding="utf-8")

BAD = [
    ("bad TOML", "reference = 0.80", "reference = = 0.80", "E3001"),
    ("wrong type", "reference = 0.80", 'reference = "0.80"', "E3004"),
    ("out of range", "duty = 0.30", "duty = 0.90", "E3005"),
    ("unknown key", "hysteresis = 0.02", "hysterisis = 0.02", "E3003"),
    ("no choice", 'mode = "relay"', 'mode = "fuzzy"', "E3006"),
    ("unreachable depth", "depth_um = 180.0", "depth_um = 320.0", "E3102"),
]


@pytest.fixture
def bad_profile(request: pytest.FixtureRequest) -> tuple[str, int]:
    """Write a profile with one mistake; the path and the line of the mistake."""
    before, after = request.param
    assert SOUND.count(before) == 1, f"cu270.toml no longer holds {before!r} once"
    line = SOUND[: SOUND.index(before)].count("\n") + 1
    path = Path("bad.toml")
    path.write_text(SOUND.replace(before, after), encoding="utf-8")
    return str(path), line


@pytest.mark.parametrize(
    ("bad_profile", "code"),
    [((before, after), code) for _, before, after, code in BAD],
    ids=[name for name, *_ in BAD],
    indirect=["bad_profile"],
)
@pytest.mark.parametrize("dry", [["--dry-run"], []], ids=["dry", "run"])
def test_a_bad_profile_is_refused_at_its_line(
    here: Here, bad_profile: tuple[str, int], code: str, dry: list[str]
) -> None:
    path, line = bad_profile
    said = here("machine", "--profile", path, *dry, "--json")
    assert said.exit_code == 3
    assert f"error[{code}]" in said.err
    assert f"--> {path}:{line}:" in said.err
    assert "^" in said.err
    error = said.document["error"]
    assert (error["code"], error["file"], error["line"]) == (code, path, line)
    assert isinstance(error["column"], int)
    assert not Path("runs").exists()


def test_every_mistake_is_told_at_once(here: Here) -> None:
    text = SOUND.replace("duty = 0.30", "duty = 0.90").replace("hysteresis = 0.02", "hysterisis = 0.02")
    Path("two.toml").write_text(text, encoding="utf-8")
    said = here("machine", "--profile", "two.toml", "--json")
    assert {problem["code"] for problem in said.document["error"]["all"]} == {"E3003", "E3005"}
    assert "2 errors" in said.err


def test_an_override_is_checked_like_the_file(here: Here) -> None:
    said = here("machine", "--profile", "cu270", "--set", "servo.reference=0.42", "--json")
    assert said.exit_code == 3
    assert said.document["error"]["file"] == "--set"
    assert "servo.reference=0.42" in said.err


def test_a_missing_setup_file_is_named(here: Here) -> None:
    said = here("machine", "--profile", "cu270", "--setup", "nowhere.toml", "--json")
    assert said.exit_code == 3
    assert "nowhere.toml" in said.document["error"]["message"]


def test_a_profile_that_is_a_folder_is_refused(here: Here) -> None:
    Path("folder.toml").mkdir()
    said = here("machine", "--profile", "folder.toml", "--json")
    assert said.exit_code in (2, 3)
    assert "folder.toml" in said.document["error"]["message"]
