"""What only a process of its own can show: signals, pipes, terminals, full and closed streams."""

from __future__ import annotations

import io
import json
import os
import pty
import resource
import signal
import subprocess
import sys
from pathlib import Path

import h5py
import pytest

from edmctl.cli import outcome
from edmctl.cli.render.live import LiveReporter
from edmctl.cli.render.terminal import Style
from edmctl.errors import Diagnostic
from tests.cli.commands import (
    CU270,
    SHALLOW,
    command,
    environment,
    in_process_of_its_own,
    read_until,
    start,
)
from tests.cli.render.views import made_state
from tests.tiers import tiers

JOB = ("machine", "--profile", CU270, "--seed", "1", "--run-id", "r")


def assert_ended_in_order(run_file: Path, exit_code: int) -> None:
    with h5py.File(run_file) as file:
        assert file["/entry/exit_code"][()] == exit_code
        assert file["/entry/end_time"].asstr()[()]
        assert file["/entry/servo/v_cmd"][-1] == 0.0


@pytest.mark.parametrize(("number", "exit_code"), tiers((signal.SIGINT, 130), slow=((signal.SIGTERM, 143),)))
def test_a_signal_stops_in_order(number: signal.Signals, exit_code: int, tmp_path: Path) -> None:
    process = start(*JOB, "--json", cwd=tmp_path)
    read_until(process.stderr, "machining; gap")
    process.send_signal(number)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, "Traceback" in err) == (-number, False)
    assert f"{number.name}: pulses off, retracting" in err
    document = json.loads(out)
    assert (document["ok"], document["exit_code"], document["run_file"]) == (False, exit_code, "runs/r.h5")
    assert document["result"]["time_s"] > 0.0
    assert_ended_in_order(tmp_path / "runs/r.h5", exit_code)


@pytest.mark.parametrize(("runs", "sign"), tiers(("4", "0 of 4 runs done"), slow=(("1", "machining; gap"),)))
def test_a_signal_stops_a_simulation(runs: str, sign: str, tmp_path: Path) -> None:
    process = start("simulate", "--profile", CU270, "--seed", "1", "--runs", runs, "--json", cwd=tmp_path)
    read_until(process.stderr, sign)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, "Traceback" in err) == (-signal.SIGINT, False)
    assert json.loads(out)["exit_code"] == 130


@pytest.mark.slow
def test_runs_that_are_finished_outlast_a_signal(tmp_path: Path) -> None:
    process = start("simulate", "--runs", "400", *SHALLOW, "--json", "--events", cwd=tmp_path)
    read_until(process.stderr, '"done": 0')
    read_until(process.stderr, '"event": "runs"')
    process.send_signal(signal.SIGINT)
    out, _ = process.communicate(timeout=60)
    assert process.returncode == -signal.SIGINT
    result = json.loads(out)["result"]
    (case,) = result["cases"]
    assert 1 <= result["finished"] == len(case["runs"]) < 400
    assert all(run["ok"] for run in case["runs"])


def program(code: str) -> subprocess.CompletedProcess[str]:
    """Run a program in Python in a process of its own."""
    command = [sys.executable, "-c", code]
    return subprocess.run(
        command, env=environment(), capture_output=True, encoding="utf-8", timeout=60, check=False
    )


SECOND_SIGNAL = """
import os, signal
from edmctl.cli.signals import stopping_signals
from edmctl.machine.stop import StopRequest
with stopping_signals(StopRequest(), lambda: os.write(1, b'abort')):
    os.kill(os.getpid(), signal.SIGTERM)
    os.write(1, b'going on ')
    os.kill(os.getpid(), signal.SIGINT)
    os.write(1, b'not reached')
"""
IGNORED_SIGNAL = """
import os, signal
signal.signal(signal.SIGHUP, signal.SIG_IGN)
from edmctl.cli.signals import raising_signals
with raising_signals():
    os.kill(os.getpid(), signal.SIGHUP)
"""
SWALLOWED_SIGNAL = """
import ctypes, os, signal
from edmctl.cli.signals import SignalArrived, raising_signals, stopping_signals
from edmctl.machine.stop import StopRequest
@ctypes.CFUNCTYPE(None)
def callback():
    os.kill(os.getpid(), signal.SIGTERM)
for guarded in (True, False):
    try:
        with raising_signals():
            callback()
            print('going on')
            if guarded:
                with stopping_signals(StopRequest(), lambda: None):
                    print('serving')
    except SignalArrived as arrived:
        print(arrived.signal_number)
"""


def test_a_second_signal_aborts_an_ignored_one_is_ignored_and_a_swallowed_one_is_not_lost() -> None:
    """What is raised where a library calls back, Python only reports."""
    done = program(SECOND_SIGNAL)
    assert (done.returncode, done.stdout) == (-signal.SIGINT, "going on abort")
    assert "SIGINT again: aborted; `edmctl run list` has the run" in done.stderr
    assert program(IGNORED_SIGNAL).returncode == 0
    done = program(SWALLOWED_SIGNAL)
    assert done.stdout.split("\n") == ["going on", "15", "going on", "15", ""]
    assert (done.returncode, done.stderr) == (0, "")


def test_a_full_disk_ends_the_job_safely(tmp_path: Path) -> None:
    limit = 3_000_000
    done = subprocess.run(
        command(*JOB, "--json", "--set", 'log.pulses="full"'),
        cwd=tmp_path,
        env=environment(),
        capture_output=True,
        encoding="utf-8",
        timeout=120,
        check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
    )
    assert (done.returncode, "Traceback" in done.stderr) == (9, False)
    document = json.loads(done.stdout)
    assert (document["error"]["code"], document["run_file"]) == ("E9003", "runs/r.h5.partial")
    assert document["result"]["time_s"] > 0.0
    with h5py.File(tmp_path / "runs/r.h5.partial", "r", swmr=True) as file:
        assert len(file["/entry/servo/time"]) > 100


@pytest.mark.slow
def test_a_reader_that_goes_away_does_not_stop_the_job(tmp_path: Path) -> None:
    process = start("machine", *SHALLOW, "--seed", "1", "--run-id", "r", cwd=tmp_path)
    for stream in (process.stdout, process.stderr):
        assert stream is not None
        stream.close()
    assert process.wait(timeout=60) == 0
    with h5py.File(tmp_path / "runs/r.h5") as file:
        assert file["/entry/status"].asstr()[()] == "done"


@pytest.mark.parametrize(
    ("line", "exit_code", "words"),
    [
        ("--version > /dev/full", 9, ""),
        ("--help > /dev/full", 9, ""),
        ("--help >&-", 0, ""),
        (
            "profile show cu270 > /dev/full",
            9,
            "error[E9010]: Cannot write the result: No space left on device.",
        ),
        ("profile check cu >&- 2>&-", 3, ""),
        ("machine --porfile 2> /dev/full", 2, ""),
        ("profile check cu --json > /dev/full", 3, "error[E9010]"),
    ],
)
def test_streams_that_take_nothing_are_no_crash(
    line: str, exit_code: int, words: str, tmp_path: Path
) -> None:
    done = subprocess.run(
        ["bash", "-c", f'"$0" -m edmctl {line}', command()[0]],
        cwd=tmp_path,
        env=environment(),
        capture_output=True,
        encoding="utf-8",
        check=False,
    )
    assert (done.returncode, "Traceback" in done.stderr) == (exit_code, False)
    assert done.stderr.startswith(words)
    if "--json" in line:  # the reason why the command failed is last
        assert done.stderr.rindex("error[E9010]") < done.stderr.rindex("error[E2001]")


def test_a_warning_takes_the_picture_away_before_it_is_written(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = io.StringIO()
    monkeypatch.setattr(sys, "stderr", terminal)
    live = LiveReporter(terminal, Style(colour=False, live=True))
    monkeypatch.setattr(outcome, "_reporter", lambda _: live)
    output = outcome.Output("calibrate")
    with outcome.watching(output) as reporter:
        reporter.progress(made_state())
        outcome.say(output, [Diagnostic("W3660", "What was measured is kept.", "", is_warning=True)])
    assert terminal.getvalue().endswith("\x1b[?25hwarning[W3660]: What was measured is kept.\n")


def on_a_terminal(
    *arguments: str, cwd: Path, stop_at: str = "", stop: signal.Signals = signal.SIGINT, **changes: str
) -> tuple[int, str]:
    """Return exit code and what a terminal shows of stderr; the signal `stop` is sent once `stop_at` is shown."""
    ours, theirs = pty.openpty()
    with (cwd / "out").open("w") as out:
        process = subprocess.Popen(
            command(*arguments), cwd=cwd, env=environment(**changes), stdout=out, stderr=theirs
        )
    os.close(theirs)
    seen = b""
    while True:
        try:
            seen += os.read(ours, 65536)
        except OSError:
            break
        if stop_at and stop_at in seen.decode(errors="ignore"):
            process.send_signal(stop)
            stop_at = ""
    os.close(ours)
    return process.wait(timeout=60), seen.decode()


# It sparks for a second or two here: the picture, drawn ten times a second, shows a shorter cut by chance only.
DEEP = ("--profile", CU270, "--set", "target.depth_um=120", "--set", 'log.pulses="off"', "--seed", "3")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("term", "locale", "has_picture"),
    [("xterm", "C.UTF-8", True), ("xterm", "C", True), ("dumb", "C.UTF-8", False)],
)
def test_a_terminal_gets_a_picture_as_it_can_show_it(
    tmp_path: Path, term: str, locale: str, has_picture: bool
) -> None:
    exit_code, seen = on_a_terminal("machine", *DEEP, cwd=tmp_path, TERM=term, LC_ALL=locale)
    assert (exit_code, "reference 9.6 V" in seen) == (0, True)
    assert ("\x1b[?25l" in seen, "\x1b" in seen) == (has_picture, has_picture)
    assert ("█" in seen) == (has_picture and locale == "C.UTF-8")
    assert locale != "C" or seen.isascii()


@pytest.mark.parametrize("stop", tiers(signal.SIGINT, slow=(signal.SIGTERM,)))
def test_a_stopped_job_gives_the_cursor_back(tmp_path: Path, stop: signal.Signals) -> None:
    exit_code, seen = on_a_terminal(
        "machine", *SHALLOW, cwd=tmp_path, stop_at="\x1b[?25l", stop=stop, TERM="xterm", LC_ALL="C.UTF-8"
    )
    assert exit_code == -stop
    assert seen.rindex("\x1b[?25l") < seen.rindex("\x1b[?25h") < seen.index("error[")


@pytest.mark.slow
def test_a_stopped_batch_leaves_no_word_of_its_workers(tmp_path: Path) -> None:
    many = ("simulate", "--runs", "40", *SHALLOW)
    exit_code, seen = on_a_terminal(*many, cwd=tmp_path, stop_at="0 of 40", stop=signal.SIGTERM, TERM="dumb")
    assert (exit_code, "leaked" in seen) == (-signal.SIGTERM, False)


def test_ascii_locales_do_not_break_the_output(tmp_path: Path) -> None:
    said = in_process_of_its_own(
        "machine", "--profile", "cu270", "--dry-run", cwd=tmp_path, PYTHONIOENCODING="ascii"
    )
    assert (said.exit_code, "180.00 ?m" in said.out) == (0, True)


@pytest.mark.parametrize(
    ("arguments", "shown"),
    tiers(
        (JOB, b"touch"),
        slow=(
            (("simulate", "--profile", CU270, "--runs", "2"), b"runs"),
            (("simulate", "serve"), b"serving"),
        ),
    ),
)
def test_a_terminal_that_hangs_up_ends_the_command_by_its_signal(
    arguments: tuple[str, ...], shown: bytes, tmp_path: Path
) -> None:
    ours, theirs = pty.openpty()
    with subprocess.Popen(
        command(*arguments),
        cwd=tmp_path,
        env=environment(TERM="xterm"),
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
        preexec_fn=lambda: os.login_tty(0),
    ) as process:
        os.close(theirs)
        seen = b""
        while shown not in seen:
            seen += os.read(ours, 65536)
        os.close(ours)
        assert process.wait(60) == -signal.SIGHUP
    if arguments is JOB:
        assert_ended_in_order(tmp_path / "runs" / "r.h5", 129)
