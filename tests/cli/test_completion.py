"""What a shell is offered for a half-written word."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path

import pytest

from edmctl.cli.completion import ports
from edmctl.link.ports import PortInfo
from tests.cli.commands import command, environment


def offered(line: str, cwd: Path) -> Sequence[str]:
    """What bash would show after TAB at the end of a line."""
    done = subprocess.run(
        command(),
        cwd=cwd,
        env=environment(
            _EDMCTL_COMPLETE="complete_bash", COMP_WORDS=line, COMP_CWORD=str(len(line.split(" ")) - 1)
        ),
        capture_output=True,
        encoding="utf-8",
        check=False,
    )
    assert not done.stderr
    return done.stdout.split("\n")


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("edmctl machine --profile cu", ["cu150", "cu270"]),
        ("edmctl profile show w", ["w252"]),
        ("edmctl machine --set target.dep", ["target.depth_um=", "target.depth_um=VALUE"]),
        ("edmctl machine --set flush.req", [f"flush.required={value}" for value in ("", "true", "false")]),
        ("edmctl machine --set site", ["sites=", "sites=VALUE"]),
        ("edmctl machine --set jump.mode=a", ["jump.mode=adaptive"]),
        ("edmctl machine --set jump.mode=2", []),
        ("edmctl simulate --sweep servo.refe", ["servo.reference=", "servo.reference_v="]),
        ("edmctl simulate --sweep servo.hy", ["servo.hysteresis=", "servo.hysteresis=START:STOP:COUNT"]),
        ("edmctl doctor --port si", ["sim:"]),
        ("edmctl doctor --port so", ["socket://", "socket://HOST:PORT"]),
        ("edmctl run plot r --kind ero", ["erosion"]),
        ("edmctl machine --profile nothing-like-it", []),
    ],
)
def test_words_are_offered(line: str, words: list[str], tmp_path: Path) -> None:
    assert [word for word in offered(line, tmp_path) if word] == words


def test_runs_are_offered_by_their_ids_unless_a_shell_could_take_them_for_more(tmp_path: Path) -> None:
    folder = tmp_path / "runs"
    folder.mkdir()
    for name in (
        *("good-1.h5", "left.h5.partial", "gone.journal", "$(touch hacked).h5", "two words.h5", "`x`.h5"),
        *("-rf.h5", "--out=x.h5", "=ls.h5", "@x.h5", "%1.h5", "red\x1b[31m.h5", "two\nlines.h5"),
    ):
        (folder / name).touch()
    (folder / "away.h5").symlink_to("nowhere")
    assert [word for word in offered("edmctl run show ", tmp_path) if word] == ["good-1"]
    assert sorted(word for word in offered("edmctl machine --resume ", tmp_path) if word) == ["gone", "left"]
    assert not (tmp_path / "hacked").exists()


def test_ports_are_offered_likewise(monkeypatch: pytest.MonkeyPatch) -> None:
    names = ("/dev/ttyUSB0", "/dev/$(touch hacked)", "/dev/two words", "/dev/a\nb", "/dev/\x1b[31m", "-x")
    monkeypatch.setattr("edmctl.link.ports.listed_ports", lambda: [PortInfo(name) for name in names])
    assert [name for name in ports("") if name.startswith(("/dev", "-"))] == ["/dev/ttyUSB0"]
