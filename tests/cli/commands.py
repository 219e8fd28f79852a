"""Ways to run a command line: in this process, where it is quick, or in one of its own."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from edmctl.core.build import CACHE_VARIABLE

if TYPE_CHECKING:
    import pytest

ROOT = Path(__file__).parents[2]
CU270 = str(ROOT / "profiles" / "cu270.toml")

HURRIED = (
    *("--set", "approach.speed_um_s=5"),
    *("--set", "measure.fast_um_s=50"),
    *("--set", "measure.settle_s=0.2"),
    *("--set", "measure.dwell_s=0.1"),
)
"""Two thirds of the time for what is not machined."""
# As shallow as the jump height of the profile permits.
SHALLOW = ("--profile", CU270, "--set", "target.depth_um=8", "--set", 'log.pulses="off"', *HURRIED)


@dataclass(frozen=True, slots=True)
class Said:
    """What a command left behind."""

    exit_code: int
    out: str
    err: str

    @property
    def document(self) -> dict[str, Any]:
        """The one JSON object on stdout."""
        parsed: dict[str, Any] = json.loads(self.out)
        return parsed


class Here:
    """Runs command lines in this process."""

    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self._capsys = capsys

    def __call__(self, *arguments: str) -> Said:
        from edmctl.app import main

        exit_code = main(arguments)
        captured = self._capsys.readouterr()
        assert "Traceback" not in captured.err
        return Said(exit_code, captured.out, captured.err)


def environment(**changes: str) -> dict[str, str]:
    """The environment of a user at a plain terminal, who has calibrated nothing."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith("EDMCTL_") or k == CACHE_VARIABLE}
    for name in ("NO_COLOR", "FORCE_COLOR"):
        kept.pop(name, None)
    return {**kept, "PYTHONPATH": str(ROOT), "PYTHONFAULTHANDLER": "1", "EDMCTL_HOME": "home", **changes}


def command(*arguments: str) -> list[str]:
    """The command line of `edmctl` in a process of its own."""
    return [sys.executable, "-m", "edmctl", *arguments]


def in_a_shell(
    *arguments: str, cwd: Path, env: dict[str, str], timeout_s: float
) -> subprocess.CompletedProcess[str]:
    """Run a shell with all that it starts; past the time all of it ends, not the shell alone.

    Raises AssertionError with what was said until then when it takes longer than `timeout_s`.
    """
    with subprocess.Popen(
        arguments,
        cwd=cwd,
        env=env,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        encoding="utf-8",
        process_group=0,
    ) as shell:
        try:
            out, err = shell.communicate(timeout=timeout_s)
        except subprocess.TimeoutExpired:
            os.killpg(shell.pid, signal.SIGABRT)  # a process of Python shows where it was
            out, err = shell.communicate()
            raise AssertionError(f"{arguments} took over {timeout_s:g} s:\n{out}\n{err}") from None
    return subprocess.CompletedProcess(arguments, shell.returncode, out, err)


def start(*arguments: str, cwd: Path) -> subprocess.Popen[str]:
    """Start a command in a process of its own, with pipes for its streams."""
    return subprocess.Popen(
        command(*arguments),
        cwd=cwd,
        env=environment(),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        encoding="utf-8",
    )


def read_until(stream: IO[str] | None, part: str) -> str:
    """Read lines until one holds `part`."""
    assert stream is not None
    lines = ""
    for line in stream:
        lines += line
        if part in line:
            return lines
    raise AssertionError(f"{part!r} never came; there was:\n{lines}")


def in_process_of_its_own(*arguments: str, cwd: Path, **changes: str) -> Said:
    """Run a command in its own process with pipes for its streams."""
    done = subprocess.run(
        command(*arguments),
        cwd=cwd,
        env=environment(**changes),
        stdin=subprocess.DEVNULL,
        capture_output=True,
        encoding="utf-8",
        timeout=120,
        check=False,
    )
    assert "Traceback" not in done.stderr
    return Said(done.returncode, done.stdout, done.stderr)
