"""A connected machine, the present time as ages are counted on it, and the creep that its actuator keeps."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from edmctl import failures
from edmctl.dataclasses import dataclass, replace
from edmctl.files import json_of, read_bytes
from edmctl.jobs.plan import MachineAddress
from edmctl.procedures.job import REPORT_DELAY_S, Job
from edmctl.procedures.monitoring.drift import contradicting_between_jobs_um_s, displacement_uncertainty
from edmctl.profile.folders import creep_path
from edmctl.profile.setup import Setup
from edmctl.record.ledger import MachineHistory

if TYPE_CHECKING:
    from edmctl.machine.controller import LinkMachine
    from edmctl.process.rest_drift import CreepLeft
    from edmctl.simulator import VirtualBench

CLOCK_STEP_S = 60.0
"""Tolerated correction of a clock: meanwhile a zero drifts by 0.1 µm, less than the scatter of a touch."""
CREEP_SCHEMA = "edmctl-creep/1"


@dataclass(frozen=True, slots=True)
class Now:
    """The present of a machine. `bench_s` is the time of a virtual bench in this process, NaN on any other machine.

    The time of a virtual bench passes only during commands. Records of a machine therefore have both times, and
    one of them counts.
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


def with_home(job: Job, history: MachineHistory, now: Now) -> Job:
    """Return the job with the last home of the tool by the ledger, its age, and the drift before.

    The age and the home are unknown if the clock was set back since; the drift is still known.
    """
    if not history.homes:
        return job
    drift_u_um_per_s = displacement_uncertainty(job).drift_u_um_per_s
    seen = [(home.utc_s if math.isnan(now.bench_s) else home.bench_s, home.um) for home in history.homes]
    job = replace(job, drift_seen_um_s=contradicting_between_jobs_um_s(seen, drift_u_um_per_s))
    last = history.homes[-1]
    passed_s = now.since_s(last.utc_s, last.bench_s)
    if math.isinf(passed_s):
        return job
    return replace(job, home_um=last.um, home_age_s=passed_s + REPORT_DELAY_S)


def with_home_left(job: Job) -> Job:
    """Return the job with the tool's home by the journal of the interrupted run, if that is newer."""
    state = job.resumed
    age_s = state.home_age_s + job.pause_s + REPORT_DELAY_S if state is not None else math.nan
    if state is None or not math.isfinite(age_s) or age_s >= job.home_age_s:
        return job
    return replace(job, home_um=state.home_um, home_age_s=age_s)


class CreepNote:
    """The creep that a use of the actuator leaves, kept in a file of the machine next to its drift file.

    A command removes the file before the actuator moves, and writes it again when it has followed the creep to its
    end. A command that is killed or follows no creep leaves no file, so that the next command knows that.
    """

    def __init__(self, bench: ConnectedMachine, where: MachineAddress, environ: Mapping[str, str]) -> None:
        self._bench, file = bench, where.bench_file
        self._machine = str(file.resolve()) if file is not None else ""
        serial = bench.machine.identity.serial
        self._path: Path | None = creep_path(serial, environ) if where.lasting else None

    def read(self) -> CreepLeft | None:
        """Return the remaining creep; None if nothing has used the actuator.

        Without a file it is that of a use that may have ended just now.
        """
        if self._bench.seed is not None:
            return None
        from edmctl.process.rest_drift import CreepLeft  # needs numpy, which a dry run does not load

        unknown = CreepLeft.none(0.0)
        if self._path is None:
            return unknown
        try:
            values = json_of(read_bytes(self._path))
            if values["schema"] != CREEP_SCHEMA or values["machine"] != self._machine:
                return unknown
            unknown_s, bench_s = values["unknown_s"], values["bench_s"]
            left = CreepLeft.of(values["lags_um"], math.inf if unknown_s is None else float(unknown_s))
            noted_s = float(values["utc_s"]), math.nan if bench_s is None else float(bench_s)
        except (OSError, ValueError, KeyError, TypeError, OverflowError):
            return unknown
        passed_s = self._bench.now.since_s(*noted_s)
        return left.after(passed_s) if passed_s < math.inf else unknown

    def take_away(self) -> None:
        """Remove the file before the actuator moves. Raises RunFileError E9012 if that fails: it would mislead."""
        if self._path is None:
            return
        try:
            self._path.unlink(missing_ok=True)
        except OSError as refused:
            raise failures.use_record_not_removed(
                path=self._path, reason=refused.strerror or refused
            ) from refused

    def leave(self, left: CreepLeft) -> None:
        """Write the remaining creep. A disk error is ignored: the next command knows less."""
        if self._path is None:
            return
        bench_s = self._bench.now.bench_s
        values = {
            "schema": CREEP_SCHEMA,
            "machine": self._machine,
            "utc_s": time.time(),
            "bench_s": bench_s if math.isfinite(bench_s) else None,
            "lags_um": left.um.tolist(),
            "unknown_s": left.unknown_s if math.isfinite(left.unknown_s) else None,
        }
        with suppress(OSError):
            self._path.parent.mkdir(parents=True, exist_ok=True)
            beside = self._path.with_suffix(".new")
            beside.write_text(json.dumps(values, allow_nan=False), encoding="utf-8")
            beside.replace(self._path)
