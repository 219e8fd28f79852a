"""Print the project's speed as ratios measured in one run.

    python benchmarks/speed.py [--repeat 5]

Every figure is the best of several repeats, because other work on the machine only ever adds time. Run it with
the interpreter that has edmctl installed; the first repeat fills the caches and does not count.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from edmctl.link.wire import Request

KERNEL_SECONDS = 200
BLOCK_TICKS = 1000


def wall_s(command: list[str]) -> float:
    """Wall time of a command."""
    start = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return time.perf_counter() - start


def ratio(command: list[str], base: list[str], repeat: int) -> float:
    """Shortest wall time of a command over that of another, called by turns so that both see the same machine."""
    pairs = [(wall_s(command), wall_s(base)) for _ in range(repeat + 1)][1:]
    return min(t for t, _ in pairs) / min(t for _, t in pairs)


def import_ratio(repeat: int) -> tuple[float, float]:
    """Wall time of `import edmctl` over that of nothing, by turns: shortest and median."""
    commands = ([sys.executable, "-c", "import edmctl"], [sys.executable, "-c", "pass"])
    pairs = [tuple(map(wall_s, commands)) for _ in range(repeat + 1)][1:]
    with_it, without = zip(*pairs, strict=True)
    return min(with_it) / min(without), median(with_it) / median(without)


def script() -> list[str]:
    """The `edmctl` command of this environment, or the module where it is not installed."""
    installed = Path(sys.executable).parent / "edmctl"
    return [str(installed)] if installed.exists() else [sys.executable, "-m", "edmctl"]


def kernel_speed(repeat: int) -> float:
    """Virtual seconds per second of plant and servo alone, sparking, random numbers included."""
    from edmctl.link import messages as m
    from edmctl.link.session import Session
    from edmctl.simulator import BenchConfig, open_bench

    bench = open_bench(BenchConfig(offset_um=5.0), 1)
    controller, session = bench.controller, Session(bench.transport)
    session.open()
    crc = m.param_crc({})
    request: Request[object]
    for request in (
        m.CommitProfile(crc),
        m.Arm(crc),
        m.PulseEnable(1),
        m.StageMove(m.Axis.X, 0, 50_000_000),
    ):
        session.request(request)
        session.pump(0.24)
    session.request(m.Approach(1.0, 100.0, 10.8))
    while controller.state is m.State.APPROACH:
        session.pump(0.1)
    session.request(m.ServoStart(9.6, 500.0, 1e5))
    best = 0.0
    for _ in range(repeat):
        start = time.perf_counter()
        for _ in range(KERNEL_SECONDS * 1000 // BLOCK_TICKS):
            controller.step(BLOCK_TICKS)
        best = max(best, KERNEL_SECONDS / (time.perf_counter() - start))
        controller.host_heard()
    assert controller.state is m.State.MACHINING
    return best


def job_speed(repeat: int) -> tuple[float, float]:
    """Wall seconds of the whole main job, and virtual seconds of machining per wall second."""
    best, machining_s = float("inf"), 0.0
    with tempfile.TemporaryDirectory() as folder:
        command = [*script(), "machine", "--profile", "cu270", "--json"]
        command += ["--seed", "1", "--out", folder]
        for attempt in range(repeat + 1):
            start = time.perf_counter()
            done = subprocess.run(
                [*command, "--run-id", f"run{attempt}"],
                check=True,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                cwd=Path(folder),
            )
            taken_s = time.perf_counter() - start
            if attempt:
                best = min(best, taken_s)
            machining_s = json.loads(done.stdout)["result"]["machining_time_s"]
    return best, machining_s / best


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--repeat", type=int, default=5)
    repeat = parser.parse_args().repeat
    python = sys.executable
    version = ratio([*script(), "--version"], [python, "-c", "pass"], 6 * repeat)
    help_ratio = ratio([*script(), "--help"], [python, "-c", "import typer"], 2 * repeat)
    least, middle = import_ratio(12 * repeat)
    wall, speed = job_speed(repeat)
    print(f"edmctl --version : python -c pass          {version:7.2f}   (bar 1.5)")
    print(f"edmctl --help : python -c 'import typer'   {help_ratio:7.2f}   (bar 2.5)")
    print(f"import edmctl : python -c pass             {least:7.2f}   (bar 1.3; median {middle:.2f})")
    print(f"main job, wall seconds                     {wall:7.2f}   (bar 3)")
    print(f"main job, machining time : wall time       {speed:7.0f}   (bar 300)")
    print(f"plant + servo kernel : real time           {kernel_speed(repeat):7.0f}   (bar 3000)")


if __name__ == "__main__":
    main()
