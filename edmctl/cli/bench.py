"""The composition root: from a port selector to a machine that answers.

It stands here because `machine/` may not know the simulator, and the simulator shares nothing with the host
but the wire.
"""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

from edmctl.cli.signals import stopping_signals
from edmctl.errors import Diagnostic, LinkLost

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from edmctl.link.transport import Transport
    from edmctl.machine.controller import LinkMachine
    from edmctl.machine.port import MachineIdentity
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
        """Whether it is a fresh virtual bench in this process, which alone has a seed and a known truth."""
        return self.selector == SIMULATOR


@dataclass(frozen=True, slots=True)
class Bench:
    """A connected machine, and the virtual bench behind it where that is in this process."""

    machine: LinkMachine
    virtual: VirtualBench | None


def where_is(option: str | None, setup: Setup, wait_s: float = 0.0) -> Where:
    """Return the machine that the option (or its environment variable), else the setup, else nobody names.

    Raises LinkLost E4002 for a virtual bench in a file.
    """
    selector = option or setup.port or SIMULATOR
    if selector == SIMULATOR.rstrip(":"):
        selector = SIMULATOR
    if selector.startswith(SIMULATOR) and selector != SIMULATOR:
        raise LinkLost(
            f"Port {selector!r}: a virtual bench that is kept in a file has to be served.",
            hint="Say `edmctl simulate serve --bench FILE --link PATH` and --port PATH; sim: alone is a fresh one.",
            code="E4002",
        )
    return Where(selector, wait_s)


def seed_warning(where: Where, asked: int | None) -> list[Diagnostic]:
    """Return what is to be said of a seed that no machine will use."""
    if where.in_process or asked is None:
        return []
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

    loaded : what stands on a virtual bench in this process; None where neither tool nor work matters.

    Raises LinkLost and ProtocolMismatch.
    """
    from edmctl.cli.stop import AnnouncedStop
    from edmctl.link.session import Session
    from edmctl.machine.controller import LinkMachine

    virtual: VirtualBench | None = None
    line: Transport
    if where.in_process:
        from edmctl.simulator import open_bench

        virtual = open_bench(bench_config(loaded, setup), seed)
        line = virtual.transport
    else:
        line = _line(where, setup, say)
    session = Session(line, heartbeat_s=VIRTUAL_BEAT_SHARE * setup.controller.watchdog_s)
    try:
        stop = AnnouncedStop(say)
        session.open(setup.link.hello_s)
        with stopping_signals(stop, session.abort):
            machine = LinkMachine(session, stop)
            if machine.make_idle():
                say("the controller was still armed by a host that is gone: pulses off, tool retracted")
            yield Bench(machine, virtual)
    finally:
        session.close()


def introduction(where: Where, identity: MachineIdentity, seed: int) -> str:
    """Return what is said of the machine at the start of a run."""
    if where.in_process:
        return f"simulated run on the virtual machine, seed {seed}"
    if identity.simulated:
        return f"simulated run on the virtual controller {identity.serial} at {identity.transport}"
    return f"machine {identity.serial} at {identity.transport}, firmware {identity.firmware}"


def bench_config(loaded: LoadedProfile | None, setup: Setup) -> BenchConfig:
    """Put the profile's tool and work on a bench that erodes by its `[sim]` table, with or without a sensor."""
    from edmctl.simulator.config import BenchConfig, DischargeConstants, SensorConstants

    if loaded is None:
        return BenchConfig(sensors=SensorConstants(fitted=setup.sensor.fitted))
    constants = {field.name: getattr(loaded.sim, field.name) for field in fields(DischargeConstants)}
    return BenchConfig(
        tool_diameter_um=loaded.profile.tool.diameter_um,
        theta=loaded.sim.theta,
        offset_um=loaded.profile.approach.offset_um,
        discharge=DischargeConstants(**constants),
        sensors=SensorConstants(fitted=setup.sensor.fitted),
    )


def _line(where: Where, setup: Setup, say: Callable[[str], None]) -> Transport:
    from edmctl.link.opening import open_selector

    link = setup.link
    return open_selector(
        where.selector, link.usb_ids, link.candidates, link.baud, link.hello_s, where.wait_s, say
    )
