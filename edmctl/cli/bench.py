"""The composition root: from a port selector to a machine that answers.

It stands here because `machine/` may not know the simulator, and the simulator shares nothing with the host
but the wire.
"""

from __future__ import annotations

import math
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING

from edmctl.cli.elapsed import CALENDAR, Now
from edmctl.cli.signals import stopping_signals
from edmctl.errors import Diagnostic, UsageError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from edmctl.link.transport import Transport
    from edmctl.machine.controller import LinkMachine
    from edmctl.profile.load import LoadedProfile
    from edmctl.profile.setup import Setup
    from edmctl.simulator import BenchConfig, VirtualBench

SIMULATOR = "sim:"
VIRTUAL_BEAT_SHARE = 0.8
"""Of the watchdog's time: where time is virtual nothing is late."""


@dataclass(frozen=True, slots=True)
class Where:
    """Which machine: the selector of its port, and how long to wait for the port."""

    selector: str = SIMULATOR
    wait_s: float = 0.0

    @property
    def in_process(self) -> bool:
        """Whether it is a virtual bench in this process, whose truth is known."""
        return self.selector.startswith(SIMULATOR)

    @property
    def bench_file(self) -> Path | None:
        """Where a virtual bench is kept between commands; None for a fresh one and for every other machine."""
        if not self.in_process or self.selector == SIMULATOR:
            return None
        return Path(self.selector.removeprefix(SIMULATOR)).expanduser()

    @property
    def lasting(self) -> bool:
        """Whether the machine is still there after the command; a fresh virtual bench is not."""
        return self.selector != SIMULATOR

    def seed_of(self, seed: int) -> int | None:
        """Return the seed that will make the machine; None for one that is there already."""
        file = self.bench_file
        return seed if self.in_process and (file is None or not file.exists()) else None


def _nothing() -> None:
    """What there is to begin or to keep on a machine that no file keeps."""


def _no_time() -> float:
    """The time of a bench that no file keeps."""
    return math.nan


@dataclass(frozen=True, slots=True)
class Bench:
    """A connected machine, and the virtual bench behind it where that is in this process.

    `seed` made the virtual bench; None where it was there before. `begin` puts the profile's tool into a bench that
    a file keeps, and lets the file be written from then on: a command that is refused before changes nothing. `keep`
    writes it where the tool has worn, `keep_all` always; `kept_s` is the time of the bench in its file.
    """

    machine: LinkMachine
    virtual: VirtualBench | None = None
    seed: int | None = None
    begin: Callable[[], None] = _nothing
    keep: Callable[[], None] = _nothing
    keep_all: Callable[[], None] = _nothing
    kept_s: Callable[[], float] = _no_time

    @property
    def now(self) -> Now:
        """The present, as ages are counted on this machine."""
        return CALENDAR if self.virtual is None else Now(self.virtual.transport.now_s())


def where_is(option: str | None, setup: Setup, wait_s: float = 0.0) -> Where:
    """Return the machine that the option (or its environment variable), else the setup, else nobody names.

    Raises UsageError E2006 for a name of nothing.
    """
    if option is not None and not option.strip():
        raise UsageError(
            "--port names no machine.",
            hint="Say sim:, sim:FILE, a serial port, socket://HOST:PORT, serial:ID or auto; or leave it out.",
            code="E2006",
        )
    selector = option or setup.port or SIMULATOR
    if selector == SIMULATOR.rstrip(":"):
        selector = SIMULATOR
    return Where(selector, wait_s)


def seed_warning(where: Where, asked: int | None) -> list[Diagnostic]:
    """Return what is to be said of a seed that no machine will use."""
    if asked is None or where.seed_of(asked) is not None:
        return []
    if where.in_process:
        message = f"--seed {asked} has no effect on the bench that {where.bench_file} keeps already."
        hint = "Leave it out, or name a new file for another machine."
    else:
        message = f"--seed {asked} has no effect on the controller at {where.selector}."
        hint = "Give the seed to `edmctl simulate serve` where the controller is a virtual one."
    return [Diagnostic("W4101", message, hint, is_warning=True)]


@contextmanager
def connected(
    loaded: LoadedProfile | None,
    setup: Setup,
    seed: int,
    say: Callable[[str], None],
    where: Where = Where(),
) -> Iterator[Bench]:
    """Open the machine and say hello. From then on a signal stops it in order, with a word to `say`.

    loaded : what stands on a virtual bench in this process; None where neither tool nor work matters. In a bench
    that a file keeps the tool is changed by `Bench.begin`.

    Raises LinkLost and ProtocolMismatch.
    """
    from edmctl.cli.stop import AnnouncedStop
    from edmctl.link.session import Session
    from edmctl.machine.controller import LinkMachine

    line: Transport
    on: Callable[[LinkMachine], Bench] = Bench
    with ExitStack() as held:
        if where.in_process:
            from edmctl.actuator.compiling import compiling_told

            held.enter_context(compiling_told(say))
            line, on = held.enter_context(_virtual(loaded, setup, seed, say, where))
        else:
            line = _line(where, setup, say)
        session = Session(line, heartbeat_s=VIRTUAL_BEAT_SHARE * setup.controller.watchdog_s)
        held.callback(session.close)
        stop = AnnouncedStop(say)
        session.open(setup.link.hello_s)
        with stopping_signals(stop, session.abort):
            machine = LinkMachine(session, stop)
            machine.wait_for_rest()
            yield on(machine)


def introduction(where: Where, bench: Bench) -> str:
    """Return what is said of the machine at the start of a run."""
    identity = bench.machine.identity
    if where.bench_file is not None:
        new = "" if bench.seed is None else f", new with seed {bench.seed}"
        return f"simulated run on the virtual machine {identity.serial} of {where.bench_file}{new}"
    if where.in_process:
        return f"simulated run on the virtual machine, seed {bench.seed}"
    if identity.simulated:
        return f"simulated run on the virtual controller {identity.serial} at {identity.transport}"
    return f"machine {identity.serial} at {identity.transport}, firmware {identity.firmware}"


@contextmanager
def _virtual(
    loaded: LoadedProfile | None, setup: Setup, seed: int, say: Callable[[str], None], where: Where
) -> Iterator[tuple[Transport, Callable[[LinkMachine], Bench]]]:
    """Open a virtual bench, fresh or that of a file: the line to it, and what it is with a machine behind that."""
    config, made_by = bench_config(loaded, setup), where.seed_of(seed)
    if where.bench_file is None:
        from edmctl.simulator import open_bench

        fresh = open_bench(config, seed)
        yield fresh.transport, lambda machine: Bench(machine, fresh, made_by)
        return
    from edmctl.cli.kept_bench import fit, kept_line

    with kept_line(where.bench_file, config, seed, where.wait_s) as (bench, line):

        def begin() -> None:
            if loaded is not None:
                fit(bench, loaded, config, say)
            line.begin()

        yield (
            line,
            lambda machine: Bench(machine, bench, made_by, begin, line.keep_worn, line.keep_all, line.kept_s),
        )


def bench_config(loaded: LoadedProfile | None, setup: Setup) -> BenchConfig:
    """Put the profile's tool and work on a bench that erodes by its `[sim]` table, with or without a sensor."""
    from edmctl.simulator.config import BenchConfig, DischargeConstants, SensorConstants

    if loaded is None:
        return BenchConfig(sensors=SensorConstants(fitted=setup.sensor.fitted))
    constants = {field.name: getattr(loaded.sim, field.name) for field in fields(DischargeConstants)}
    return BenchConfig(
        tool_diameter_um=loaded.profile.tool.diameter_um,
        theta=loaded.sim.theta,
        tool_label=loaded.profile.tool.label,
        tip_rounding_um=loaded.sim.tip_rounding_um,
        offset_um=loaded.profile.approach.offset_um,
        thickness_um=loaded.profile.work.thickness_um,
        discharge=DischargeConstants(**constants),
        sensors=SensorConstants(fitted=setup.sensor.fitted),
    )


def _line(where: Where, setup: Setup, say: Callable[[str], None]) -> Transport:
    from edmctl.cli.secret_file import asks_for_secret, secret_of
    from edmctl.link.opening import open_selector

    link = setup.link
    return open_selector(
        where.selector,
        link.usb_ids,
        link.candidates,
        link.baud,
        link.hello_s,
        where.wait_s,
        say,
        secret_of(link.secret_file) if asks_for_secret(where.selector, *link.candidates) else b"",
    )
