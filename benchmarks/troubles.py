"""Troubles of the line: `python -m benchmarks.troubles`.

`edmctl machine` over a pty at the pace of a real machine: what it says, and how long after the trouble it has ended.
Each must be a clear error within 2 s, and a disk that stands still for 2 s under journal and ledger none.
Exit code 1 where that is not so.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
import tty
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmarks.serving import environment, result, served, start

if TYPE_CHECKING:
    from collections.abc import Iterator

BAR_S = 2.0
QUICK = ("-p", "cu270", "--set", "target.depth_um=8", "--json", "--quiet")
SLOW_DISK = """
import os, time
sync = os.fsync
def slow_sync(number):
    if any(name in os.readlink(f"/proc/self/fd/{number}") for name in ("journal", "ledger")):
        time.sleep(2.0)
    sync(number)
os.fsync = slow_sync
from edmctl.__main__ import main
main()
"""
AT = b"AT\r\nATZ\r\nAT+CGMI\r\n+++ATH\r\n"
_ERROR = "error"


class Report:
    """Prints a line per trouble and keeps whether all went well."""

    def __init__(self) -> None:
        self.well = True

    def line(
        self, name: str, seconds: float, code: int, wanted: int, document: dict[str, Any], err: str
    ) -> None:
        """Judge one trouble: its time, exit code and message."""
        told = document.get(_ERROR) or {}
        clear = bool(told.get("message") and told.get("hint")) and "Traceback" not in err
        good = seconds <= BAR_S and code == wanted and clear
        self.well = self.well and good
        mark = "" if good else "   MISSED"
        print(
            f"{name:34} {seconds:5.2f} s  exit {code} {told.get('code', '')}  {told.get('message', '')}{mark}"
        )


def injected(report: Report, home: Path, fault: str, name: str, wanted: int) -> None:
    """Let the server break something in mid-job, and take the time from when it says so."""
    link = home / "edm"
    server = subprocess.Popen(
        [
            sys.executable,
            "-m",
            "edmctl",
            "simulate",
            "serve",
            "--link",
            str(link),
            "--fault",
            fault,
            "-p",
            "cu270",
        ],
        cwd=home,
        env=environment(home),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert server.stderr is not None
    server.stderr.readline()
    process = start(home, "machine", "--port", str(link), *QUICK)
    server.stderr.readline()
    begin_s = time.monotonic()
    code, document, err = result(process)
    report.line(name, time.monotonic() - begin_s, code, wanted, document, err)
    server.terminate()
    server.communicate()


def slow_disk(report: Report, home: Path) -> None:
    """Machine on a disk that takes 2 s for each sync of journal and ledger (Linux)."""
    with served(home, "-p", "cu270", "--speed", "1", name="slow") as link:
        done = subprocess.run(
            [sys.executable, "-c", SLOW_DISK, "machine", "--port", str(link), *QUICK],
            cwd=home,
            env=environment(home),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
        )
    report.well = report.well and done.returncode == 0
    told = done.stderr.strip()[-80:] or "no harm"
    print(f"{'a disk that takes 2 s for a sync':34}          exit {done.returncode}  {told}")


def killed_server(report: Report, home: Path) -> None:
    """Kill the server in mid-job: to the host, the cable is gone."""
    with served(home, "-p", "cu270", name="killed") as link:
        process = start(home, "machine", "--port", str(link), *QUICK)
        time.sleep(4.0)
        subprocess.run(["pkill", "-KILL", "-f", f"simulate serve --link {link}"], check=False)
        begin_s = time.monotonic()
        code, document, err = result(process)
    report.line("the controller vanishes", time.monotonic() - begin_s, code, 4, document, err)


@contextmanager
def device(says: bytes) -> Iterator[str]:
    """A pty on which something that is no controller answers every byte with text, or nothing at all."""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    over = threading.Event()

    def talk() -> None:
        while not over.is_set():
            try:
                if os.read(ours, 1024) and says:
                    os.write(ours, says)
            except OSError:
                return

    thread = threading.Thread(target=talk, daemon=True)
    thread.start()
    try:
        yield os.ttyname(theirs)
    finally:
        over.set()
        os.write(theirs, b"\n")
        thread.join()
        os.close(ours)
        os.close(theirs)


def started(home: Path, *arguments: str) -> tuple[float, int, dict[str, Any], str]:
    """Run a command; its time without that of an interpreter's start with the same imports."""
    begin_s = time.monotonic()
    subprocess.run(
        start(home, "machine", "-p", "cu270", "--dry-run", "--json").args, **_quiet(home), check=False
    )
    idle_s = time.monotonic() - begin_s
    begin_s = time.monotonic()
    code, document, err = result(start(home, *arguments))
    return time.monotonic() - begin_s - idle_s, code, document, err


def _quiet(home: Path) -> dict[str, Any]:
    return {"cwd": home, "env": environment(home), "capture_output": True}


def main() -> int:
    """Bring about every trouble and return the exit code."""
    report = Report()
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        injected(report, home, "UNPLUG@arm+1", "unplugged in mid-job", 4)
        injected(report, home, "BROWN_OUT@arm+1", "controller restarts in mid-job", 4)
        injected(report, home, "POWER_LOSS@arm+1", "controller loses power in mid-job", 4)
        injected(report, home, "SILENCE@arm+1", "frames of the host get lost", 6)
        killed_server(report, home)
        slow_disk(report, home)
        for says, name in (
            (b"Grbl 1.1h ['$' for help]\r\n", "another device answers"),
            (b"", "nobody answers"),
        ):
            with device(says) as port:
                report.line(name, *_ordered(started(home, "machine", "--port", port, *QUICK), 4))
        with served(home, "-p", "cu270", "--speed", "1", name="shared") as link:
            first = start(home, "machine", "--port", str(link), *QUICK)
            time.sleep(4.0)
            found = started(home, "machine", "--port", str(link), *QUICK)
            report.line("a second process on the port", *_ordered(found, 4))
            first.send_signal(signal.SIGINT)
            first.communicate()
        with served(home, "-p", "cu270", "--speed", "max", name="chatter") as link:
            with link.open("wb", buffering=0) as modem_manager:
                modem_manager.write(AT)
                process = start(home, "machine", "--port", str(link), *QUICK)
                for _ in range(20):
                    modem_manager.write(AT)
                    time.sleep(0.05)
            code, _, err = result(process)
            report.well = report.well and code == 0
            print(
                f"{'AT strings while the port is opened':34}          exit {code}  {err.strip()[-80:] or 'no harm'}"
            )
    return 0 if report.well else 1


def _ordered(
    found: tuple[float, int, dict[str, Any], str], wanted: int
) -> tuple[float, int, int, dict[str, Any], str]:
    seconds, code, document, err = found
    return seconds, code, wanted, document, err


if __name__ == "__main__":
    sys.exit(main())
