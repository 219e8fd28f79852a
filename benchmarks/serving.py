"""Served virtual controllers and commands run against them; one at the pace of a machine, with its own account.

`recorded` serves as `edmctl simulate serve --speed 1` does, and writes a row of what the plant knows for every turn
of its loop, some milliseconds apart.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

ROOT = Path(__file__).parents[1]
READY_S = 60.0
ROW = np.dtype(
    [
        ("time_s", "<f8"),  # of the clock on the wall, as time.monotonic() tells it to every process
        ("pulses", "<i8"),  # made so far
        ("actuator_v", "<f8"),
        ("state", "<i4"),
        ("fault", "<i4"),
    ]
)


def environment(home: Path) -> dict[str, str]:
    """The environment of commands that run in `home`."""
    return {**os.environ, "EDMCTL_HOME": str(home), "PYTHONPATH": str(ROOT)}


def start(home: Path, *arguments: str, module: str = "edmctl") -> subprocess.Popen[str]:
    """Start a command, or a module of benchmarks, with pipes for its streams."""
    return subprocess.Popen(
        [sys.executable, "-m", module, *arguments],
        cwd=home,
        env=environment(home),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def result(process: subprocess.Popen[str]) -> tuple[int, dict[str, Any], str]:
    """Wait for a command; its return code, JSON object and stderr."""
    out, err = process.communicate()
    return process.returncode, json.loads(out) if out.strip() else {}, err


@contextmanager
def _server(home: Path, link: Path, *command: str) -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen(
        [sys.executable, "-m", *command],
        cwd=home,
        env=environment(home),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        end_s = time.monotonic() + READY_S
        while not link.exists():
            if process.poll() is not None or time.monotonic() > end_s:
                raise RuntimeError("the server did not start")
            time.sleep(0.05)
        yield process
    finally:
        process.terminate()
        process.wait(timeout=30)
        link.unlink(missing_ok=True)


@contextmanager
def served(home: Path, *options: str, name: str = "edm") -> Iterator[Path]:
    """Serve a virtual controller on `home/name` while the block runs."""
    link = home / name
    with _server(home, link, "edmctl", "simulate", "serve", "--quiet", "--link", str(link), *options):
        yield link


@contextmanager
def recorded(home: Path, name: str, seed: int, profile: tuple[str, ...]) -> Iterator[Recorded]:
    """Serve the bench of a profile with its overrides at the pace of a real machine while the block runs."""
    link, file = home / name, home / f"{name}.rows"
    arguments = (str(link), str(seed), str(file), *profile)
    with _server(home, link, "benchmarks.serving", *arguments) as server:
        yield Recorded(link, file, server)
    file.unlink(missing_ok=True)


class Recorded:
    """A served machine and its record."""

    def __init__(self, link: Path, file: Path, server: subprocess.Popen[bytes]) -> None:
        self.link, self.server = link, server
        self._file = file

    def rows(self) -> NDArray[np.void]:
        """Everything so far, oldest first."""
        data = self._file.read_bytes()
        return np.frombuffer(data[: len(data) // ROW.itemsize * ROW.itemsize], ROW)

    def wait_for_pulses(self, timeout_s: float = 5.0) -> None:
        """Return once pulses are made."""
        begin, end_s = self.rows()["pulses"][-1], time.monotonic() + timeout_s
        while self.rows()["pulses"][-1] == begin:
            if time.monotonic() > end_s:
                raise RuntimeError("no pulses")
            time.sleep(0.01)


def main() -> None:
    """Serve with an account until killed."""
    from edmctl.jobs.connect import bench_config
    from edmctl.planning.rules.load import load_profile
    from edmctl.profile.setup import Setup
    from edmctl.simulator import open_bench
    from edmctl.simulator.serve import PtyEndpoint, Server

    link, seed, file, profile, *overrides = sys.argv[1:]
    bench = open_bench(bench_config(load_profile(profile, tuple(overrides)), Setup()), int(seed))
    controller, parent = bench.controller, os.getppid()
    with Path(file).open("wb", buffering=0) as rows:

        def note() -> None:
            if os.getppid() != parent:
                raise SystemExit("whoever measures is gone")
            pulses, actuator_v = controller.loop.pulse_no, bench.plant.drive.actuator_v
            row = (time.monotonic(), pulses, actuator_v, controller.state, controller.fault)
            rows.write(np.array(row, ROW).tobytes())

        note()
        Server(bench, PtyEndpoint(Path(link)), 1.0, note).run(lambda: False)


if __name__ == "__main__":
    main()
