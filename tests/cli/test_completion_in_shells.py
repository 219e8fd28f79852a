"""Completion as shells do it: whatever files are called, nothing is run, and what is put in means itself."""

from __future__ import annotations

import os
import select
import shlex
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from time import monotonic

import pytest

from tests.cli.commands import environment
from tests.tiers import tiers

PATIENCE_S = 120.0
PROMPT = "ready> "
HOSTILE = (
    *("$(touch hacked)", "`touch hacked`", "\\$(touch hacked)", "x;touch hacked", "x&touch hacked"),
    *("x|touch hacked", "x>hacked", "x\ntouch hacked", "two words", "it's", 'say "so"', "-rf", "--out=x"),
    *("\x1b[31mred", "*", "?", "=ls", "~", "%1", "@x", "#x", "!!", "{a,b}"),
)

COMMAND = """#!/bin/sh
case "$_EDMCTL_COMPLETE$1" in
complete_*|--show-completion) exec {python} -m edmctl "$@" ;;
esac
for word in "$@"; do printf '%s\\0' "$word"; done > told
"""

BASH = f"""
edmctl --show-completion > script; source ./script
bind 'set completion-query-items 0'; bind 'set page-completions off'
PS1='{PROMPT}'
"""
"""In both shells M-* puts in all words that are offered."""

ZSH = f"""
autoload -Uz compinit; compinit -u -D
edmctl --show-completion > script; source ./script
all() {{ _main_complete; compstate[insert]=all }}
zle -C all complete-word all; bindkey '\\e*' all
PS1='{PROMPT}'
"""


@dataclass(frozen=True, slots=True)
class Shell:
    """An interactive shell in a folder, with an `edmctl` that completes, and otherwise says what it was told."""

    name: str
    folder: Path

    def __call__(self, typed: str) -> list[str]:
        """The words that `edmctl` gets when this is typed behind it; the shell ends after it."""
        start = (
            ["bash", "--noprofile", "--rcfile", ".bashrc", "-i"]
            if self.name == "bash"
            else ["zsh", "-d", "-i"]
        )
        ours, theirs = os.openpty()
        with subprocess.Popen(
            start,
            cwd=self.folder,
            env=environment(
                PATH=f"{self.folder / 'bin'}:{os.environ['PATH']}",
                HOME=str(self.folder),
                ZDOTDIR=str(self.folder),
                HISTFILE="",
                INPUTRC=os.devnull,
                TERM="dumb",
                LC_ALL="C.UTF-8",
            ),
            stdin=theirs,
            stdout=theirs,
            stderr=theirs,
            start_new_session=True,
            # Opening it makes it the terminal of the new session.
            preexec_fn=lambda: os.close(os.open(os.ttyname(0), os.O_RDWR)),
        ) as shell:
            os.close(theirs)
            try:
                self._until(ours, PROMPT)
                os.write(ours, f"edmctl {typed}; exit\r".encode())
                self._until(ours, None)
            finally:
                shell.kill()
                os.close(ours)
        return (self.folder / "told").read_text(encoding="utf-8").split("\0")[:-1]

    def _until(self, ours: int, word: str | None) -> None:
        """Read what the shell says until a word comes, or until it ends."""
        said, end_s = b"", monotonic() + PATIENCE_S
        while word is None or word.encode() not in said:
            assert select.select([ours], [], [], max(0.0, end_s - monotonic()))[0], said
            try:
                said += os.read(ours, 65536)
            except OSError:  # nobody has the terminal any more
                assert word is None, said
                return


@pytest.fixture(params=["bash", "zsh"])
def shell(request: pytest.FixtureRequest, tmp_path: Path) -> Shell:
    """Return each shell that is there."""
    if shutil.which(request.param) is None:
        pytest.skip(f"no {request.param} here")
    return Shell(request.param, furnished(tmp_path))


def furnished(folder: Path) -> Path:
    """Put a command, settings of shells, and runs and benches with all sorts of names into a folder."""
    (folder / ".bashrc").write_text(BASH, encoding="utf-8")
    (folder / ".zshrc").write_text(ZSH, encoding="utf-8")
    edmctl = folder / "bin" / "edmctl"
    for inner in ("bin", "runs", "benches"):
        (folder / inner).mkdir()
    edmctl.write_text(COMMAND.format(python=shlex.quote(sys.executable)), encoding="utf-8")
    edmctl.chmod(0o755)
    for name in HOSTILE:
        (folder / "runs" / f"{name}.h5").touch()
        (folder / "runs" / f"{name}.journal").touch()
        (folder / "benches" / name).touch()
    (folder / "runs" / "good-1.h5").touch()
    (folder / "runs" / "left.1.journal").touch()
    return folder


def untouched(folder: Path) -> bool:
    return not list(folder.rglob("hacked"))


@pytest.mark.parametrize(
    ("typed", "words"),
    tiers(
        ("run show \x1b*", ["run", "show", "good-1"]),
        ("machine --profile '$(touch hacked)\x1b*'", ["machine", "--profile", "$(touch hacked)"]),
        slow=(
            ("machine --resume \x1b*", ["machine", "--resume", "left.1"]),
            ("machine --set target.dep\t7", ["machine", "--set", "target.depth_um=7"]),
            ("machine --set jump.mo\toff", ["machine", "--set", "jump.mode=off"]),
            ("doctor --port soc\tpc:7000", ["doctor", "--port", "socket://pc:7000"]),
            ("profile sh\tw25\t--json", ["profile", "show", "w252", "--json"]),
        ),
    ),
)
def test_a_shell_puts_in_plain_words_and_runs_nothing(shell: Shell, typed: str, words: list[str]) -> None:
    assert shell(typed) == words
    assert untouched(shell.folder)


def test_files_with_hostile_names_are_quoted_by_the_shell(shell: Shell) -> None:
    words = shell("simulate serve --bench ./benches/\x1b*")
    assert sorted(words) == sorted(
        ["simulate", "serve", "--bench", *(f"./benches/{name}" for name in HOSTILE)]
    )
    assert untouched(shell.folder)


@pytest.mark.skipif(shutil.which("fish") is None, reason="no fish here")
@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("edmctl run show ", ["good-1"]),
        ("edmctl machine --resume ", ["left.1"]),
        ("edmctl machine --resume (touch hacked", []),
        ("edmctl machine --profile '$(touch hacked)", []),
        ("edmctl machine --set target.dep", ["target.depth_um=", "target.depth_um=VALUE"]),
    ],
)
def test_fish_is_offered_the_same(line: str, words: list[str], tmp_path: Path) -> None:
    folder = furnished(tmp_path)
    done = subprocess.run(
        ["fish", "-N", "-c", "edmctl --show-completion > script; source script; complete -C $argv[1]", line],
        cwd=folder,
        env=environment(PATH=f"{folder / 'bin'}:{os.environ['PATH']}", HOME=str(folder)),
        stdin=subprocess.DEVNULL,
        capture_output=True,
        encoding="utf-8",
        check=False,
    )
    assert (done.stdout.splitlines(), done.stderr) == (words, "")
    assert untouched(folder)
