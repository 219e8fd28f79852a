"""`edmctl machine --resume RUN`: find the run.

It is refused if job, machine, tool or stages have changed. Depth and wear are measured again by contact, so they
need no check.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from datetime import datetime
from pathlib import Path

from edmctl import failures
from edmctl.dataclasses import replace
from edmctl.errors import (
    PreconditionError,
    RunFileError,
    UsageError,
    stages_by_hand,
)
from edmctl.files import user_path
from edmctl.jobs.connected_machine import ConnectedMachine, Now, with_home_left
from edmctl.jobs.plan import Plan, Resumption, check, with_resumed
from edmctl.jobs.run_header import RunName, run_path
from edmctl.jobs.surroundings import NONE, Surroundings
from edmctl.procedures.job import Job, job_state
from edmctl.profile.places import Place
from edmctl.record.journal import (
    SUFFIX,
    Journal,
    journal_path,
    read_journal,
)
from edmctl.record.ledger import JobBegun, Ledger, Line, RunEnded, SiteMachined, ToolChanged
from edmctl.wording import coordinates

HOMED_WITHIN_UM = 2.0
"""The side gap of a hole leaves this clearance for a tool that returns into it."""


def refuse_untouchable(resumption: Resumption, plan: Plan) -> None:
    """Raise PreconditionError E8062 if there is no hole to restart."""
    run_id = resumption.job.run_id
    is_channel = plan.loaded.profile.path is not None
    if is_channel and resumption.restart_hole:
        raise failures.restart_hole_in_channel(run_id=run_id)
    if resumption.restart_hole and not resumption.state.begun:
        raise failures.no_hole_to_restart(run_id=run_id)


def refuse_elsewhere(resumption: Resumption, bench: ConnectedMachine, lines: Sequence[Line]) -> None:
    """Check the connected machine and the ledger's `lines` before anything moves.

    Raises PreconditionError: E8051 the run was continued meanwhile, E8055 another machine, E8056 another tool, or
    one that was used since, E8057 the stage positions are unknown. FaultLatched E8010 while a fault is latched.
    """
    job, machine, virtual = resumption.job, bench.machine, bench.virtual
    serial = machine.identity.serial
    if serial != job.serial:
        raise failures.machine_differs(
            serial=serial, run_id=job.run_id, serial_then=job.serial, port=job.port
        )
    latched = machine.latched_fault()
    if latched is not None:
        raise latched
    try:
        same = read_journal(resumption.path).written_utc_s == resumption.journal.written_utc_s
    except FileNotFoundError:
        same = False
    if not same:
        raise failures.run_went_on(run_id=job.run_id)
    tool = resumption.state.tool
    if virtual is not None and virtual.tool_label != tool:
        raise failures.tool_differs(tool=virtual.tool_label, run_id=job.run_id, tool_before=tool)
    refuse_used_tool(resumption, lines)
    if virtual is None and machine.hello.boot_count != job.boots and not resumption.homed:
        status, journal = machine.status(), resumption.journal
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
            raise failures.tool_changed_since(tool=tool, run_id=run_id)
        elif entry.tool != tool:
            raise failures.another_tool_since(tool=entry.tool, run_id=run_id, tool_before=tool)
        elif isinstance(entry, JobBegun) and not _was_idle(entry.run_file, lines[number + 1 :]):
            raise failures.tool_used_since(tool=tool, run_file=entry.run_file, run_id=run_id)


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
    folder, first = resumption.path.parent, resumption.job.family[0]
    number = 1
    while run_id is None:
        name = RunName(
            f"{first}-r{number}", run_path(folder, f"{first}-r{number}"), start, resumption.job.run_id
        )
        if not any(path.exists() for path in (name.path, name.partial, name.journal)):
            return name
        number += 1
    return RunName(run_id, run_path(folder, run_id), start, resumption.job.run_id)


def taken_up(resumption: Resumption, job: Job, now: Now) -> Job:
    """Return the job with the places and the progress of the interrupted run, and the tool's home."""
    sites = tuple(Place(*place) for place in resumption.job.places)
    pause_s = now.since_s(resumption.journal.written_utc_s, resumption.journal.clock_s)
    job = replace(
        job, sites=sites, resumed=resumption.state, pause_s=pause_s, restart_hole=resumption.restart_hole
    )
    return with_home_left(job)


def find_run(named: str, folder: Path, *, homed: bool = False, restart_hole: bool = False) -> Resumption:
    """Return the interrupted run of a run file, its .partial, its .journal, or a run id in `folder`.

    A run that was resumed already refers to the last run that continues it.

    Raises PreconditionError: E8050 there is no journal, E8051 the run is finished, E8052 the journal is damaged or
    of a later version. RunFileError E9041 if it cannot be read.
    """
    path = _journal_named(named, folder)
    later = _continued(path)
    try:
        path, journal = later or (path, read_journal(path))
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
    """Return the plan of the run's own request, on the machine that is named now.

    Raises PreconditionError: E8053 profile or setup have changed,
    E8056 its tool was used since, E8058 the virtual bench does not exist. Raises as `check`.
    """
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
    bench_file = plan.where.bench_file
    if bench_file is not None and not bench_file.exists():
        raise failures.bench_of_run_missing(
            file=bench_file, run_id=job.run_id, serial=job.serial, port=job.port
        )
    if not plan.where.lasting:
        raise failures.machine_of_run_not_named(run_id=job.run_id, serial=job.serial, port=job.port)
    return with_resumed(replace(plan, names_tool=False), resumption)


def _journal_named(named: str, folder: Path) -> Path:
    """Return the path of a run's journal, by a path that exists or looks like one, else by its id."""
    given = user_path(named)
    for ending in (".h5.partial", ".h5", SUFFIX):
        if given.name.endswith(ending):
            return given.with_name(given.name.removesuffix(ending) + SUFFIX)
    for ending in (".h5", ".h5.partial", SUFFIX):
        if len(given.parts) > 1 and given.with_name(given.name + ending).is_file():
            return given.with_name(given.name + SUFFIX)
    if len(given.parts) > 1 or given.is_file():
        raise failures.resume_not_a_run(named=named)
    return journal_path(run_path(folder, named))


def _continued(path: Path) -> tuple[Path, Journal] | None:
    """Return the journal of the run that continues the one whose journal would be at `path`."""
    run_id = path.name.removesuffix(SUFFIX)
    found: list[tuple[Path, Journal]] = []
    for other in sorted(path.parent.glob(f"*{SUFFIX}")):
        try:
            journal = read_journal(other)
        except (OSError, PreconditionError, RunFileError):
            continue
        if run_id in journal.job.parents:
            found.append((other, journal))
    return max(found, key=lambda one: len(one[1].job.parents)) if found else None


def _without_journal(path: Path) -> PreconditionError:
    run_id, folder = path.name.removesuffix(SUFFIX), path.parent
    finished = [file for file in _run_files(run_id, folder) if _status(file) == "done"]
    if finished:
        return failures.run_finished(run_id=run_id, finished=finished[-1])
    others = sorted(file.name.removesuffix(SUFFIX) for file in folder.glob(f"*{SUFFIX}"))
    which = f"Runs with a journal there: {', '.join(others)}." if others else "No run there has a journal."
    where = "this folder" if folder == Path() else f"{folder}"
    if not _run_files(run_id, folder):
        return failures.run_unknown(run_id=run_id, where=where, which=which)
    left = [file for file in _run_files(run_id, folder) if file.suffix == ".partial"]
    recover = f" `edmctl run recover {left[-1]}` tells whether it had come to its end." if left else ""
    return failures.run_without_journal(run_id=run_id, which=which, recover=recover)


def _run_files(run_id: str, folder: Path) -> list[Path]:
    """Return the run's own file and the files that continue it, finished or not."""
    own = [folder / f"{run_id}.h5", folder / f"{run_id}.h5.partial"]
    first = re.sub(r"-r\d+$", "", run_id)
    later = sorted(
        file for ending in (".h5", ".h5.partial") for file in folder.glob(f"{first}-r[0-9]*{ending}")
    )
    return [*(file for file in own if file.exists()), *later]


def _status(file: Path) -> str:
    """Return the status of a run file; empty if it cannot be read."""
    from edmctl.record.reader import open_run

    try:
        with open_run(file) as run:
            return run.text("/entry/status")
    except (RunFileError, OSError, KeyError, ValueError, RuntimeError):
        return ""
