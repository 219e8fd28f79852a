"""One procedure of the main job by itself: its way from a checked plan to a result."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Protocol

from edmctl.jobs.connected_run import connected_run
from edmctl.jobs.result import Result
from edmctl.jobs.run_header import name_run

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from edmctl.errors import Diagnostic, EdmError
    from edmctl.jobs.calibration.selection import ModelUsed
    from edmctl.jobs.plan import Plan
    from edmctl.jobs.run_header import RunName
    from edmctl.jobs.session import MachineSession
    from edmctl.jsonout import JsonValue
    from edmctl.machine.controller import LinkMachine
    from edmctl.procedures.job import Job
    from edmctl.procedures.run import JobRun
    from edmctl.record.rows import Recorder
    from edmctl.results.progress import Observer

    Warn = Callable[[Sequence[Diagnostic]], None]


class Procedure(Protocol):
    """What one command does on a machine that is connected. It keeps what it has reached."""

    @property
    def name(self) -> str:
        """First word of the run file's name."""
        ...

    @property
    def pulses(self) -> bool:
        """Whether it makes sparks."""
        ...

    def job(self, session: MachineSession, name: RunName, warn: Warn) -> Job:
        """Return what the machine is made ready for; refuse what cannot be done on it."""
        ...

    def act(self, run: JobRun) -> None:
        """Do it on an armed and conditioned machine."""
        ...

    def close(self, time_s: float) -> None:
        """Keep what is to be known by later commands; the machine is retracted and idle, after `time_s`."""
        ...

    def result(self) -> Mapping[str, object] | None:
        """What was reached, for scripts; None where there is nothing."""
        ...


@dataclass(frozen=True, slots=True, repr=False)
class ProcedureReport(Result):
    """What a procedure came to, whether it ended well or with `error`.

    `result` holds what the command of that name tells with `--json`. `reached` says that there is more in it than
    times and calibration; `model` where its estimated displacements come from, None where it ended before that was
    known. `run_file` is the file as it is called now.
    """

    name: str
    result: Mapping[str, object]
    reached: bool
    simulated: bool
    run_file: Path | None
    model: ModelUsed | None
    error: EdmError | None

    def as_mapping(self) -> Mapping[str, object]:
        """Return the `result` of the JSON object."""
        return self.result

    def brief(self) -> list[str]:
        """Return the procedure's name and the first of its values."""
        return [self.name, *Result.brief(self)]

    def rows(self) -> list[JsonValue]:
        """Return one row a jump of a series, else the one result."""
        jumps = self.to_dict().get("jumps")
        return jumps if isinstance(jumps, list) else Result.rows(self)


def name_of(plan: Plan, command: str, folder: Path, run_id: str | None) -> RunName:
    """Name the run; a profile that nobody named is not in it. Raises UsageError E2004."""
    loaded = plan.loaded if plan.names_tool else None
    return name_run(folder, run_id, loaded, datetime.now(UTC), command)


def perform(
    plan: Plan, procedure: Procedure, name: RunName, seed: int, observer: Observer, warn: Warn
) -> ProcedureReport:
    """Do it into the run file `name`; `seed` makes a virtual bench that is not there yet.

    Expected errors come back with what was reached. Raises LinkLost, ProtocolMismatch and RunFileError where there
    was no machine to act on.
    """
    from edmctl.procedures.job_state import JobTally
    from edmctl.procedures.session import running

    ledger = JobTally()

    def prepare(session: MachineSession) -> Callable[[Recorder], None]:
        job = procedure.job(session, name, warn)
        return lambda recorder: act(session.bench.machine, job, recorder)

    def act(machine: LinkMachine, job: Job, recorder: Recorder) -> None:
        with running(
            machine, job, ledger, recorder=recorder, observer=observer, pulses=procedure.pulses
        ) as run:
            procedure.act(run)
        procedure.close(ledger.time_s)

    def summary(session: MachineSession) -> dict[str, object]:
        used = asdict(session.choice.used) if session.choice else None
        return {
            **(procedure.result() or {}),
            "calibration": used,
            "time_s": ledger.time_s,
            "link": ledger.link,
        }

    session = connected_run(plan, seed, observer, name, warn, prepare, summary)
    return ProcedureReport(
        name=procedure.name,
        result=summary(session),
        reached=procedure.result() is not None,
        simulated=session.bench.machine.identity.simulated,
        run_file=session.run_file,
        model=session.choice.used if session.choice else None,
        error=session.error,
    )
