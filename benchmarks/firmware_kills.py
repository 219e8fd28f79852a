"""Hosts that die over the firmware's core: `python -m benchmarks.firmware_kills [--kills 100] [--jobs 4]`.

`edmctl machine` sparks on a served machine at the pace of a real one and is killed (SIGKILL) at a random instant.
The plant's own account tells when the last pulse was made: at most 260 ms of controller time after the kill. Then
fault 1001 is latched, and the tool back at 0 V. `--controller` takes another than the core in double. Exit code 1
where one goes wrong.
"""

from __future__ import annotations

import argparse
import random
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from benchmarks.kills import HOST_SILENT, PULSES_OFF_S, SETUP, settle, wait_for
from benchmarks.plant_record import recorded
from benchmarks.serving import start
from benchmarks.unwatched import QUICK, STARVED_S
from edmctl.link.messages import State
from edmctl.simulator.config import CONTROLLERS, FIRMWARE

WATCH_S = 1.0
MOST_STARTS = 5


def kill_one(home: Path, controller: str, number: int) -> tuple[float, str]:
    """Kill a host, again if the computer was too busy; controller time to the last pulse (s), mistakes."""
    for _ in range(MOST_STARTS):
        outcome = _once(home, controller, number)
        if outcome is not None:
            return outcome
    return 0.0, f"the computer was too busy for {MOST_STARTS} jobs"


def _once(home: Path, controller: str, number: int) -> tuple[float, str] | None:
    chance, name = random.Random(f"kill {number}"), f"kill{number}"
    profile = ("cu270", *QUICK, f'sim.controller="{controller}"')
    with recorded(home, name, number, profile) as machine:
        options = [word for text in QUICK for word in ("--set", text)]
        place = ("--setup", "setup.toml", "--out", f"runs-{name}", "--events", "--port", str(machine.link))
        host = start(home, "machine", "-p", "cu270", *place, *options)
        try:
            if not wait_for(host, "machining"):
                return None
            machine.wait_for_pulses()
            time.sleep(chance.uniform(0.0, 1.0))
            killed_s = time.monotonic()
        finally:
            host.kill()
            host.wait()
        time.sleep(WATCH_S)
        rows = machine.rows()
        state, actuator_v = settle(machine.link)
    before, end = rows[rows["time_s"] <= killed_s][-1], rows[-1]
    steps_s = rows["time_s"][1:] - rows["time_s"][:-1]
    near = (rows["time_s"][1:] >= killed_s) & (rows["time_s"][:-1] <= killed_s + PULSES_OFF_S)
    if before["fault"] or max(steps_s[near]) > STARVED_S:
        return None
    killed_tick = before["tick"] + 1000.0 * (killed_s - before["time_s"])
    made = rows[1:][rows["pulses"][1:] > rows["pulses"][:-1]]
    off_s = float(made["tick"][-1] - killed_tick) / 1000.0
    if off_s > PULSES_OFF_S:
        return off_s, f"the last pulse {1000 * off_s:.0f} ms after"
    if end["fault"] != HOST_SILENT or state is not State.FAULT or actuator_v > 0.0:
        return off_s, f"{state.name}, fault {end['fault']}, {actuator_v:.1f} V at the end"
    return off_s, ""


def main() -> int:
    """Kill the hosts and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--jobs", type=int, default=4)
    parser.add_argument("--controller", choices=CONTROLLERS, default=FIRMWARE)
    arguments = parser.parse_args()
    numbers = range(1, arguments.kills + 1)
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(arguments.jobs) as pool:
        home = Path(folder)
        (home / "setup.toml").write_text(SETUP, encoding="utf-8")
        outcomes = list(pool.map(lambda number: kill_one(home, arguments.controller, number), numbers))
    times_ms = sorted(1000.0 * off_s for off_s, _ in outcomes)
    wrong = [
        f"kill {number}: {mistake}" for number, (_, mistake) in zip(numbers, outcomes, strict=True) if mistake
    ]
    least_ms, median_ms, most_ms = times_ms[0], times_ms[len(times_ms) // 2], times_ms[-1]
    print(
        f"{len(times_ms)} hosts of {arguments.controller} killed while sparking, {len(wrong)} wrong; last pulse "
        f"{least_ms:.0f} to {most_ms:.0f} ms of controller time after (median {median_ms:.0f}; "
        f"bar {1000 * PULSES_OFF_S:.0f})"
    )
    for line in wrong:
        print(f"  {line}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
