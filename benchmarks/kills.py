"""Hosts that die: `python -m benchmarks.kills [--kills 100] [--signals 100] [--jobs 2]`.

`edmctl machine` works on a served virtual controller at the speed of a real machine and is killed (SIGKILL) at a
random instant while it sparks. Whoever listens on the line sees when the pulses end: at most 260 ms later, and the
tool goes back to 0 V. Then SIGINT and SIGTERM at random instants of a whole run: exit code, no traceback, run file
closed, tool back. Exit code 1 where one goes wrong.
"""

from __future__ import annotations

import argparse
import os
import random
import select
import signal
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING

from benchmarks.serving import result, served, start
from edmctl.errors import EdmError
from edmctl.link.frame import FrameDecoder
from edmctl.link.messages import ClearFault, Fault, GetStatus, State
from edmctl.link.opening import open_line
from edmctl.link.session import Session

if TYPE_CHECKING:
    import subprocess

PULSES_OFF_S = 0.260
SETUP = "[actuator]\nconditioning_cycles = 0\n[stage]\npark_x_um = -2200.0\nspeed_um_s = 10000.0\n"
QUICK = ("--set", "approach.speed_um_s=5", "--set", 'log.pulses="off"', "--set", "measure.touches=3")
HOST_SILENT = 1001
RUNS_A_TOOL = 8
"""The tool wears from run to run; after so many the bench is a new one."""


def wait_for(process: subprocess.Popen[str], phase: str) -> bool:
    """Read the events until the phase begins; what comes later is thrown away."""
    assert process.stderr is not None
    stream = process.stderr
    for line in stream:
        if f'"{phase}"' in line:
            Thread(target=stream.read, daemon=True).start()
            return True
    return False


def listen(link: Path, killed_s: float) -> float:
    """Listen on the line that the dead host left, and return how long after its death the fault was told."""
    port = os.open(link, os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK)
    decoder = FrameDecoder(watch_for_abort=False)
    try:
        while time.monotonic() - killed_s < 5.0:
            if not select.select([port], [], [], 0.5)[0]:
                continue
            with suppress(BlockingIOError):
                for frame in decoder.feed(os.read(port, 65536)):
                    if frame.type_id == Fault.ID and Fault.unpack(frame.payload).code == HOST_SILENT:
                        return time.monotonic() - killed_s
    finally:
        os.close(port)
    return float("inf")


def settle(link: Path) -> tuple[State, float]:
    """Say hello, wait for the end of the retreat; state and actuator voltage, and clear the fault."""
    session = Session(open_line(str(link)))
    try:
        session.open(2.0)
        end_s = time.monotonic() + 5.0
        status = session.request(GetStatus())
        while status.actuator_v > 0.0 and time.monotonic() < end_s:
            session.pump(0.05)
            status = session.request(GetStatus())
        if status.fault:
            session.request(ClearFault(status.fault))
        return State(status.state), status.actuator_v
    finally:
        session.close()


def kill_runs(home: Path, kills: int, seed: int) -> tuple[list[float], list[str]]:
    """Kill `kills` hosts on one bench; times to the fault and what went wrong."""
    chance, times_s, wrong = random.Random(seed), [], []
    with served(home, "--seed", str(seed), "--profile", "cu270", "--speed", "1", name=f"edm{seed}") as link:
        for number in range(kills):
            options = ("--setup", "setup.toml", "--run-id", f"k{seed}-{number}", "--events", *QUICK)
            process = start(home, "machine", "-p", "cu270", "--port", str(link), *options)
            if not wait_for(process, "machining"):
                wrong.append(f"kill {number}: the job did not get to its sparks (exit {process.wait()})")
                with suppress(EdmError):
                    settle(link)
                continue
            time.sleep(chance.uniform(0.0, 1.5))
            killed_s = time.monotonic()
            process.kill()
            times_s.append(listen(link, killed_s))
            process.wait()
            state, actuator_v = settle(link)
            if times_s[-1] > PULSES_OFF_S:
                wrong.append(f"kill {number}: pulses off after {1000 * times_s[-1]:.0f} ms")
            if state is not State.FAULT or actuator_v > 0.0:
                wrong.append(f"kill {number}: {state.name} at {actuator_v:.1f} V")
    return times_s, wrong


def signal_runs(home: Path, signals: int, seed: int) -> tuple[int, list[str]]:
    """Stop `signals` hosts at random instants of their runs; how many had begun a run file, what went wrong."""
    chance, wrong, begun = random.Random(seed), [], 0
    for first in range(0, signals, RUNS_A_TOOL):
        numbers = range(first, min(signals, first + RUNS_A_TOOL))
        options = ("--seed", str(seed + first), "--profile", "cu270", "--speed", "20")
        with served(home, *options, name=f"edm{seed}") as link:
            for number in numbers:
                has_file, mistakes = _signal_run(home, link, f"s{seed}-{number}", chance)
                begun += has_file
                wrong += [f"signal {seed}-{number}: {mistake}" for mistake in mistakes]
    return begun, wrong


def _signal_run(home: Path, link: Path, name: str, chance: random.Random) -> tuple[bool, list[str]]:
    """Stop one host; whether it had begun a run file, and what went wrong."""
    stop = chance.choice((signal.SIGINT, signal.SIGTERM))
    options = ("--setup", "setup.toml", "--run-id", name, "--json", *QUICK)
    process = start(home, "machine", "-p", "cu270", "--port", str(link), *options)
    time.sleep(chance.uniform(0.05, 8.0))
    process.send_signal(stop)
    code, document, err = result(process)
    state, actuator_v = settle(link)
    file = home / "runs" / f"{name}.h5"
    checks = {
        f"exit {code} after {stop.name}; {err[-200:]}": code == -stop,
        "a traceback": "Traceback" not in err,
        "the JSON object says another exit code": not document or document["exit_code"] == 128 + stop,
        "the run file was left open": not file.with_suffix(".h5.partial").exists(),
        f"{state.name} at {actuator_v:.1f} V": state is State.IDLE and actuator_v == 0.0,
    }
    return file.exists(), [mistake for mistake, well in checks.items() if not well]


def main() -> int:
    """Run both and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--signals", type=int, default=100)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    jobs, first = arguments.jobs, arguments.seed
    seeds = range(first, first + jobs)
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(jobs) as pool:
        home = Path(folder)
        (home / "setup.toml").write_text(SETUP, encoding="utf-8")
        each = [arguments.kills // jobs] * jobs
        killed = list(pool.map(lambda pair: kill_runs(home, *pair), zip(each, seeds, strict=True)))
        each = [arguments.signals // jobs] * jobs
        stopped = list(pool.map(lambda pair: signal_runs(home, *pair), zip(each, seeds, strict=True)))
    times_ms = sorted(1000.0 * t for times, _ in killed for t in times)
    if times_ms:
        print(
            f"{len(times_ms)} hosts killed while sparking: pulses off after {times_ms[0]:.0f} to {times_ms[-1]:.0f} "
            f"ms (median {times_ms[len(times_ms) // 2]:.0f}; bar {1000 * PULSES_OFF_S:.0f})"
        )
    print(
        f"{sum(each)} hosts stopped by SIGINT or SIGTERM, {sum(begun for begun, _ in stopped)} with a run file begun"
    )
    wrong = [line for _, lines in [*killed, *stopped] for line in lines]
    print(f"went wrong: {len(wrong)} (bar: 0)")
    for line in wrong:
        print(f"  {line}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
