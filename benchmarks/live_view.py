"""Print what the live view costs: the share of a core at 10 Hz, and what it adds to a job on the virtual machine.

    python benchmarks/live_view.py [--seconds 10] [--repeat 3] [--shallow]

The states are those of a real run of the main job. They are drawn at 10 Hz of wall time into a pseudo-terminal that
somebody reads. The job is then run with its messages on a terminal and in a pipe, by turns, best of several: CPU
time of the whole process, which other work on the machine disturbs less than wall time.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import pty
import resource
import struct
import subprocess
import sys
import tempfile
import time
from datetime import UTC, datetime
from itertools import cycle, islice
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from edmctl.results.progress import Progress

SEED = 1
HZ = 10.0
SIZES = ((60, 24), (80, 24), (200, 50))


class Kept:
    """An observer that keeps every state."""

    def __init__(self) -> None:
        self.states: list[Progress] = []

    def progress(self, p: Progress) -> None:
        """Keep it."""
        self.states.append(p)

    def note(self, text: str) -> None:
        """Notes are rare."""


def states_of_a_run(folder: Path) -> list[Progress]:
    """All states of the main job, to a shallow depth."""
    from edmctl.jobs.job import carry_out
    from edmctl.jobs.plan import JobRequest, check
    from edmctl.jobs.run_header import RunName

    kept = Kept()
    plan = check(JobRequest(profile="cu270", overrides=("target.depth_um=20",), setup=None, port=None))
    carry_out(plan, SEED, kept, RunName("kept", folder / "kept.h5", datetime.now(UTC)))
    return kept.states


@contextlib.contextmanager
def terminal(width: int, height: int) -> Iterator[int]:
    """Give a pseudo-terminal of this size, whose other end is read."""
    import fcntl
    import termios

    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", height, width, 0, 0))
    reader = subprocess.Popen(["cat"], stdin=ours, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    os.close(ours)
    try:
        yield theirs
    finally:
        os.close(theirs)
        reader.wait()


def core_share(states: Sequence[Progress], size: tuple[int, int], seconds: float) -> float:
    """CPU seconds per second of following a machine at 10 Hz, all of this process counted."""
    from edmctl.cli.render.live import LiveReporter
    from edmctl.cli.render.style import Style

    with terminal(*size) as number, os.fdopen(os.dup(number), "w", encoding="utf-8") as stream:
        reporter = LiveReporter(stream, Style(colour=True, live=True))
        for state in states[:600]:
            reporter.progress(state)
        begin_s, cpu_s = time.perf_counter(), time.process_time()
        due_s = begin_s
        for state in islice(cycle(states[600:]), round(seconds * HZ)):
            reporter.progress(state)
            due_s += 1.001 / HZ
            time.sleep(max(0.0, due_s - time.perf_counter()))
        share = (time.process_time() - cpu_s) / (time.perf_counter() - begin_s)
        reporter.close()
    return share


def job_s(folder: str, run_id: str, depth_um: int, *, on_terminal: bool) -> tuple[float, float]:
    """CPU time and wall time of the whole command."""
    command = [sys.executable, "-m", "edmctl", "machine", "--profile", "cu270", "--json", "--seed", str(SEED)]
    command += ["--set", f"target.depth_um={depth_um}", "--out", folder, "--run-id", run_id]
    environ = {**os.environ, "TERM": "xterm-256color", "LANG": "C.UTF-8"}
    with terminal(100, 40) as number:
        begin_s = time.perf_counter()
        # A pipe's reader is another `cat`, so that both ways have somebody to wake.
        pipe = None if on_terminal else subprocess.Popen(["cat"], stdin=subprocess.PIPE, stdout=number)
        stderr = number if pipe is None else pipe.stdin
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=stderr, env=environ)
        taken_s = time.perf_counter() - begin_s
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        if pipe is not None:
            pipe.communicate()
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, taken_s


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--shallow", action="store_true", help="a hole of 40 µm instead of 180 µm")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        os.environ["EDMCTL_HOME"] = folder
        states = states_of_a_run(Path(folder))
        for size in SIZES:
            share = core_share(states, size, asked.seconds)
            print(f"live view at 10 Hz, {size[0]:3} × {size[1]}, of a core   {100 * share:7.2f} %  (bar 5)")
        depth_um = 40 if asked.shallow else 180
        pairs = [
            (
                job_s(folder, f"tty{i}", depth_um, on_terminal=True),
                job_s(folder, f"pipe{i}", depth_um, on_terminal=False),
            )
            for i in range(asked.repeat + 1)
        ][1:]
    for kind, what in enumerate(("CPU", "wall")):
        shown_s, piped_s = min(shown[kind] for shown, _ in pairs), min(piped[kind] for _, piped in pairs)
        print(f"job of {depth_um} µm, {what} seconds: terminal {shown_s:.2f}, pipe {piped_s:.2f}, ", end="")
        print(f"ratio {shown_s / piped_s:.3f}")


if __name__ == "__main__":
    main()
