"""A connected machine, and the present time as ages are counted on it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from edmctl.dataclasses import dataclass

if TYPE_CHECKING:  # a dry run loads no machine
    from edmctl.machine.controller import LinkMachine
    from edmctl.profile.setup import Setup
    from edmctl.simulator import VirtualBench

CLOCK_STEP_S = 60.0
"""A clock may be put right by so much: in that time a zero drifts by 0.1 µm, less than a touch repeats."""


@dataclass(frozen=True, slots=True)
class Now:
    """The present of a machine. `bench_s` is the time of a virtual bench in this process, NaN on any other machine.

    A virtual bench stands still between commands, and each command lets its own time pass. Records of a machine
    therefore have both times, and only one of them counts.
    """

    bench_s: float = math.nan

    def since_s(self, utc_s: float, bench_s: float) -> float:
        """Return how long ago that was, s; infinity if a clock was set back since or was not recorded."""
        if math.isnan(self.bench_s):
            passed_s = time.time() - utc_s
            return max(0.0, passed_s) if passed_s >= -CLOCK_STEP_S else math.inf
        passed_s = self.bench_s - bench_s
        return passed_s if passed_s >= 0.0 else math.inf


CALENDAR = Now()


@dataclass(frozen=True, slots=True)
class ConnectedMachine:
    """A connected machine, and the virtual bench behind it if that is in this process.

    `seed` made the virtual bench; None if it existed before. `begin` puts the profile's tool into a bench that a
    file keeps, and lets the file be written from then on: a command that is refused before changes nothing. `keep`
    writes the file if the tool has worn, `keep_all` always; `kept_s` is the time of the bench in its file.
    `own_setup` is the setup that was found by the serial number.
    """

    machine: LinkMachine
    virtual: VirtualBench | None = None
    seed: int | None = None
    begin: Callable[[], None] = lambda: None
    keep: Callable[[], None] = lambda: None
    keep_all: Callable[[], None] = lambda: None
    kept_s: Callable[[], float] = lambda: math.nan
    own_setup: Setup | None = None

    @property
    def now(self) -> Now:
        """The present, as ages are counted on this machine."""
        return CALENDAR if self.virtual is None else Now(self.virtual.transport.now_s())

    @property
    def serial(self) -> str:
        """Serial number of the machine."""
        return self.machine.identity.serial
