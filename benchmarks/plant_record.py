"""A served virtual controller with the plant's own account: what `edmctl simulate serve --speed 1` does, and a row
of what the plant knows for every turn of its loop, some milliseconds apart, into a file.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.serving import READY_S, environment

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

ROW = np.dtype(
    [
        ("time_s", "<f8"),  # of the clock on the wall, as time.monotonic() tells it to every process
        ("pulses", "<i8"),  # made so far
        ("actuator_v", "<f8"),
        ("state", "<i4"),
        ("fault", "<i4"),
        ("tick", "<i8"),  # milliseconds of the machine
        ("heard", "<i8"),  # frames that came whole
        ("fault_tick", "<i8"),  # when pulses went off for the fault; -1: none
    ]
)


@contextmanager
def recorded(home: Path, name: str, seed: int, profile: tuple[str, ...]) -> Iterator[Recorded]:
    """Serve the bench of a profile with its overrides at the pace of a real machine while the block runs."""
    link, file = home / name, home / f"{name}.rows"
    server = subprocess.Popen(
        [sys.executable, "-m", "benchmarks.plant_record", str(link), str(seed), str(file), *profile],
        cwd=home,
        env=environment(home),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        end_s = time.monotonic() + READY_S
        while not link.exists():
            if server.poll() is not None or time.monotonic() > end_s:
                raise RuntimeError("the server did not start")
            time.sleep(0.05)
        yield Recorded(link, file, server)
    finally:
        server.kill()
        server.wait()
        link.unlink(missing_ok=True)
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
    """Serve until killed."""
    from edmctl.jobs.connect import bench_config
    from edmctl.planning.rules.load import load_profile
    from edmctl.profile.setup import Setup
    from edmctl.simulator import open_bench
    from edmctl.simulator.endpoints import PtyEndpoint
    from edmctl.simulator.serve import Server

    link, seed, file, profile, *overrides = sys.argv[1:]
    bench = open_bench(bench_config(load_profile(profile, tuple(overrides)), Setup()), int(seed))
    controller = bench.controller
    with Path(file).open("wb", buffering=0) as rows:
        parent = os.getppid()

        def note() -> None:
            if os.getppid() != parent:
                raise SystemExit("whoever measures is gone")
            row = (
                time.monotonic(),
                bench.controller.loop.pulse_no,
                bench.plant.drive.actuator_v,
                controller.state,
                controller.fault,
                controller.tick,
                controller.link.rx_frames,
                -1 if controller.black_box.frozen_tick is None else controller.black_box.frozen_tick,
            )
            rows.write(np.array(row, ROW).tobytes())

        note()
        Server(bench, PtyEndpoint(Path(link)), 1.0, note).run(lambda: False)


if __name__ == "__main__":
    main()
