"""`edmctl machine --resume RUN`: find the run.

It is refused if job, machine, tool or stages have changed. Depth and wear are measured again by contact, so they
need no check.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Sequence
from datetime import datetime
from pathlib import Path

from edmctl import failures
from edmctl.dataclasses import replace
from edmctl.errors import PreconditionError, RunFileError, UsageError, stages_by_hand
from edmctl.files import user_path
from edmctl.jobs.connected_machine import ConnectedMachine, Now, with_home_left
from edmctl.jobs.plan import Plan, Resumption, check, with_resumed
from edmctl.jobs.run_header import RunName, run_path
from edmctl.jobs.surroundings import NONE, Surroundings
from edmctl.procedures.job import Job, job_state
from edmctl.profile.places import Place
from edmctl.record.journal import SUFFIX, Journal, journal_path, read_journal
from edmctl.record.ledger import JobBegun, Ledger, Line, RunEnded, SiteMachined, ToolChanged
from edmctl.wording import coordinates

HOMED_WITHIN_UM = 2.0
"""The side gap of a hole leaves this clearance for a tool that returns into it."""


def refuse_untouchable(resumption: Resumption, plan: Plan) -> None:
    """Raise PreconditionError E8062 if there is no hole to restart."""
    if resumption.restart_hole and plan.loaded.profile.path is not None:
        raise failures.restart_hole_in_channel(run_id=resumption.job.run_id)
    if resumption.restart_hole and not resumption.state.begun:
        raise failures.no_hole_to_restart(run_id=resumption.job.run_id)


def refuse_elsewhere(resumption: Resumption, bench: ConnectedMachine, lines: Sequence[Line]) -> None:
    """Check the connected machine and the ledger's `lines` before anything moves."""
    job, journal, machine, virtual = resumption.job, resumption.journal, bench.machine, bench.virtual
    if bench.serial != job.serial:
        then = {"serial_then": job.serial, "port": job.port}
        raise failures.machine_differs(serial=bench.serial, run_id=job.run_id, **then)
    if latched := machine.latched_fault():
        raise latched
    try:
        is_same = read_journal(resumption.path).written_utc_s == journal.written_utc_s
    except FileNotFoundError:
        is_same = False
    if not is_same:
        raise failures.run_went_on(run_id=job.run_id)
    tool = resumption.state.tool
    if virtual is not None and virtual.tool_label != tool:
        problem = f"{virtual.tool_label} is in the machine; {job.run_id} had {tool}"
        raise failures.tool_not_of_run(problem=problem)
    refuse_used_tool(resumption, lines)
    if virtual is None and machine.hello.boot_count != job.boots and not resumption.homed:
        status = machine.status()
        here = f"{coordinates(status.x_um, status.y_um, 1)}, {status.theta_deg:g}°"
        raise failures.controller_restarted_since_run(
            run_id=job.run_id,
            x_um=coordinates(journal.x_um, journal.y_um, 1),
            stages_by_hand=stages_by_hand(f"{here}, within {HOMED_WITHIN_UM:g} µm"),
        )


def refuse_used_tool(resumption: Resumption, lines: Iterable[Line]) -> None:
    """Raise PreconditionError E8056 if the tool was changed or used since the run began, by the ledger."""
    tool, run_id, begun = resumption.state.tool, resumption.job.run_id, False
    lines = tuple(line for line in lines if line.serial == resumption.job.serial)
    for number, line in enumerate(lines):
        entry = line.entry
        if isinstance(entry, RunEnded):
            continue
        if isinstance(entry, JobBegun) and entry.run_file in resumption.run_files:
            begun = True
        elif not begun:
            continue
        elif isinstance(entry, ToolChanged) and entry.tool == tool:
            raise failures.tool_not_of_run(problem=f"{tool} was changed for a new one since {run_id}")
        elif entry.tool != tool:
            problem = f"{entry.tool} was in the machine since {run_id}, and not {tool}"
            raise failures.tool_not_of_run(problem=problem)
        elif isinstance(entry, JobBegun) and not _was_idle(entry.run_file, lines[number + 1 :]):
            problem = f"{tool} has machined {entry.run_file} since {run_id} was abandoned"
            raise failures.tool_not_of_run(problem=problem)


def _was_idle(run_file: str, later: Sequence[Line]) -> bool:
    """Whether a job came to its end, refused or stopped, before it cut anywhere, by the lines after its begin."""
    for line in later:
        entry = line.entry
        if isinstance(entry, JobBegun | SiteMachined):
            return False
        if isinstance(entry, RunEnded):
            return entry.run_file == run_file
    return False


def name_of_resumed(resumption: Resumption, run_id: str | None, start: datetime) -> RunName:
    """Name the run that resumes another: `run_id`, or the first run's name with `-r1`, `-r2` and so on.

    It is in the folder of that run.
    """
    folder, job = resumption.path.parent, resumption.job

    def named(run_id: str) -> RunName:
        return RunName(run_id, run_path(folder, run_id), start, job.run_id)

    if run_id is not None:
        return named(run_id)
    names = (named(f"{job.family[0]}-r{number}") for number in itertools.count(1))
    return next(name for name in names if not any(map(Path.exists, (name.path, name.partial, name.journal))))


def resumed_job(resumption: Resumption, job: Job, now: Now) -> Job:
    """Return the job with the places and the progress of the interrupted run, and the tool's home."""
    journal = resumption.journal
    job = replace(
        job,
        sites=tuple(Place(*place) for place in resumption.job.places),
        resumed=resumption.state,
        pause_s=now.since_s(journal.written_utc_s, journal.clock_s),
        restart_hole=resumption.restart_hole,
    )
    return with_home_left(job)


def find_run(named: str, folder: Path, *, homed: bool = False, restart_hole: bool = False) -> Resumption:
    """Return the interrupted run of a run file, its .partial, its .journal, or a run id in `folder`.

    A run that was resumed already refers to the last run that continues it.

    Raises PreconditionError: E8050 there is no journal, E8051 the run is finished, E8052 the journal is damaged or
    of a later version. RunFileError E9041 if it cannot be read.
    """
    path = _journal_named(named, folder)
    try:
        path, journal = _continued(path) or (path, read_journal(path))
    except FileNotFoundError:
        raise _without_journal(path) from None
    try:
        state = job_state(journal.state)
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        raise failures.journal_of_another_version(path=path, error=error) from error
    return Resumption(path, journal, state, homed, restart_hole)


def checked(
    resumption: Resumption, port: str | None, wait_s: float, surroundings: Surroundings = NONE
) -> Plan:
    """Return the plan of the run's own request, on the machine that is named now."""
    job = resumption.job
    try:
        plan = check(resumption.request(port, wait_s), surroundings)
    except UsageError as error:
        if error.code != "E2001":
            raise
        raise resumption.changed("profile", job.profile, "is not there any more") from error
    if (job.profile_sha256, job.sim_sha256) != plan.loaded.recipe:
        raise resumption.changed("profile", job.profile, "says something else by now")
    resumption.refuse_other_setup(plan.setup)
    refuse_untouchable(resumption, plan)
    refuse_used_tool(resumption, Ledger.open(resumption.path.parent).lines)
    machine = {"run_id": job.run_id, "serial": job.serial, "port": job.port}
    if (file := plan.where.bench_file) is not None and not file.exists():
        raise failures.bench_of_run_missing(file=file, **machine)
    if not plan.where.lasting:
        raise failures.machine_of_run_not_named(**machine)
    return with_resumed(replace(plan, names_tool=False), resumption)


def _journal_named(named: str, folder: Path) -> Path:
    """Return the path of a run's journal, by a path that exists or looks like one, else by its id."""
    given = user_path(named)
    for ending in (".h5.partial", ".h5", SUFFIX):
        if given.name.endswith(ending):
            return given.with_name(given.name.removesuffix(ending) + SUFFIX)
    if len(given.parts) == 1 and not given.is_file():
        return journal_path(run_path(folder, named))
    if any(given.with_name(given.name + ending).is_file() for ending in (".h5", ".h5.partial", SUFFIX)):
        return given.with_name(given.name + SUFFIX)
    raise failures.resume_not_a_run(named=named)


def _continued(path: Path) -> tuple[Path, Journal] | None:
    """Return the journal of the run that continues the one whose journal would be at `path`."""
    run_id = path.name.removesuffix(SUFFIX)
    later: list[tuple[Path, Journal]] = []
    for other in sorted(path.parent.glob(f"*{SUFFIX}")):
        try:
            journal = read_journal(other)
        except (OSError, PreconditionError, RunFileError):
            continue
        if run_id in journal.job.parents:
            later.append((other, journal))
    return max(later, key=lambda found: len(found[1].job.parents), default=None)


def _without_journal(path: Path) -> PreconditionError:
    """Return the error of a run without a journal: it is finished, unknown, or its journal is lost."""
    run_id, folder = path.name.removesuffix(SUFFIX), path.parent
    first = re.sub(r"-r\d+$", "", run_id)
    names = (run_id, f"{first}-r[0-9]*")
    files = [
        file for name in names for ending in (".h5", ".h5.partial") for file in folder.glob(f"{name}{ending}")
    ]
    if finished := sorted(file for file in files if _status(file) == "done"):
        return failures.run_finished(run_id=run_id, finished=finished[-1])
    others = sorted(file.name.removesuffix(SUFFIX) for file in folder.glob(f"*{SUFFIX}"))
    which = f"Runs with a journal there: {', '.join(others)}." if others else "No run there has a journal."
    if not files:
        where = "this folder" if folder == Path() else str(folder)
        return failures.run_unknown(run_id=run_id, where=where, which=which)
    partial = sorted(file for file in files if file.suffix == ".partial")
    recover = f" `edmctl run recover {partial[-1]}` tells whether it had come to its end." if partial else ""
    return failures.run_without_journal(run_id=run_id, which=which, recover=recover)


def _status(file: Path) -> str:
    """Return the status of a run file; empty if it cannot be read."""
    from edmctl.record.reader import open_run

    try:
        with open_run(file) as run:
            return run.text("/entry/status")
    except (RunFileError, OSError, KeyError, ValueError, RuntimeError):
        return ""
