"""What only a process of its own can show: signals, pipes, terminals, a full disk."""

from __future__ import annotations

import json
import os
import pty
import resource
import signal
import subprocess
import sys
from pathlib import Path
from typing import IO

import h5py
import pytest

from tests.cli.commands import CU270, SHALLOW, command, environment, in_process_of_its_own
from tests.tiers import tiers


def start(*arguments: str, cwd: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        command(*arguments),
        cwd=cwd,
        env=environment(),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        encoding="utf-8",
    )


def read_until(stream: IO[str], part: str) -> str:
    """Read lines until one holds `part`."""
    lines = ""
    for line in stream:
        lines += line
        if part in line:
            return lines
    raise AssertionError(f"{part!r} never came; there was:\n{lines}")


@pytest.mark.parametrize(("number", "exit_code"), tiers((signal.SIGINT, 130), slow=((signal.SIGTERM, 143),)))
def test_a_signal_stops_in_order(number: signal.Signals, exit_code: int, tmp_path: Path) -> None:
    process = start("machine", "--profile", CU270, "--seed", "1", "--run-id", "r", "--json", cwd=tmp_path)
    assert process.stderr is not None
    read_until(process.stderr, "machining; gap")
    process.send_signal(number)
    out, err = process.communicate(timeout=60)
    assert process.returncode == -number
    assert "Traceback" not in err
    assert f"{number.name}: pulses off, retracting" in err
    document = json.loads(out)
    assert (document["ok"], document["exit_code"]) == (False, exit_code)
    assert document["run_file"] == "runs/r.h5"
    assert document["result"]["time_s"] > 0.0
    with h5py.File(tmp_path / "runs/r.h5") as file:
        assert file["/entry/exit_code"][()] == exit_code
        assert file["/entry/end_time"].asstr()[()]
        assert file["/entry/servo/v_cmd"][-1] == 0.0


@pytest.mark.parametrize(("runs", "sign"), tiers(("4", "0 of 4 runs done"), slow=(("1", "machining; gap"),)))
def test_a_signal_stops_a_simulation(runs: str, sign: str, tmp_path: Path) -> None:
    process = start("simulate", "--profile", CU270, "--seed", "1", "--runs", runs, "--json", cwd=tmp_path)
    assert process.stderr is not None
    read_until(process.stderr, sign)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == -signal.SIGINT
    assert "Traceback" not in err
    assert json.loads(out)["exit_code"] == 130


@pytest.mark.slow
def test_runs_that_are_finished_outlast_a_signal(tmp_path: Path) -> None:
    many = ("simulate", "--seed", "1", "--runs", "400", *SHALLOW, "--json", "--events")
    process = start(*many, cwd=tmp_path)
    assert process.stderr is not None
    read_until(process.stderr, '"done": 0')
    read_until(process.stderr, '"event": "runs"')
    process.send_signal(signal.SIGINT)
    out, _ = process.communicate(timeout=60)
    assert process.returncode == -signal.SIGINT
    document = json.loads(out)
    (case,) = document["result"]["cases"]
    assert document["exit_code"] == 130
    assert 1 <= document["result"]["finished"] == len(case["runs"]) < 400
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


def test_a_second_signal_aborts_and_ignored_ones_stay_ignored() -> None:
    done = program(SECOND_SIGNAL)
    assert (done.returncode, done.stdout) == (-signal.SIGINT, "going on abort")
    assert "SIGINT again: aborted; `edmctl run list` has the run" in done.stderr
    assert program(IGNORED_SIGNAL).returncode == 0


def test_a_signal_that_a_callback_swallows_is_not_lost() -> None:
    """What is raised where a library calls back, Python can only tell of."""
    done = program(SWALLOWED_SIGNAL)
    assert done.stdout.split("\n") == ["going on", "15", "going on", "15", ""]
    assert (done.returncode, done.stderr) == (0, "")


def test_a_full_disk_ends_the_job_safely(tmp_path: Path) -> None:
    limit = 3_000_000
    done = subprocess.run(
        command(
            *["machine", "--seed", "1", "--run-id", "r", "--json"],
            "--profile",
            CU270,
            "--set",
            'log.pulses="full"',
        ),
        cwd=tmp_path,
        env=environment(),
        capture_output=True,
        encoding="utf-8",
        timeout=120,
        check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
    )
    assert done.returncode == 9
    assert "Traceback" not in done.stderr
    document = json.loads(done.stdout)
    assert document["error"]["code"] == "E9003"
    assert document["run_file"] == "runs/r.h5.partial"
    assert document["result"]["time_s"] > 0.0
    with h5py.File(tmp_path / "runs/r.h5.partial", "r", swmr=True) as file:
        assert len(file["/entry/servo/time"]) > 100


@pytest.mark.slow
def test_a_reader_that_goes_away_does_not_stop_the_job(tmp_path: Path) -> None:
    process = start("machine", *SHALLOW, "--seed", "1", "--run-id", "r", cwd=tmp_path)
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.close()
    process.stderr.close()
    assert process.wait(timeout=60) == 0
    with h5py.File(tmp_path / "runs/r.h5") as file:
        assert file["/entry/status"].asstr()[()] == "done"


def test_a_result_that_cannot_be_written_is_an_error(tmp_path: Path) -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            command("profile", "show", "cu270"),
            cwd=tmp_path,
            env=environment(),
            stdout=full,
            stderr=subprocess.PIPE,
            encoding="utf-8",
            check=False,
        )
    assert done.returncode == 9
    assert done.stderr.startswith("error[E9010]: Cannot write the result: No space left on device.")
    assert "Traceback" not in done.stderr


def on_a_terminal(
    *arguments: str, cwd: Path, stop_at: str = "", stop: signal.Signals = signal.SIGINT, **changes: str
) -> tuple[int, str]:
    """Exit code, and what a terminal gets to see of stderr; the signal `stop` is sent once `stop_at` is seen."""
    ours, theirs = pty.openpty()
    with (cwd / "out").open("w") as out:
        process = subprocess.Popen(
            command(*arguments), cwd=cwd, env=environment(**changes), stdout=out, stderr=theirs
        )
    os.close(theirs)
    seen = b""
    while True:
        try:
            block = os.read(ours, 65536)
        except OSError:
            break
        seen += block
        if stop_at and stop_at in seen.decode(errors="ignore"):
            process.send_signal(stop)
            stop_at = ""
    os.close(ours)
    return process.wait(timeout=60), seen.decode()


# It sparks for a second or two here: the picture, drawn ten times a second, shows a shorter cut by chance only.
DEEP = ("--profile", CU270, "--set", "target.depth_um=120", "--set", 'log.pulses="off"', "--seed", "3")


@pytest.mark.slow
def test_a_terminal_gets_a_picture(tmp_path: Path) -> None:
    exit_code, seen = on_a_terminal("machine", *DEEP, cwd=tmp_path, TERM="xterm", LC_ALL="C.UTF-8")
    assert exit_code == 0
    assert "█" in seen
    assert "\x1b[?25l" in seen
    assert "reference 9.6 V" in seen


@pytest.mark.parametrize("stop", tiers(signal.SIGINT, slow=(signal.SIGTERM,)))
def test_a_stopped_job_gives_the_cursor_back(tmp_path: Path, stop: signal.Signals) -> None:
    exit_code, seen = on_a_terminal(
        "machine", *SHALLOW, cwd=tmp_path, stop_at="\x1b[?25l", stop=stop, TERM="xterm", LC_ALL="C.UTF-8"
    )
    assert exit_code == -stop
    assert seen.rindex("\x1b[?25h") > seen.rindex("\x1b[?25l")
    assert seen.rindex("\x1b[?25h") < seen.index("error[")


@pytest.mark.slow
def test_a_stopped_batch_leaves_no_word_of_its_workers(tmp_path: Path) -> None:
    many = ("simulate", "--profile", CU270, "--runs", "40", *SHALLOW[2:])
    exit_code, seen = on_a_terminal(*many, cwd=tmp_path, stop_at="0 of 40", stop=signal.SIGTERM, TERM="dumb")
    assert exit_code == -signal.SIGTERM
    assert "leaked" not in seen


@pytest.mark.slow
def test_a_terminal_of_the_c_locale_gets_ascii(tmp_path: Path) -> None:
    _, seen = on_a_terminal("machine", *DEEP, cwd=tmp_path, TERM="xterm", LC_ALL="C")
    assert "reference 9.6 V" in seen
    assert seen.isascii()


@pytest.mark.slow
def test_a_dumb_terminal_gets_lines(tmp_path: Path) -> None:
    _, seen = on_a_terminal("machine", *SHALLOW, "--seed", "1", cwd=tmp_path, TERM="dumb", LC_ALL="C.UTF-8")
    assert "reference 9.6 V" in seen
    assert "\x1b" not in seen


def test_ascii_locales_do_not_break_the_output(tmp_path: Path) -> None:
    said = in_process_of_its_own(
        "machine", "--profile", "cu270", "--dry-run", cwd=tmp_path, PYTHONIOENCODING="ascii"
    )
    assert said.exit_code == 0
    assert "180.00 ?m" in said.out


@pytest.mark.parametrize(
    ("arguments", "shown"),
    tiers(
        (("machine", "--profile", CU270, "--seed", "1", "--run-id", "r"), b"touch"),
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
    run_file = tmp_path / "runs" / "r.h5"
    if arguments[0] == "machine":
        with h5py.File(run_file) as file:
            assert file["/entry/exit_code"][()] == 129
            assert file["/entry/servo/v_cmd"][-1] == 0.0
