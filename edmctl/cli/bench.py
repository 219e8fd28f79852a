"""The composition root: from a port selector to a machine that answers.

It stands here because `machine/` may not know the simulator, and the simulator shares nothing with the host
but the wire.
"""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

from edmctl.cli.signals import stopping_signals
from edmctl.errors import LinkLost

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from edmctl.machine.controller import LinkMachine
    from edmctl.profile.load import LoadedProfile
    from edmctl.profile.setup import Setup
    from edmctl.simulator import BenchConfig, VirtualBench

SIMULATOR = "sim:"
MEMORY_HEARTBEAT_SHARE = 0.8
"""Of the watchdog's time: a line in memory loses nothing, and virtual time knows no delay."""


@dataclass(frozen=True, slots=True)
class Bench:
    """A connected machine, and the virtual bench behind it."""

    machine: LinkMachine
    virtual: VirtualBench


def check_port(selector: str | None) -> str:
    """Return the selector to use. Refuses, with LinkLost E4002, any but the fresh virtual bench."""
    if selector in (None, "", SIMULATOR, "sim"):
        return SIMULATOR
    if is_virtual(selector):
        message = f"Port {selector!r}: this version does not offer a virtual bench that is kept between runs."
        hint = "Say --port sim: for a fresh one."
    else:
        message = f"Port {selector!r}: this version has no serial ports, only the built-in virtual machine."
        hint = "Leave --port and EDMCTL_PORT away, or say --port sim:."
    raise LinkLost(message, hint=hint, code="E4002")


def is_virtual(selector: str) -> bool:
    """Whether a selector names a virtual machine."""
    return selector.startswith(SIMULATOR)


@contextmanager
def connected(
    loaded: LoadedProfile | None, setup: Setup, seed: int, say: Callable[[str], None]
) -> Iterator[Bench]:
    """Open the virtual machine and say hello. From here on a signal stops it in order, with a word to `say`.

    loaded : what stands on the bench; None where neither tool nor work matters.
    """
    from edmctl.cli.stop import AnnouncedStop
    from edmctl.link.session import Session
    from edmctl.machine.controller import LinkMachine
    from edmctl.simulator import open_bench

    virtual = open_bench(bench_config(loaded, setup), seed)
    try:
        session = Session(virtual.transport, heartbeat_s=MEMORY_HEARTBEAT_SHARE * setup.controller.watchdog_s)
        stop = AnnouncedStop(say)
        with stopping_signals(stop, session.abort):
            session.open()
            yield Bench(LinkMachine(session, stop), virtual)
    finally:
        virtual.transport.close()


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
