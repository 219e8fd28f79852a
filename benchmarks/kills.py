"""Hosts that die: `python -m benchmarks.kills [--kills 100] [--signals 100] [--jobs 2] [--controller firmware]`.

`edmctl machine` works on a served machine at the pace of a real one and is killed (SIGKILL) at a random instant of
its cut. The instant is stamped by the clock that every row of the machine's own account
(benchmarks/plant_record.py) has beside its ticks: where the kill lies between two rows, so does its tick. At most
260 ms of the machine's time later the pulses are off for good, fault 1001 is latched, and the tool goes back to 0
V. Between two ticks the machine makes nothing, so what this computer is late by is told apart, as time on the wall
until the account has the fault. Then SIGINT and SIGTERM at random instants of a whole run: exit code, no
traceback, run file closed, tool back. Exit code 1 where one goes wrong.
"""

from __future__ import annotations

import argparse
import math
import random
import signal
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.plant_record import recorded
from benchmarks.serving import result, served, start
from edmctl.link.messages import ClearFault, GetStatus, State
from edmctl.link.opening import open_line
from edmctl.link.session import Session
from edmctl.simulator.config import CONTROLLERS, FIRMWARE

if TYPE_CHECKING:
    import subprocess

    from benchmarks.plant_record import Recorded

PULSES_OFF_S = 0.260
SETUP = "[actuator]\nconditioning_cycles = 0\n[stage]\npark_x_um = -2200.0\nspeed_um_s = 10000.0\n"
QUICK = ("--set", "approach.speed_um_s=5", "--set", 'log.pulses="off"', "--set", "measure.touches=3")
QUICK_TOUCHES = (
    *("--set", "measure.fast_um_s=200", "--set", "measure.speed_um_s=5"),
    *("--set", "measure.settle_s=0.2", "--set", "measure.dwell_s=0.1"),
)
HOST_SILENT = 1001
WATCH_S = 1.0
SPARKING_S = 0.5
"""A host that is killed has had sparks in so long before."""
MOST_STARTS = 5
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


@dataclass(frozen=True, slots=True)
class Kill:
    """From the kill of a host to pulses off: by the machine's clock and by that on the wall, ms; what went wrong.

    starts : hosts that were started until one cut when it was killed.
    """

    machine_ms: float = math.inf
    wall_ms: float = math.inf
    wrong: str = ""
    starts: int = 1


def kill_runs(home: Path, kills: int, seed: int, controller: str) -> list[Kill]:
    """Kill `kills` hosts on one bench."""
    chance, outcomes = random.Random(seed), list[Kill]()
    with recorded(home, f"edm{seed}", seed, ("cu270", f"sim.controller={controller}")) as machine:
        for number in range(kills):
            for starts in range(1, MOST_STARTS + 1):
                outcome = _kill_run(home, machine, f"k{seed}-{number}-{starts}", chance)
                if outcome is not None:
                    break
            outcome = outcome or Kill(wrong="no host got to its sparks")
            outcomes.append(replace(outcome, starts=starts))
    return outcomes


def _kill_run(home: Path, machine: Recorded, name: str, chance: random.Random) -> Kill | None:
    """Kill one host; None where it did not cut: it had ended, or a busy computer had let it starve."""
    options = ("--setup", "setup.toml", "--run-id", name, "--new-tool", "--events", *QUICK, *QUICK_TOUCHES)
    process = start(home, "machine", "-p", "cu270", "--port", str(machine.link), *options)
    cuts = wait_for(process, "machining")
    time.sleep(chance.uniform(0.0, 1.5))
    ended = process.poll() is not None
    killed_s = time.monotonic()
    process.kill()
    process.wait()
    time.sleep(WATCH_S)
    rows = machine.rows()
    before, after, end = rows[rows["time_s"] <= killed_s], rows[rows["time_s"] > killed_s], rows[-1]
    state, actuator_v = settle(machine.link)
    cutting = before[before["time_s"] > killed_s - SPARKING_S]
    if not cuts or ended or before[-1]["fault"] or cutting[-1]["pulses"] == cutting[0]["pulses"]:
        return None
    if end["fault"] != HOST_SILENT or state is not State.FAULT or actuator_v > 0.0:
        return Kill(wrong=f"{state.name}, fault {end['fault']}, {actuator_v:.1f} V at the end")
    off_tick, killed_tick = float(end["fault_tick"]), np.interp(killed_s, rows["time_s"], rows["tick"])
    machine_ms = off_tick - float(killed_tick)
    wall_ms = 1000.0 * float(after[after["fault"] == HOST_SILENT][0]["time_s"] - killed_s)
    off = rows[rows["tick"] >= off_tick]
    wrong = ""
    if machine_ms > 1000.0 * PULSES_OFF_S:
        heard = rows[1:][rows["heard"][1:] > rows["heard"][:-1]][-1]
        late_ms = 1000.0 * float(heard["time_s"] - killed_s)
        wrong = (
            f"pulses off after {machine_ms:.0f} ms; its last frame was read {late_ms:+.0f} ms from the kill"
        )
    elif off[-1]["pulses"] > off[0]["pulses"]:
        wrong = "pulses after the fault"
    return Kill(machine_ms, wall_ms, wrong)


def signal_runs(home: Path, signals: int, seed: int, controller: str) -> tuple[int, list[str]]:
    """Stop `signals` hosts at random instants of their runs; how many had begun a run file, what went wrong."""
    chance, wrong, begun = random.Random(seed), [], 0
    for first in range(0, signals, RUNS_A_TOOL):
        numbers = range(first, min(signals, first + RUNS_A_TOOL))
        options = (
            *("--seed", str(seed + first), "--profile", "cu270", "--speed", "20"),
            *("--controller", controller),
        )
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


def _tell(what: str, times_ms: list[float], bar_ms: float | None = None) -> None:
    """Print how times are spread: range and tenths."""
    ordered = sorted(times_ms)
    tenths = ", ".join(f"{ordered[round(k / 10 * (len(ordered) - 1))]:.0f}" for k in range(11))
    bar = f" (bar {bar_ms:.0f})" if bar_ms is not None else ""
    print(f"pulses off, {what}, least to most by tenths of the kills: {tenths} ms{bar}")


def main() -> int:
    """Run both and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--signals", type=int, default=100)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--controller", choices=CONTROLLERS, default=FIRMWARE)
    arguments = parser.parse_args()
    jobs, first = arguments.jobs, arguments.seed
    seeds = range(first, first + jobs)
    kind = arguments.controller
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(jobs) as pool:
        home = Path(folder)
        (home / "setup.toml").write_text(SETUP, encoding="utf-8")
        lots = pool.map(lambda seed: kill_runs(home, arguments.kills // jobs, seed, kind), seeds)
        killed = [kill for lot in lots for kill in lot]
        each = arguments.signals // jobs
        stopped = list(pool.map(lambda seed: signal_runs(home, each, seed, kind), seeds))
    lost = sum(kill.starts - 1 for kill in killed)
    print(f"{len(killed)} hosts of {kind} killed while sparking; {lost} more did not get there or starved")
    if killed:
        _tell("of the machine's time", [kill.machine_ms for kill in killed], 1000.0 * PULSES_OFF_S)
        _tell("on the wall, until the account has it", [kill.wall_ms for kill in killed])
    print(
        f"{each * jobs} hosts stopped by SIGINT or SIGTERM, "
        f"{sum(begun for begun, _ in stopped)} with a run file begun"
    )
    wrong = [f"kill {number}: {kill.wrong}" for number, kill in enumerate(killed) if kill.wrong]
    wrong += [line for _, lines in stopped for line in lines]
    print(f"went wrong: {len(wrong)} (bar: 0)")
    for line in wrong:
        print(f"  {line}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
