"""Closed and full streams, and settled limits of simulations."""

from __future__ import annotations

import io
import subprocess
import sys
from pathlib import Path

import pytest

from edmctl.cli import outcome
from edmctl.cli.render.live import LiveReporter
from edmctl.cli.render.terminal import Style
from edmctl.errors import Diagnostic, UsageError
from edmctl.jobs.sweep import seed_to_use
from tests.cli.commands import command, environment
from tests.cli.render.views import made_state


@pytest.mark.parametrize(
    ("line", "exit_code"),
    [
        ("--version > /dev/full", 9),
        ("--help > /dev/full", 9),
        ("--help >&-", 0),
        ("profile check cu >&- 2>&-", 3),
        ("machine --porfile 2> /dev/full", 2),
        ("profile check cu --json > /dev/full", 3),
    ],
)
def test_streams_that_take_nothing_are_no_crash(line: str, exit_code: int, tmp_path: Path) -> None:
    shell = f'"$0" -m edmctl {line}'
    done = subprocess.run(
        ["bash", "-c", shell, command()[0]],
        cwd=tmp_path,
        env=environment(),
        capture_output=True,
        encoding="utf-8",
        check=False,
    )

    assert "Traceback" not in done.stderr
    assert done.returncode == exit_code
    if exit_code == 3 and "2>" not in line:
        assert done.stderr.rindex("error[E9010]") < done.stderr.rindex("error[E2001]")


def test_a_warning_takes_the_picture_away_before_it_is_written(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = io.StringIO()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setattr(
        outcome, "_reporter", lambda _: LiveReporter(terminal, Style(colour=False, live=True))
    )
    output = outcome.Output("calibrate")
    with outcome.watching(output) as reporter:
        reporter.progress(made_state())
        outcome.say(output, [Diagnostic("W3660", "What was measured is kept.", "", is_warning=True)])
    left = terminal.getvalue()
    assert left.endswith("\x1b[?25hwarning[W3660]: What was measured is kept.\n")


def test_the_last_seed_fits_the_run_file_too() -> None:
    assert seed_to_use(2**63 - 1) == 2**63 - 1
    with pytest.raises(UsageError, match="of the first of 2 runs"):
        seed_to_use(2**63 - 1, 2)
