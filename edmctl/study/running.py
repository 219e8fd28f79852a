"""Runs on fresh virtual machines: a run from its request to its row, and many runs in parallel."""

from __future__ import annotations

import hashlib
import socket
import time
from collections.abc import Mapping
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

from edmctl import failures
from edmctl.core.library import library
from edmctl.dataclasses import dataclass, replace
from edmctl.errors import EdmError, Interrupted, RunFileError, error_exit_code
from edmctl.files import open_regular
from edmctl.jobs.parallel import Lost, Pool, Program, perform
from edmctl.jobs.plan import FRESH, JobRequest, MachineAddress, Plan, check
from edmctl.jobs.run_header import RunName, run_path
from edmctl.jobs.surroundings import NONE, Unobserved
from edmctl.jsonout import JsonValue
from edmctl.results.progress import SeriesObserver
from edmctl.start_up import collect_garbage
from edmctl.study.folder import StudyFolder, StudyState, bench_of
from edmctl.study.planning import request_of
from edmctl.study.responses import responses_of, truth_of
from edmctl.study.results import PlannedRun, RunRow, RunState, StudyRun


@dataclass(frozen=True, slots=True)
class RunTask:
    """One attempt at a run on a fresh virtual machine; `folder` is where its run file goes, if it gets one."""

    run: PlannedRun
    attempt: int
    request: JobRequest
    recipe: tuple[str, str] | None
    folder: Path | None


def task_of(folder: StudyFolder, run: StudyRun) -> RunTask:
    """Return the next attempt at a run as a task for any worker."""
    return RunTask(
        run.planned,
        run.attempts + 1,
        request_of(folder.base, run.planned.settings),
        folder.recipes.get(run.planned.point),
        folder.runs if folder.source.file.study.run_files else None,
    )


def evaluate(task: RunTask, program: Program | None = None) -> RunRow:
    """Make a run on a fresh virtual machine, and return its row, also if the job failed.

    Raises Interrupted, RunFileError, and PreconditionError E8203 where the recipe is not the planned one.
    """
    from edmctl.jobs.job import carry_out

    started, begin_s = datetime.now(UTC), time.perf_counter()
    collect_garbage()
    plan = check(task.request, program.surroundings() if program is not None else NONE)
    refuse_other_recipe(plan, task.recipe, task.run)
    name = None
    if task.folder is not None:
        name = run_name(task.folder, task.run, task.attempt, started)
        for left in (name.path, name.partial, name.journal):
            left.unlink(missing_ok=True)  # of a worker that was killed: there is no row of it
    report = carry_out(plan, task.run.seed, Unobserved(), name)
    if isinstance(report.error, Interrupted | RunFileError):
        raise report.error
    row = bare_row(task.run, task.attempt, task.run.seed, started)
    row = row_of(row, plan, report.to_dict(), report.run_file, report.error)
    return replace(row, duration_s=round(time.perf_counter() - begin_s, 3))


def run_name(folder: Path, run: PlannedRun, attempt: int, start: datetime) -> RunName:
    """Name the run file of an attempt: `run0007`, of the second one `run0007-a2`."""
    run_id = f"run{run.number:04d}" + (f"-a{attempt}" if attempt > 1 else "")
    return RunName(run_id, run_path(folder, run_id), start)


def refuse_other_recipe(plan: Plan, recipe: tuple[str, str] | None, run: PlannedRun) -> None:
    """Raise PreconditionError E8203 where a run's recipe in effect is not the one that was planned."""
    if recipe is not None and recipe != plan.loaded.recipe:
        raise failures.recipe_of_run_differs(number=run.number)


def row_of(
    bare: RunRow, plan: Plan, result: Mapping[str, JsonValue], file: Path | None, error: EdmError | None
) -> RunRow:
    """Return the row of an attempt with the result of its job."""
    digest = ""
    if file is not None:
        with open_regular(file) as opened:
            digest = hashlib.file_digest(opened, "sha256").hexdigest()
    return replace(
        bare,
        exit_code=error_exit_code(error) if error is not None else 0,
        error=f"{error.code}: {error.message}" if error is not None else None,
        **responses_of(result, getattr(plan.loaded.profile.target, "depth_um", None)),
        truth=truth_of(result),
        run_files=(file.name,) if file is not None else (),
        run_sha256=digest,
    )


def lost_row(run: PlannedRun, attempt: int, why: str, exit_code: int = 1) -> RunRow:
    """Return the row of an attempt without a result: no worker survived it, or its hole was given up."""
    return replace(bare_row(run, attempt, run.seed, datetime.now(UTC)), exit_code=exit_code, error=why)


def bare_row(run: PlannedRun, attempt: int, seed: int | None, started: datetime) -> RunRow:
    """Return the row of an attempt that has ended, without any response."""
    names = ("number", "point", "replicate", "block", "tool", "settings")
    planned = {name: getattr(run, name) for name in names}
    time, host = started.isoformat(timespec="milliseconds"), socket.gethostname()
    kind = str(run.kind)
    return RunRow(**planned, kind=kind, site_um=None, seed=seed, attempt=attempt, started=time, host=host)


def refuse_mixture(state: StudyState, machine: MachineAddress, command: str = "resume") -> None:
    """Raise UsageError E2108 for runs on both virtual and persistent machines or on two benches.

    Raises PreconditionError E8214 if the bench of the study is gone. A controller may return at another port.
    `command` is the one that the user has called.
    """
    port = state.rows.port
    bench = bench_of(port) if port else None
    has_runs = any(run.row is not None for run in state.runs)
    if port and (not machine.lasting or (bench and bench_of(machine.selector) != bench)):
        raise failures.study_of_another_machine(port=port, making_command=state.making_command(command))
    if bench and has_runs and not bench.exists():
        raise failures.study_bench_gone(bench=bench)
    if machine.lasting and not port and has_runs:
        raise failures.study_has_virtual_runs()


def run_virtual(
    folder: StudyFolder,
    observer: SeriesObserver,
    program: Program | None = None,
    pool: Pool | None = None,
) -> int:
    """Make the open runs, each on a fresh virtual machine; return their number.

    Rows are on disk when they are counted. `pool` makes them in parallel; without it, this process makes them.

    Raises UsageError E2108 if runs of the study are on a machine that lasts, PreconditionError E8201 if another
    command makes runs of the study, E8093 or E8094 if the library cannot be built, and what `evaluate` raises.
    """
    with folder.claimed(), folder.writer() as writer:
        state = folder.read()
        refuse_mixture(state, FRESH)
        tasks = [task_of(folder, run) for run in state.runs if run.state is RunState.OPEN]
        if not tasks:
            return 0
        library()  # built by this process, once
        if tasks[0].folder is not None:
            tasks[0].folder.mkdir(exist_ok=True)
        done = 0

        def keep(number: int, row: RunRow | Lost) -> None:
            nonlocal done
            if isinstance(row, Lost):
                row = lost_row(tasks[number].run, tasks[number].attempt, f"E1000: {row}")
            writer.run(row)
            done += 1
            observer.runs(done, len(tasks))

        observer.runs(0, len(tasks))
        if pool is None:
            for number, task in enumerate(tasks):
                keep(number, evaluate(task, program))
        else:
            perform(partial(evaluate, program=program), tasks, pool, keep)
        return done
