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
from edmctl.errors import MEANING, EdmError, ExitCode, UsageError
from edmctl.jobs.sweep import seed_to_use
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
        ("machine --profile cu270 --set a b", "E2000", "one KEY=VALUE each"),
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


def test_a_bad_profile_is_refused_at_its_lines_all_of_them_at_once(here: Here) -> None:
    """Each mistake by itself is tested in tests/planning/rules."""
    text = Path(CU270).read_text(encoding="utf-8")
    for before, after in (("duty = 0.30", "duty = 0.90"), ("hysteresis = 0.02", "hysterisis = 0.02")):
        assert text.count(before) == 1, f"cu270.toml no longer holds {before!r} once"
        text = text.replace(before, after)
    line = text[: text.index("duty = 0.90")].count("\n") + 1
    Path("bad.toml").write_text(text, encoding="utf-8")
    for dry in (["--dry-run"], []):
        said = here("machine", "--profile", "bad.toml", *dry, "--json")
        assert said.exit_code == 3
        for part in ("error[E3005]", f"--> bad.toml:{line}:", "^", "2 errors"):
            assert part in said.err
        error = said.document["error"]
        assert {problem["code"] for problem in error["all"]} == {"E3003", "E3005"}
        (place,) = (one for one in error["all"] if one["code"] == "E3005")
        assert (place["file"], place["line"]) == ("bad.toml", line)
    assert not Path("runs").exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--profile cu270 --set servo.reference=0.42", "--set:1:"),
        ("--profile cu270 --setup nowhere.toml", "nowhere.toml"),
        ("--profile folder.toml", "folder.toml"),
        (f"--profile cu270 --setup {CU270} --dry-run", f"say --profile {CU270}"),
    ],
)
def test_overrides_and_files_are_checked_like_the_profile(here: Here, options: str, words: str) -> None:
    Path("folder.toml").mkdir()
    said = here("machine", *options.split())
    assert (said.exit_code, said.err.count("error[")) == (3, 1)
    assert words in said.err


@pytest.mark.parametrize("group", ["", "run", "study", "firmware", "profile"])
def test_a_group_without_a_command_writes_its_help_to_stderr(group: str, here: Here) -> None:
    said = here(*group.split())
    assert (said.exit_code, said.out) == (ExitCode.USAGE, "")
    assert said.err == here(*group.split(), "--help").out
    if not group:
        assert all(f"\n  {command} " in said.err for command in ("machine", "simulate", "profile"))
        assert all(f"{code:d}  {meaning}" in said.err for code, meaning in MEANING.items())
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


def test_the_last_seed_fits_the_run_file_too() -> None:
    assert seed_to_use(2**63 - 1) == 2**63 - 1
    with pytest.raises(UsageError, match="of the first of 2 runs"):
        seed_to_use(2**63 - 1, 2)
