"""`edmctl machine --resume RUN`: which run is meant, and every reason not to take it up again.

Taking up needs to know where the hole is, how deep it is and which tool made it. Depth and wear are touched again,
so they need no trust; job, machine, tool and the place of the stages do.
"""

from __future__ import annotations

import re
from dataclasses import replace
from datetime import datetime
from pathlib import Path

from edmctl.errors import PreconditionError, RunFileError, UsageError
from edmctl.files import user_path
from edmctl.jobs.connected_machine import Now
from edmctl.jobs.ledger.elapsed import with_home_left
from edmctl.jobs.plan import Plan, Resumption, check, with_resumed
from edmctl.jobs.resume.checks import refuse_untouchable, refuse_used_tool
from edmctl.jobs.run_header import RunName, run_path
from edmctl.jobs.surroundings import NONE, Surroundings
from edmctl.procedures.job import Job
from edmctl.procedures.job_state import job_state
from edmctl.profile.places import Place
from edmctl.record.journal import SUFFIX, Journal, JournalledJob, journal_path, read_journal
from edmctl.record.ledger import Ledger

_DONE = "done"
_ANOTHER_PLACE = "Machine it at another place or on new work."


def name_of_resumed(resumption: Resumption, run_id: str | None, start: datetime) -> RunName:
    """Name the run that goes on: by `run_id`, or else after the first run, `a-r1`, `a-r2` and so on.

    It stands in the folder of the run before.
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
    """Return the job with the places of the run before, how far that came, and where the tool's home was."""
    sites = tuple(Place(*place) for place in resumption.job.places)
    pause_s = now.since_s(resumption.journal.written_utc_s, resumption.journal.clock_s)
    job = replace(
        job, sites=sites, resumed=resumption.state, pause_s=pause_s, restart_hole=resumption.restart_hole
    )
    return with_home_left(job)


def find_run(named: str, folder: Path, *, homed: bool = False, restart_hole: bool = False) -> Resumption:
    """Return the interrupted run that is meant by a run file, its .partial, its .journal, or a run id in `folder`.

    A run that was taken up already stands for the last one that goes on with it.

    Raises PreconditionError: E8050 there is no journal, E8051 the run is finished, E8052 the journal is damaged or
    of a later version. RunFileError E9041 where it cannot be read.
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
        raise PreconditionError(
            f"The journal {path} does not fit this version: {error}.",
            hint="Take the run up again with the version of edmctl that wrote it.",
            code="E8052",
        ) from error
    return Resumption(path, journal, state, homed, restart_hole)


def checked(
    resumption: Resumption, port: str | None, wait_s: float, surroundings: Surroundings = NONE
) -> Plan:
    """Return the plan of the run's own request, on the machine that is named now.

    Raises PreconditionError: E8053 profile or setup are not what they were, E8054 the journal tells nothing of its
    channel, E8056 its tool was used since, E8058 the virtual bench is gone. Whatever `check` raises.
    """
    job = resumption.job
    try:
        plan = check(resumption.request(port, wait_s), surroundings)
    except UsageError as error:
        if error.code != "E2001":
            raise
        raise _changed("profile", job.profile, "is not there any more", resumption) from error
    if (job.profile_sha256, job.sim_sha256) not in plan.loaded.recipes:
        raise _changed("profile", job.profile, "says something else by now", resumption)
    refuse_other_setup_of_run(plan, resumption)
    refuse_untouchable(resumption, plan)
    refuse_used_tool(resumption, Ledger.open(resumption.path.parent).lines)
    bench_file = plan.where.bench_file
    if not plan.where.lasting or (bench_file is not None and not bench_file.exists()):
        raise _bench_gone(job, str(bench_file) if bench_file else "")
    return with_resumed(replace(plan, names_tool=False), resumption)


def refuse_other_setup_of_run(plan: Plan, resumption: Resumption) -> None:
    """Raise PreconditionError E8053 where the setup in effect is not that of the interrupted run."""
    job = resumption.job
    if plan.setup.sha256 != job.setup_sha256:
        now = "" if plan.setup.file is None else f"; {plan.setup.file} is used now"
        raise _changed("setup", job.setup or "of the stock machine", f"has changed{now}", resumption)


def _journal_named(named: str, folder: Path) -> Path:
    """Where the journal of a run is: by a path that exists or looks like one, else by its id."""
    given = user_path(named)
    for ending in (".h5.partial", ".h5", SUFFIX):
        if given.name.endswith(ending):
            return given.with_name(given.name.removesuffix(ending) + SUFFIX)
    for ending in (".h5", ".h5.partial", SUFFIX):
        if len(given.parts) > 1 and given.with_name(given.name + ending).is_file():
            return given.with_name(given.name + SUFFIX)
    if len(given.parts) > 1 or given.is_file():
        raise UsageError(
            f"--resume {named} is no run file.",
            hint="Name FILE.h5, its .h5.partial or its .journal, or the run's id, with its folder as --out.",
            code="E2004",
        )
    return journal_path(run_path(folder, named))


def _continued(path: Path) -> tuple[Path, Journal] | None:
    """The journal of the run that goes on with the one whose journal would be at `path`."""
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
    finished = [file for file in _run_files(run_id, folder) if _status(file) == _DONE]
    if finished:
        return PreconditionError(
            f"{run_id} is finished; its result is in {finished[-1]}.",
            hint="There is nothing to take up again.",
            code="E8051",
        )
    others = sorted(file.name.removesuffix(SUFFIX) for file in folder.glob(f"*{SUFFIX}"))
    which = f"Runs with a journal there: {', '.join(others)}." if others else "No run there has a journal."
    where = "this folder" if folder == Path() else f"{folder}"
    if not _run_files(run_id, folder):
        hint = f"{which} --out names another folder."
        return PreconditionError(f"There is no run {run_id} in {where}.", hint=hint, code="E8050")
    left = [file for file in _run_files(run_id, folder) if file.suffix == ".partial"]
    recover = f" `edmctl run recover {left[-1]}` tells whether it had come to its end." if left else ""
    return PreconditionError(
        f"{run_id} has no journal, so nobody knows how far it came.",
        hint="A fresh virtual machine (sim:) is gone with its command and keeps none; jobs on sim:FILE, on a served "
        f"bench and on hardware do. {which}{recover}",
        code="E8050",
    )


def _run_files(run_id: str, folder: Path) -> list[Path]:
    """The run's own file and those that go on with it, finished or not."""
    own = [folder / f"{run_id}.h5", folder / f"{run_id}.h5.partial"]
    first = re.sub(r"-r\d+$", "", run_id)
    later = sorted(
        file for ending in (".h5", ".h5.partial") for file in folder.glob(f"{first}-r[0-9]*{ending}")
    )
    return [*(file for file in own if file.exists()), *later]


def _status(file: Path) -> str:
    """How a run ended; empty where its file cannot tell."""
    from edmctl.record.reader import open_run

    try:
        with open_run(file) as run:
            return run.text("/entry/status")
    except (RunFileError, OSError, KeyError, ValueError, RuntimeError):
        return ""


def _changed(what: str, which: str, how: str, resumption: Resumption) -> PreconditionError:
    job, hint = resumption.job, "It has cut nothing: start a new job, without --resume."
    if resumption.state.has_cut:
        hint = f"Put back the {what} as it was on {job.start[:10]}; the run file holds it. {_ANOTHER_PLACE}"
    return PreconditionError(
        f"The {what} {which} {how}; {job.run_id} was another job.",
        hint=hint,
        code="E8053",
    )


def _bench_gone(job: JournalledJob, bench_file: str) -> PreconditionError:
    if bench_file:
        what = f"There is no bench {bench_file}"
    else:
        what = "No machine was named, and a fresh virtual one has no work that was begun"
    return PreconditionError(
        f"{what}: {job.run_id} ran on {job.serial} at {job.port}.",
        hint="Name the file of that bench with --port sim:FILE." if bench_file else f"Say --port {job.port}.",
        code="E8058",
    )
