"""A random schedule of line faults against the virtual machine, and a count of what every command did."""

from __future__ import annotations

from dataclasses import dataclass, field
from random import Random

from edmctl.errors import EdmError, LinkLost
from edmctl.link import messages as m
from edmctl.link.session import CommandRefused, Session
from edmctl.link.wire import Request
from edmctl.simulator import BenchConfig, open_bench
from tests.link.lossy import Faults, LossyLine

LOSS = Faults(drop=0.2, duplicate=0.1, delay=0.1, corrupt=0.05)
COMMANDS = 12
REBOOT = 0.02


@dataclass(slots=True)
class Tally:
    """What came of a schedule: outcomes of the commands, and every breach of the promise."""

    done: int = 0
    refused: int = 0
    lost: int = 0
    retries: int = 0
    reboots: int = 0
    breaches: list[str] = field(default_factory=list)


def run_schedule(seed: int, tally: Tally, faults: Faults = LOSS) -> None:
    """Arm and disarm by turns over a bad line; each must have acted once, or at most once where it failed.

    A copy of a command that acts late is seen: ARM is counted by the controller, DISARM ends what came after it.
    """
    random = Random(seed)
    bench = open_bench(BenchConfig(), 1)
    session = Session(LossyLine(bench.transport, random, faults), random)
    seen, arms = bench.controller.seen, 0
    patient = {"watchdog_s": 1.0, "bad_frames": 1000.0}
    crc = m.param_crc(patient)
    try:
        session.open(3.0)
        for name, value in patient.items():
            session.request(m.SetParam(m.PARAMS[name].id, m.PARAMS[name].to_wire(value)))
        session.request(m.CommitProfile(crc))
    except EdmError as error:
        _judge_error(seed, error, tally)
        return
    for number in range(COMMANDS):
        if random.random() < REBOOT:
            bench.controller.reset(m.ResetCause.BROWN_OUT)
            tally.reboots += 1
        command: Request[object] = m.Disarm() if number % 2 else m.Arm(crc)
        failed, refused = False, tally.refused
        try:
            session.request(command)
            tally.done += 1
            arms += isinstance(command, m.Arm)
            session.pump(random.choice((0.02, 0.05, 0.3)))  # DISARM ends with the retreat
        except CommandRefused:
            tally.refused += 1
        except EdmError as error:
            _judge_error(seed, error, tally)
            session.transport.read(2.0)  # late copies arrive
            failed = True
        most = arms + (failed and isinstance(command, m.Arm))
        if not arms <= seen.arms <= most:
            tally.breaches.append(f"seed {seed}: {seen.arms} ARMs have acted of {arms} that were answered")
        if failed or seen.fault:
            break
        if tally.refused == refused and seen.armed != isinstance(command, m.Arm):
            tally.breaches.append(f"seed {seed}: armed {seen.armed} after {command}")
    tally.retries += session.statistics.retries


def _judge_error(seed: int, error: EdmError, tally: Tally) -> None:
    if isinstance(error, LinkLost) and error.hint and error.code.startswith("E40"):
        tally.lost += 1
    else:
        tally.breaches.append(f"seed {seed}: {error!r} is no clean failure")
