"""Command lines that cannot be meant."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from edmctl.app import command_tree
from edmctl.cli.render.help import render_help
from edmctl.cli.render.terminal import Style
from edmctl.errors import EdmError
from edmctl.exitcodes import MEANING, ExitCode
from edmctl.version import __version__
from tests.cli.commands import CU270, Here


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        ("machine --porfile cu270", "E2000", "No such option: --porfile"),
        ("machin", "E2000", "No such command 'machin'. Did you mean 'machine'?"),
        ("machine --seed many --profile cu270", "E2000", "'many' is not a valid int"),
        ("machine", "E2002", "No profile was named."),
        ("machine --profile cu207", "E2001", "There is no shipped profile 'cu207'"),
        ("machine --profile cu207", "E2001", "Did you mean cu270?"),
        ("machine --profile cu270 --seed -1", "E2005", "Seed -1 does not lie between 0 and"),
        ("machine --profile cu270 --run-id ../x", "E2004", "'../x' is no plain file name"),
        ("simulate --profile cu270 --runs 0", "E2000", "0 is not in the range 1<=x<=100000"),
        ("simulate --profile cu270 --sweep servo.reference", "E2003", "KEY=START:STOP:COUNT"),
        ("machine cu270", "E2000", "`edmctl machine --profile cu270`"),
        ("jump-flush cu150 --count 3", "E2000", "`edmctl jump-flush --profile cu150`"),
        ("list", "E2000", "`edmctl profile list` or `edmctl run list`"),
        ("explain a", "E2000", "`edmctl run explain`"),
        ("machine --profile cu270 --set a b", "E2000", "`--set a=b`"),
        ("machine --profile cu270 --set a = b", "E2000", "`--set a=b`"),
        ("machine --profile cu270 --set a= b", "E2000", "`--set a=b`"),
        ("machine --profile cu270 --set a=1 b=2", "E2000", "`--set a=1 --set b=2`"),
    ],
)
def test_a_mistake_is_named_on_stderr_and_in_the_json_object(
    words: str, code: str, message: str, here: Here
) -> None:
    said = here(*words.split())
    assert (said.exit_code, said.out) == (ExitCode.USAGE, "")
    assert f"error[{code}]: " in said.err
    assert message in said.err
    document = here(*words.split(), "--json").document
    assert (document["ok"], document["exit_code"], document["result"]) == (False, 2, None)
    error = document["error"]
    assert error["code"] == code
    assert message in f"{error['message']} {error['hint']}"
    for text in (error["message"], error["hint"]):
        assert text[0].isupper() or text[0] in "`-'", f"{text!r} is no sentence"
        assert text.endswith((".", "?")) or "--sweep" in text, f"{text!r} is no sentence"


def test_a_profile_for_a_setup_is_one_mistake(here: Here) -> None:
    said = here("machine", "--profile", "cu270", "--setup", CU270, "--dry-run")
    assert said.exit_code == ExitCode.PROFILE
    assert said.err.count("error[") == 1
    assert f"say --profile {CU270}" in said.err


SOUND = Path(CU270).read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("before", "after", "code"),
    [
        pytest.param("reference = 0.80", "reference = = 0.80", "E3001", id="bad TOML"),
        pytest.param("reference = 0.80", 'reference = "0.80"', "E3004", id="wrong type"),
        pytest.param("duty = 0.30", "duty = 0.90", "E3005", id="out of range"),
        pytest.param("hysteresis = 0.02", "hysterisis = 0.02", "E3003", id="unknown key"),
        pytest.param('mode = "relay"', 'mode = "fuzzy"', "E3006", id="no choice"),
        pytest.param("depth_um = 180.0", "depth_um = 320.0", "E3102", id="unreachable depth"),
    ],
)
@pytest.mark.parametrize("dry", [["--dry-run"], []], ids=["dry", "run"])
def test_a_bad_profile_is_refused_at_its_line(
    here: Here, before: str, after: str, code: str, dry: list[str]
) -> None:
    assert SOUND.count(before) == 1, f"cu270.toml no longer holds {before!r} once"
    line = SOUND[: SOUND.index(before)].count("\n") + 1
    Path("bad.toml").write_text(SOUND.replace(before, after), encoding="utf-8")
    said = here("machine", "--profile", "bad.toml", *dry, "--json")
    assert said.exit_code == 3
    for part in (f"error[{code}]", f"--> bad.toml:{line}:", "^"):
        assert part in said.err
    error = said.document["error"]
    assert (error["code"], error["file"], error["line"]) == (code, "bad.toml", line)
    assert isinstance(error["column"], int)
    assert not Path("runs").exists()


def test_every_mistake_is_told_at_once(here: Here) -> None:
    text = SOUND.replace("duty = 0.30", "duty = 0.90").replace("hysteresis = 0.02", "hysterisis = 0.02")
    Path("two.toml").write_text(text, encoding="utf-8")
    said = here("machine", "--profile", "two.toml", "--json")
    assert {problem["code"] for problem in said.document["error"]["all"]} == {"E3003", "E3005"}
    assert "2 errors" in said.err


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--profile", "cu270", "--set", "servo.reference=0.42"), "--set:1:"),
        (("--profile", "cu270", "--setup", "nowhere.toml"), "nowhere.toml"),
        (("--profile", "folder.toml"), "folder.toml"),
    ],
)
def test_overrides_and_files_are_checked_like_the_profile(
    here: Here, options: tuple[str, ...], words: str
) -> None:
    Path("folder.toml").mkdir()
    said = here("machine", *options)
    assert said.exit_code == 3
    assert words in said.err


def test_without_a_command_there_is_help(here: Here) -> None:
    said = here()
    assert said.exit_code == ExitCode.USAGE
    assert said.out == ""
    assert "Commands:" in said.err


def test_help_lists_commands_and_every_exit_code(here: Here) -> None:
    said = here("--help")
    assert said.exit_code == 0
    for command in ("machine", "simulate", "profile"):
        assert f"\n  {command} " in said.out
    for code, meaning in MEANING.items():
        assert f"{code:d}  {meaning}" in said.out


def test_version_also_works_before_a_command(here: Here) -> None:
    assert here("--version", "machine").out == f"edmctl {__version__}\n"


def test_every_error_class_has_an_exit_code_with_a_meaning() -> None:
    classes = [EdmError]
    for error in classes:
        classes += error.__subclasses__()
    assert {error.exit_code for error in classes} <= set(MEANING)
    assert set(MEANING) == set(ExitCode)


def commands_in(tree: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[str, Any]]:
    yield " ".join(path), tree
    for name, inner in getattr(tree, "commands", {}).items():
        yield from commands_in(inner, (*path, name))


def words_of(text: str) -> str:
    """The text without what lays it out: frames, blanks and line breaks."""
    return re.sub(r"[\s│╭╮╰╯─]", "", text)


@pytest.mark.parametrize("columns", [40, 80, 120])
@pytest.mark.parametrize("is_terminal", [True, False])
def test_help_of_every_command_has_every_sentence_at_any_width(
    columns: int, is_terminal: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    style = Style(colour=False, live=is_terminal, columns=columns)
    for name, command in commands_in(command_tree()):
        context = command.make_context(name or "edmctl", [], resilient_parsing=True)
        said = render_help(command, context, style)
        assert max(map(len, said.splitlines())) <= columns, name
        records = [record for one in command.get_params(context) if (record := one.get_help_record(context))]
        inner = [(key, one.short_help) for key, one in getattr(command, "commands", {}).items()]
        if columns < 80:
            assert all(words_of(text) in words_of(said) for _, text in [*records, *inner]), name
        for word in " ".join([command.help, *(text for pair in [*records, *inner] for text in pair)]).split():
            assert word in said or len(word) > 24, (name, word)
        assert ("╭" in said) == is_terminal


@pytest.mark.parametrize(
    "command", ["machine", "approach", "measure-wear", "measure-drift", "jump-flush", "simulate"]
)
def test_a_seed_that_a_run_refuses_is_refused_by_its_dry_run(command: str, here: Here) -> None:
    said = here(command, "--profile", "cu270", "--seed", "-1", "--dry-run")
    assert said.exit_code == ExitCode.USAGE
    assert "error[E2005]" in said.err


@pytest.mark.parametrize(
    ("words", "named", "written"),
    [
        (["machine", "\u2014profile", "cu270"], "U+2014 (EM DASH)", "--profile"),
        (["machine", "\u2013-dry\u2013run"], "U+2013 (EN DASH)", "--dry-run"),
        (["jump-flush", "--site", "\u2212500,0"], "U+2212 (MINUS SIGN)", "-500,0"),
        (["approach", "--site=0,\u22125.5"], "U+2212 (MINUS SIGN)", "--site=0,-5.5"),
        (["machine", "--seed", "\u22122"], "U+2212 (MINUS SIGN)", "-2"),
        (
            ["machine", "--set", "work.thickness_um=\u22122e3"],
            "U+2212 (MINUS SIGN)",
            "work.thickness_um=-2e3",
        ),
    ],
)
def test_a_dash_that_is_no_hyphen_is_named(here: Here, words: list[str], named: str, written: str) -> None:
    said = here(*words)
    assert said.exit_code == 2
    assert f"has the character {named}." in said.err
    assert f"Write {written}, with plain hyphens (-)." in said.err


def test_a_text_may_have_dashes(here: Here) -> None:
    assert "character" not in here("run", "show", "tool 2\u20133, \u2014").err
