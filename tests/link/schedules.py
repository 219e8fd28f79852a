"""A random schedule of line faults against the virtual controller, and a count of what every command did."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from random import Random
from typing import TYPE_CHECKING

from edmctl.errors import EdmError, LinkLost
from edmctl.link import messages as m
from edmctl.link.session import CommandRefused, Session
from edmctl.simulator import BenchConfig, VirtualBench, open_bench
from tests.link.lossy import Faults, LossyLine

if TYPE_CHECKING:
    from edmctl.link.wire import Message, Request
    from edmctl.simulator.link_endpoint import Outcome

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
    """Send distinguishable commands over a bad line; each must have acted once, or never where it failed."""
    random = Random(seed)
    bench = open_bench(BenchConfig(), 1)
    effects: Counter[bytes] = Counter()
    _count_effects(bench, effects)
    session = Session(LossyLine(bench.transport, random, faults), random)
    try:
        session.open(3.0)
    except EdmError as error:
        _judge_error(seed, error, tally)
        return
    for number in range(COMMANDS):
        if random.random() < REBOOT:
            bench.python_controller.reset(m.ResetCause.BROWN_OUT)
            tally.reboots += 1
        command = _command(random, number)
        try:
            session.request(command)
            tally.done += 1
            session.pump(random.choice((0.0, 0.01, 0.3)))
        except CommandRefused:
            tally.refused += 1
        except EdmError as error:
            _judge_error(seed, error, tally)
            session.transport.read(2.0)  # late copies arrive
            break
        if effects[command.pack()] != 1:
            tally.breaches.append(
                f"seed {seed}: {command} was answered and acted {effects[command.pack()]} times"
            )
    tally.retries += session.statistics.retries
    for payload, times in effects.items():
        if times > 1:
            tally.breaches.append(f"seed {seed}: {payload.hex()} acted {times} times")


def _judge_error(seed: int, error: EdmError, tally: Tally) -> None:
    if isinstance(error, LinkLost) and error.hint and error.code.startswith("E40"):
        tally.lost += 1
    else:
        tally.breaches.append(f"seed {seed}: {error!r} is no clean failure")


def _command(random: Random, number: int) -> Request[object]:
    """A command whose payload no other command of the schedule has."""
    wire = 1000 * number + random.randrange(1000)
    if random.random() < 0.5:
        return m.SetParam(m.PARAMS["piezo_max_v"].id, wire)
    return m.PiezoSet(1.0 + number, 1.0 + wire)


def _count_effects(bench: VirtualBench, effects: Counter[bytes]) -> None:
    execute = bench.python_controller.commands.execute

    def counting(message: Message) -> Outcome:
        if isinstance(message, m.SetParam | m.PiezoSet):
            effects[message.pack()] += 1
        return execute(message)

    bench.python_controller.link._execute = counting
