"""No spark without a watching host: `python -m benchmarks.unwatched [--count 100] [--jobs 4] [--cases NAME ...]`.

`edmctl machine` sparks on a served virtual controller at the pace of a real machine when, at a random instant,

- killed host: the host is killed (SIGKILL);
- new session: the same, and 0 to 0.2 s later another host says HELLO and only sends heartbeats;
- frozen controller: the server is stopped (SIGSTOP) for 0.3 to 3 s and goes on (SIGCONT);
- frozen host: `machine` is stopped (SIGSTOP);
- lost samples: a relay in the line loses every frame with samples, while replies and heartbeats pass.

The table tells when the last pulse was made, by the plant's own account, and whether fault 1001 is latched (lost
samples: whether the machine is idle or faulted) with the actuator at 0 V. Exit code 1 where a bar is missed.
"""

from __future__ import annotations

import math
import os
import random
import select
import signal
import sys
import tempfile
import threading
import time
import tty
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from benchmarks.common import options
from benchmarks.serving import Recorded, recorded, start
from edmctl.errors import EdmError
from edmctl.link.faults import FAULTS, FaultCode
from edmctl.link.frame import FrameDecoder
from edmctl.link.messages import State, Tlm
from edmctl.link.opening import open_line
from edmctl.link.session import Session

if TYPE_CHECKING:
    import subprocess
    from collections.abc import Callable, Iterator

PULSES_OFF_S = 0.260
HOST_SILENT = 1001
SETUP = "[actuator]\nconditioning_cycles = 0\n[stage]\npark_x_um = -2200.0\nspeed_um_s = 10000.0\n"
QUICK = (
    "approach.speed_um_s=5",
    "approach.offset_um=45.5",
    "measure.touches=1",
    "measure.speed_um_s=4",
    "measure.fast_um_s=40",
    'log.pulses="off"',
    "target.depth_um=30",
)
"""The shortest way to sparks."""
HELLO_S, STALL_S = 0.05, 0.05
"""From HELLO (answered within 20 ms) and from the end of the stall, with what the server's turns and the scheduler
of the computer add."""
SAMPLES_S = FAULTS[FaultCode.SAMPLES_LOST].pulses_off_s
WATCH_S = 3.0
MOST_STARTS = 10
STARVED_S = 0.04
"""A busy computer lets a host starve before anything is done to it, or the server while it is judged: its loop turns
every 4 ms otherwise. What that shows is not asked here, and the job is begun again."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """Last pulse after the moment that the bar counts from, and what was wrong."""

    off_s: float
    wrong: str = ""
    starts: int = 1


class Relay:
    """A line in between: hands everything on until `deaf`, from then on no samples to the host."""

    def __init__(self, controller: Path) -> None:
        self._ours, theirs = os.openpty()
        tty.setraw(self._ours)
        tty.setraw(theirs)
        self.name = os.ttyname(theirs)
        self._theirs = theirs
        self._controller = os.open(controller, os.O_RDWR | os.O_NOCTTY)
        self.deaf = False
        self.newest_sample_s = 0.0
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def close(self) -> None:
        """End the relay."""
        self._over.set()
        self._thread.join()
        for number in (self._ours, self._theirs, self._controller):
            os.close(number)

    def _run(self) -> None:
        rest = b""
        while not self._over.is_set():
            for number in select.select([self._ours, self._controller], [], [], 0.1)[0]:
                data = os.read(number, 65536)
                if number == self._ours:
                    os.write(self._controller, data)
                    continue
                *pieces, rest = (rest + data).split(b"\0")
                os.write(self._ours, b"".join(b"\0" + p + b"\0" for p in pieces if p and self._passes(p)))

    def _passes(self, piece: bytes) -> bool:
        frames = FrameDecoder(watch_for_abort=False).feed(b"\0" + piece + b"\0")
        if not frames or frames[0].type_id != Tlm.ID:
            return True
        if not self.deaf:
            self.newest_sample_s = time.monotonic()
        return not self.deaf


@contextmanager
def between(link: Path, *, wanted: bool) -> Iterator[Relay | None]:
    """Put a relay between host and controller while the block runs, where one is wanted."""
    relay = Relay(link) if wanted else None
    try:
        yield relay
    finally:
        if relay is not None:
            relay.close()


def wait_for(process: subprocess.Popen[str], phase: str) -> bool:
    """Read the events until the phase begins; what comes later is thrown away."""
    assert process.stderr is not None
    stream = process.stderr
    for line in stream:
        if f'"{phase}"' in line:
            threading.Thread(target=stream.read, daemon=True).start()
            return True
    return False


def killed_host(
    machine: Recorded, host: subprocess.Popen[str], chance: random.Random, _: Relay | None
) -> float:
    """Kill the host."""
    begin_s = time.monotonic()
    host.kill()
    time.sleep(WATCH_S)
    return begin_s


def new_session(
    machine: Recorded, host: subprocess.Popen[str], chance: random.Random, _: Relay | None
) -> float:
    """Kill the host and say hello as another that only sends heartbeats."""
    host.kill()
    host.wait()
    time.sleep(chance.uniform(0.0, 0.2))
    session = Session(open_line(str(machine.link)))
    begin_s = time.monotonic()
    session.open(2.0)
    session.pump(WATCH_S)
    session.close()
    return begin_s


def frozen_controller(
    machine: Recorded, host: subprocess.Popen[str], chance: random.Random, _: Relay | None
) -> float:
    """Stop the server and let it go on."""
    machine.server.send_signal(signal.SIGSTOP)
    time.sleep(chance.uniform(0.3, 3.0))
    begin_s = time.monotonic()
    machine.server.send_signal(signal.SIGCONT)
    time.sleep(WATCH_S)
    return begin_s


def frozen_host(
    machine: Recorded, host: subprocess.Popen[str], chance: random.Random, _: Relay | None
) -> float:
    """Stop the host."""
    begin_s = time.monotonic()
    host.send_signal(signal.SIGSTOP)
    time.sleep(WATCH_S)
    host.send_signal(signal.SIGCONT)
    return begin_s


def lost_samples(
    machine: Recorded, host: subprocess.Popen[str], chance: random.Random, relay: Relay | None
) -> float:
    """Lose every sample from now on."""
    assert relay is not None
    relay.deaf = True
    time.sleep(WATCH_S + SAMPLES_S)
    return relay.newest_sample_s


CASES: dict[
    str, tuple[Callable[[Recorded, subprocess.Popen[str], random.Random, Relay | None], float], float]
] = {
    "killed host": (killed_host, PULSES_OFF_S),
    "new session": (new_session, HELLO_S),
    "frozen controller": (frozen_controller, STALL_S),
    "frozen host": (frozen_host, PULSES_OFF_S),
    "lost samples": (lost_samples, SAMPLES_S),
}


def one(home: Path, case: str, number: int) -> Outcome:
    """Bring a machine to its sparks and then into trouble, again where the computer was too busy for it."""
    for starts in range(1, MOST_STARTS + 1):
        outcome = _once(home, case, number)
        if outcome is not None:
            return replace(outcome, starts=starts)
    return Outcome(0.0, f"the computer was too busy for {MOST_STARTS} jobs", MOST_STARTS)


def _once(home: Path, case: str, number: int) -> Outcome | None:
    trouble, bar_s = CASES[case]
    chance, name = random.Random(f"{case} {number}"), f"{case.replace(' ', '-')}-{number}"
    with (
        recorded(home, name, number, ("cu270", *QUICK)) as machine,
        between(machine.link, wanted=trouble is lost_samples) as relay,
    ):
        port = relay.name if relay else str(machine.link)
        overrides = [word for text in QUICK for word in ("--set", text)]
        place = ("--setup", "setup.toml", "--out", f"runs-{name}", "--events", "--port", port)
        host = start(home, "machine", "-p", "cu270", *place, *overrides)
        try:
            if not wait_for(host, "machining"):
                return None
            machine.wait_for_pulses()
            time.sleep(chance.uniform(0.0, 1.0))
            try:
                begin_s = trouble(machine, host, chance, relay)
            except EdmError as refused:
                return Outcome(math.inf, f"{refused.code}: {refused.message}")
            return _judged(machine, begin_s, bar_s, silent=relay is None)
        finally:
            host.kill()
            host.wait()


def _judged(machine: Recorded, begin_s: float, bar_s: float, *, silent: bool) -> Outcome | None:
    rows = machine.rows()
    end = rows[-1]
    if end["state"] not in (State.IDLE, State.FAULT):
        return Outcome(math.inf, f"{State(end['state']).name} at the end")
    judged_s = rows["time_s"][(rows["time_s"] >= begin_s) & (rows["time_s"] <= begin_s + bar_s)]
    starved = len(judged_s) < 2 or max(judged_s[1:] - judged_s[:-1]) > STARVED_S
    if starved or rows[rows["time_s"] <= begin_s]["fault"][-1]:
        return None
    made = rows[1:][rows["pulses"][1:] > rows["pulses"][:-1]]
    off_s = max(0.0, float(made["time_s"][-1]) - begin_s)
    safe = end["fault"] == HOST_SILENT if silent else end["state"] in (State.IDLE, State.FAULT)
    if off_s > bar_s:
        return Outcome(off_s, f"the last pulse {1000 * off_s:.0f} ms after")
    if not safe or end["actuator_v"] > 0.0:
        told = f"{State(end['state']).name}, fault {end['fault']}, {end['actuator_v']:.1f} V"
        return Outcome(off_s, f"{told} at the end")
    return Outcome(off_s)


def main() -> int:
    """Run every case and return the exit code."""
    arguments = options(__doc__, {"cases": CASES}, count=100, jobs=4, cases=list(CASES))
    wrong: list[str] = []
    print(
        f"{'case':18} {'in time and safe':>16} {'last pulse after, ms: median':>30} {'worst':>6} {'stated':>7} "
        f"{'begun again':>12}"
    )
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(arguments.jobs) as pool:
        home = Path(folder)
        (home / "setup.toml").write_text(SETUP, encoding="utf-8")
        for case in arguments.cases:
            numbers = range(1, arguments.count + 1)
            outcomes = list(pool.map(lambda number, case=case: one(home, case, number), numbers))
            good = sum(not outcome.wrong for outcome in outcomes)
            times_ms = sorted(1000.0 * outcome.off_s for outcome in outcomes)
            print(
                f"{case:18} {good:9} of {len(outcomes):3} {times_ms[len(times_ms) // 2]:30.0f} {times_ms[-1]:6.0f} "
                f"{1000.0 * CASES[case][1]:7.0f} {sum(o.starts - 1 for o in outcomes):12}",
                flush=True,
            )
            wrong += [f"{case} {n}: {o.wrong}" for n, o in zip(numbers, outcomes, strict=True) if o.wrong]
    for line in wrong:
        print(f"  {line}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
