"""What a shell is offered for a half-written word: whatever files are called, nothing is run."""

from __future__ import annotations

import os
import select
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from time import monotonic

import pytest

from edmctl.cli import completion
from edmctl.link.ports import PortInfo
from tests.cli.commands import command, environment
from tests.tiers import tiers

PATIENCE_S = 120.0
PROMPT = "ready> "
HOSTILE = (
    *("$(touch hacked)", "`touch hacked`", "\\$(touch hacked)", "x;touch hacked", "x&touch hacked"),
    *("x|touch hacked", "x>hacked", "x\ntouch hacked", "two words", "it's", 'say "so"', "-rf", "--out=x"),
    *("\x1b[31mred", "*", "?", "=ls", "~", "%1", "@x", "#x", "!!", "{a,b}"),
)


Offer = Callable[[str], list[str]]


@pytest.mark.parametrize(
    ("offer", "begin", "words"),
    [
        (completion.profiles, "cu", ["cu150", "cu270"]),
        (completion.profiles, "nothing-like-it", []),
        (completion.keys, "target.dep", ["target.depth_um=", "target.depth_um=VALUE"]),
        (completion.keys, "flush.req", [f"flush.required={value}" for value in ("", "true", "false")]),
        (completion.keys, "site", ["sites=", "sites=VALUE"]),
        (completion.keys, "jump.mode=a", ["jump.mode=adaptive"]),
        (completion.keys, "jump.mode=2", []),
        (completion.swept, "servo.refe", ["servo.reference=", "servo.reference_v="]),
        (completion.swept, "servo.hy", ["servo.hysteresis=", "servo.hysteresis=START:STOP:COUNT"]),
        (completion.ports, "si", ["sim:"]),
        (completion.ports, "so", ["socket://", "socket://HOST:PORT"]),
        (completion.figures, "ero", ["erosion"]),
        (completion.studies, "taguchi", ["taguchi-l9"]),
    ],
)
def test_words_are_offered(offer: Offer, begin: str, words: list[str]) -> None:
    assert offer(begin) == words


@pytest.mark.parametrize(
    ("line", "word"),
    [
        ("edmctl machine --profile cu27", "cu270"),
        ("edmctl profile show w", "w252"),
        ("edmctl machine --set jump.mode=a", "jump.mode=adaptive"),
        ("edmctl run plot r --kind ero", "erosion"),
    ],
)
def test_the_program_that_a_shell_asks_offers_them(line: str, word: str, tmp_path: Path) -> None:
    asked = {"_EDMCTL_COMPLETE": "complete_bash", "COMP_WORDS": line, "COMP_CWORD": str(line.count(" "))}
    done = subprocess.run(
        command(),
        cwd=tmp_path,
        env=environment(**asked),
        capture_output=True,
        encoding="utf-8",
        check=False,
    )
    assert (done.stdout.strip(), done.stderr) == (word, "")


def test_names_are_offered_unless_a_shell_could_take_them_for_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    furnished(tmp_path)
    (tmp_path / "runs" / "away.h5").symlink_to("nowhere")
    (tmp_path / "runs" / "dead.h5.partial").touch()
    monkeypatch.chdir(tmp_path)
    assert completion.runs("") == ["good-1"]
    assert sorted(completion.unfinished("")) == ["dead", "left.1"]
    names = ("/dev/ttyUSB0", "/dev/$(touch hacked)", "/dev/two words", "/dev/a\nb", "/dev/\x1b[31m", "-x")
    monkeypatch.setattr("edmctl.link.ports.listed_ports", lambda: [PortInfo(name) for name in names])
    assert [name for name in completion.ports("") if name.startswith(("/dev", "-"))] == ["/dev/ttyUSB0"]


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


def furnished(folder: Path) -> None:
    """Put a command, settings of shells, and runs and benches with all sorts of names into a folder."""
    (folder / ".bashrc").write_text(BASH, encoding="utf-8")
    (folder / ".zshrc").write_text(ZSH, encoding="utf-8")
    for inner in ("bin", "runs", "benches"):
        (folder / inner).mkdir()
    edmctl = folder / "bin" / "edmctl"
    edmctl.write_text(COMMAND.format(python=shlex.quote(sys.executable)), encoding="utf-8")
    edmctl.chmod(0o755)
    for name in HOSTILE:
        (folder / "runs" / f"{name}.h5").touch()
        (folder / "runs" / f"{name}.journal").touch()
        (folder / "benches" / name).touch()
    (folder / "runs" / "good-1.h5").touch()
    (folder / "runs" / "left.1.journal").touch()


def typed_in(name: str, folder: Path, typed: str) -> list[str]:
    """Return the words that `edmctl` gets when this is typed behind it in an interactive shell."""
    start = {"bash": "bash --noprofile --rcfile .bashrc -i", "zsh": "zsh -d -i"}[name]
    ours, theirs = os.openpty()
    with subprocess.Popen(
        start.split(),
        cwd=folder,
        env=environment(
            PATH=f"{folder / 'bin'}:{os.environ['PATH']}",
            HOME=str(folder),
            ZDOTDIR=str(folder),
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
            _read_until(ours, PROMPT)
            os.write(ours, f"edmctl {typed}; exit\r".encode())
            _read_until(ours, None)
        finally:
            shell.kill()
            os.close(ours)
    assert not list(folder.rglob("hacked"))
    return (folder / "told").read_text(encoding="utf-8").split("\0")[:-1]


def _read_until(terminal: int, word: str | None) -> None:
    """Read what the shell prints until a word comes, or until it ends."""
    printed, end_s = b"", monotonic() + PATIENCE_S
    while word is None or word.encode() not in printed:
        assert select.select([terminal], [], [], max(0.0, end_s - monotonic()))[0], printed
        try:
            printed += os.read(terminal, 65536)
        except OSError:  # the shell has closed the terminal
            assert word is None, printed
            return


@pytest.mark.parametrize("name", ["bash", "zsh"])
@pytest.mark.parametrize(
    ("typed", "words"),
    tiers(
        ("run show \x1b*", ["run", "show", "good-1"]),
        ("machine --profile '$(touch hacked)\x1b*'", ["machine", "--profile", "$(touch hacked)"]),
        (
            "simulate serve --bench ./benches/\x1b*",
            ["simulate", "serve", "--bench", *(f"./benches/{name}" for name in HOSTILE)],
        ),
        slow=(
            ("machine --resume \x1b*", ["machine", "--resume", "left.1"]),
            ("machine --set target.dep\t7", ["machine", "--set", "target.depth_um=7"]),
            ("doctor --port soc\tpc:7000", ["doctor", "--port", "socket://pc:7000"]),
            ("profile sh\tw25\t--json", ["profile", "show", "w252", "--json"]),
        ),
    ),
)
def test_a_shell_puts_in_plain_words_and_runs_nothing(
    name: str, typed: str, words: list[str], tmp_path: Path
) -> None:
    if shutil.which(name) is None:
        pytest.skip(f"no {name} here")
    furnished(tmp_path)
    assert sorted(typed_in(name, tmp_path, typed)) == sorted(words)
