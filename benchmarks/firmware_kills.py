"""Hosts that die over the firmware's core: `python -m benchmarks.firmware_kills [--kills 100] [--jobs 2]`.

A host cuts on a served machine at the pace of a real one and is killed (SIGKILL) at a random instant: a process that
speaks EDM Link and sends heartbeats as `edmctl machine` does, but begins with the approach. The machine's account
tells when pulses were off: at most 260 ms of controller time after the kill, or after the last frame that the dead
host had left in the line. Then fault 1001 is latched, no pulse comes, and the tool goes back to 0 V. `--controller`
takes another than the core in double. Exit code 1 where one goes wrong.
"""

from __future__ import annotations

import argparse
import random
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

from benchmarks.kills import HOST_SILENT, PULSES_OFF_S, settle
from benchmarks.plant_record import recorded
from benchmarks.serving import environment
from edmctl.link import messages as m
from edmctl.link.opening import open_line
from edmctl.link.session import Session
from edmctl.simulator.config import CONTROLLERS, FIRMWARE

if TYPE_CHECKING:
    from benchmarks.plant_record import Recorded

DUTY_V = 12.0
WATCH_S = 0.6
SPARKS_S = 20.0
MOST_STARTS = 10


def host(link: str) -> None:
    """Approach and cut until killed; a line on stdout when the cut has begun."""
    session, crc = Session(open_line(link)), m.param_crc({})
    session.open(5.0)
    generator = m.PulseConfig(130.435, 304.348, DUTY_V / 0.3, 0.12, m.PulseMode.ISOFREQUENCY, 0.0)
    for request in (m.CommitProfile(crc), generator, m.Arm(crc), m.PulseEnable(1)):
        session.request(request)
    session.request(m.StageMove(m.Axis.X, 0, 50_000_000))
    session.pump(0.3)
    session.request(m.TlmStart(1000, 14, m.PulseLog.BLOCKS))
    session.request(m.Approach(40.0, 100.0, 0.9 * DUTY_V))
    while session.request(m.GetStatus()).state == m.State.APPROACH:
        session.pump(0.02)
    session.request(m.ServoStart(0.8 * DUTY_V, 500.0, 1e5))
    print("cutting", flush=True)
    while True:
        session.pump(0.05)


def kill_one(home: Path, machine: Recorded, chance: random.Random) -> tuple[float, float, str]:
    """Kill a host; controller time from kill and from last frame to pulses off, ms, and what went wrong.

    Again where a busy computer let it starve before: it had no sparks, or a fault already.
    """
    for _ in range(MOST_STARTS):
        outcome = _once(home, machine, chance)
        if outcome is not None:
            return outcome
    return 0.0, 0.0, f"no host of {MOST_STARTS} had sparks to the end"


def _once(home: Path, machine: Recorded, chance: random.Random) -> tuple[float, float, str] | None:
    process = subprocess.Popen(
        [sys.executable, "-m", "benchmarks.firmware_kills", "--host", str(machine.link)],
        cwd=home,
        env=environment(home),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        began = process.stdout.readline()
        time.sleep(chance.uniform(0.0, 0.6))
        killed_s = time.monotonic()
    finally:
        process.kill()
        process.communicate()
    if not began:
        settle(machine.link)
        return None
    end_s = time.monotonic() + SPARKS_S
    while not machine.rows()[-1]["fault"] and time.monotonic() < end_s:
        time.sleep(0.05)
    time.sleep(WATCH_S)
    rows = machine.rows()
    state, actuator_v = settle(machine.link)
    before, end = rows[rows["time_s"] <= killed_s][-1], rows[-1]
    heard = rows[1:][rows["heard"][1:] > rows["heard"][:-1]][-1]
    killed_tick = before["tick"] + 1000.0 * (killed_s - before["time_s"])
    off_tick = end["fault_tick"]
    after = rows[rows["tick"] >= off_tick]
    kill_ms, frame_ms = float(off_tick - killed_tick), float(off_tick - heard["tick"])
    wrong = ""
    if before["fault"]:
        return None
    if end["fault"] != HOST_SILENT or state is not m.State.FAULT or actuator_v > 0.0:
        wrong = f"{state.name}, fault {end['fault']}, {actuator_v:.1f} V at the end"
    elif min(kill_ms, frame_ms) > 1000.0 * PULSES_OFF_S:
        wrong = f"pulses off {kill_ms:.0f} ms after the kill, {frame_ms:.0f} ms after the last frame"
    elif after[-1]["pulses"] > after[0]["pulses"] or before["pulses"] == rows[0]["pulses"]:
        wrong = "pulses after the fault, or none before"
    return kill_ms, frame_ms, wrong


def kill_several(home: Path, controller: str, seed: int, kills: int) -> list[tuple[float, float, str]]:
    """Kill so many hosts on one bench."""
    chance, profile = (
        random.Random(seed),
        ("cu270", "approach.offset_um=45.5", f'sim.controller="{controller}"'),
    )
    with recorded(home, f"edm{seed}", seed, profile) as machine:
        return [kill_one(home, machine, chance) for _ in range(kills)]


def main() -> int:
    """Kill the hosts and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--controller", choices=CONTROLLERS, default=FIRMWARE)
    parser.add_argument("--host", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.host:
        host(arguments.host)
    jobs, each = arguments.jobs, arguments.kills // arguments.jobs
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(jobs) as pool:
        home = Path(folder)
        lots = pool.map(lambda seed: kill_several(home, arguments.controller, seed, each), range(1, jobs + 1))
        outcomes = [outcome for lot in lots for outcome in lot]
    for name, times_ms in (
        ("the kill", sorted(o[0] for o in outcomes)),
        ("its last frame", sorted(o[1] for o in outcomes)),
    ):
        print(
            f"pulses off after {name}: {times_ms[0]:.0f} to {times_ms[-1]:.0f} ms of controller time "
            f"(median {times_ms[len(times_ms) // 2]:.0f}; bar {1000 * PULSES_OFF_S:.0f})"
        )
    wrong = [f"kill {n}: {outcome[2]}" for n, outcome in enumerate(outcomes) if outcome[2]]
    print(
        f"{len(outcomes)} hosts of {arguments.controller} killed while sparking, {len(wrong)} went wrong (bar: 0)"
    )
    for line in wrong:
        print(f"  {line}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
