"""A machine that is connected, and what a command has in hand as it goes."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from edmctl.dataclasses import dataclass
from edmctl.errors import EdmError
from edmctl.jobs.calibration.selection import Choice
from edmctl.jobs.ledger.elapsed import CALENDAR, Now
from edmctl.procedures.job import CalibratedActuator
from edmctl.record.ledger_entries import Entry

if TYPE_CHECKING:
    from edmctl.jobs.drift_choice import DriftChoice
    from edmctl.jobs.plan import Plan
    from edmctl.machine.controller import LinkMachine
    from edmctl.process.rest_drift import CreepLeft
    from edmctl.profile.setup import Setup
    from edmctl.record.disk_thread import DiskThread
    from edmctl.record.ledger import Ledger
    from edmctl.simulator import VirtualBench


@dataclass(frozen=True, slots=True)
class ConnectedMachine:
    """A connected machine, and the virtual bench behind it where that is in this process.

    `seed` made the virtual bench; None where it was there before. `begin` puts the profile's tool into a bench that
    a file keeps, and lets the file be written from then on: a command that is refused before changes nothing. `keep`
    writes it where the tool has worn, `keep_all` always; `kept_s` is the time of the bench in its file. `own_setup`
    is the setup that was found by the serial number.
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


@dataclass(slots=True)
class MachineSession:
    """What a command has in hand as it goes, and in the end: `run_file` as it is called then, the expected error.

    `plan` is under the setup in effect, which may be known by the machine's serial number only.
    `creep_left` is what an earlier use of the actuator has left, and what this one leaves once it came to its end.
    """

    bench: ConnectedMachine
    disk: DiskThread
    plan: Plan
    choice: Choice | None = None
    drift: DriftChoice | None = None
    creep_left: CreepLeft | None = None
    run_file: Path | None = None
    error: EdmError | None = None

    @property
    def actuator(self) -> CalibratedActuator | None:
        """The calibrated actuator, None where no calibration is used."""
        return self.choice.actuator if self.choice else None

    def leaves(self, creep: CreepLeft | None) -> None:
        """Note what the actuator creeps back yet after this use; None where nobody followed it to its end."""
        from edmctl.process.rest_drift import CreepLeft

        self.creep_left = creep or CreepLeft.none(0.0)

    def write_down(self, ledger: Ledger, *entries: Entry) -> None:
        """Add entries to the ledger; a bench in a file is written first, and is never older than they.

        Raises RunFileError where one of them cannot be written.
        """
        self.bench.keep_all()
        serial, bench_s = self.bench.machine.identity.serial, self.bench.kept_s()
        self.disk.run(ledger.path, lambda: ledger.append(serial, *entries, bench_s=bench_s))
