"""Many simulated runs over the cores of this computer."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

from edmctl.core.library import library
from edmctl.dataclasses import dataclass, replace
from edmctl.errors import Interrupted, ProfileError, RunFileError, UsageError
from edmctl.exitcodes import error_exit_code
from edmctl.jobs.job import carry_out
from edmctl.jobs.parallel import Lost, Program, cores, process_pool
from edmctl.jobs.parallel import perform as side_by_side
from edmctl.jobs.plan import JobRequest, Plan, check
from edmctl.jobs.run_header import name_run, plain_name, run_path
from edmctl.jobs.statistics import run_of
from edmctl.jobs.surroundings import Surroundings, Unobserved
from edmctl.jobs.sweep import grid_of, of_sweep
from edmctl.record.disk import refuse_place
from edmctl.results.progress import Observer, SeriesObserver
from edmctl.results.simulation import SimulatedRun
from edmctl.start_up import collect_garbage


@dataclass(frozen=True, slots=True)
class Task:
    """One run: what to do, with which seed, and where its run file goes if it gets one."""

    request: JobRequest
    seed: int
    out: Path | None
    run_id: str
    recipes: tuple[str, ...] = ("",)
    """Hashes of the recipe and of the `[sim]` table in effect, also as earlier versions made them."""


@dataclass(frozen=True, slots=True)
class Case:
    """One set of values that was asked for, checked."""

    label: str
    request: JobRequest
    plan: Plan


def cases_of(request: JobRequest, sweeps: Sequence[str], runs: int, surroundings: Surroundings) -> list[Case]:
    """Check a job with every combination of the values of its sweeps, before anything runs.

    Raises UsageError E2003 for a sweep that is none, and whatever `check` raises; what is wrong with a value of a
    sweep is told of that.
    """
    grid = grid_of(sweeps, runs)
    plan = check(request, surroundings)  # what is wrong without the sweeps is not theirs
    if not sweeps:
        return [Case(plan.loaded.path.stem, request, plan)]
    requests = [replace(request, overrides=(*request.overrides, *steps)) for steps in grid]
    try:
        plans = [check(one, surroundings) for one in requests]
    except ProfileError as error:
        raise ProfileError(tuple(of_sweep(one, sweeps) for one in error.diagnostics)) from error
    labels = [" ".join(steps) for steps in grid]
    return [Case(*one) for one in zip(labels, requests, plans, strict=True)]


def tasks_of(cases: Sequence[Case], first_seed: int, runs: int, out: Path | None) -> list[Task]:
    """Return one task per run, case after case, with the same seeds."""
    return [
        Task(
            case.request,
            seed,
            out,
            f"{plain_name(case.label)}-seed{seed}",
            tuple(" ".join(hashes) for hashes in case.plan.loaded.recipes),
        )
        for case in cases
        for seed in range(first_seed, first_seed + runs)
    ]


def command_of(request: JobRequest, seed: int) -> str:
    """Return the command of one run alone."""
    words = ["edmctl", "machine", "--seed", str(seed)]
    for option, value in (
        ("--profile", request.profile),
        ("--setup", request.setup),
        ("--calibration", request.calibration),
        *(("--set", override) for override in request.overrides),
    ):
        words += [option, str(value)] if value is not None else []
    return shlex.join([*words, *(["--allow-model"] if request.allow_model else [])])


def check_names(tasks: Sequence[Task]) -> None:
    """Raise RunFileError (E9001, E9002) when a run file of `tasks` cannot be, before hours of runs find out.

    UsageError E2005 where two of them were the same.
    """
    names = [task.run_id for task in tasks if task.out is not None]
    if again := [name for name in names if names.count(name) > 1]:
        raise UsageError(
            f"The run {again[0]} would be made twice, into one file.",
            hint="Give each seed and each value once.",
            code="E2005",
        )
    for task in tasks:
        if task.out is None:
            continue
        try:
            refuse_place(run_path(task.out, task.run_id))
        except RunFileError as refused:
            if refused.code == "E9001":
                refused.hint = "Choose another folder with --out, or another --seed. Nothing was run."
            raise


def perform_all(
    tasks: Sequence[Task],
    program: Program,
    observer: SeriesObserver,
    keep: Callable[[int, SimulatedRun], None],
) -> None:
    """Perform `tasks`, side by side where there are cores; `keep` gets each with its number when it is finished.

    A run that fails is finished too, and one whose worker died is made again. A stop (Interrupted) or a disk that
    refuses (RunFileError) is raised, and PreconditionError E8093 or E8094 where the library cannot be built.
    """
    library()  # built by this process, once
    workers = min(len(tasks), cores())
    if workers <= 1:
        for number, task in enumerate(tasks):
            if len(tasks) > 1:
                observer.runs(number, len(tasks))
            keep(number, perform(task, program, observer if len(tasks) == 1 else Unobserved()))
        return
    done = 0

    def on_result(number: int, found: SimulatedRun | Lost) -> None:
        nonlocal done
        done += 1
        if isinstance(found, Lost):
            found = SimulatedRun(tasks[number].seed, ok=False, exit_code=1, error=str(found))
        keep(number, found)
        observer.runs(done, len(tasks))

    observer.runs(0, len(tasks))
    side_by_side(partial(perform, program=program), tasks, process_pool(workers, program), on_result)


def perform(task: Task, program: Program, observer: Observer | None = None) -> SimulatedRun:
    """Perform one task. Raises Interrupted and RunFileError; every other error is in the run."""
    collect_garbage()
    plan = check(task.request, program.surroundings())
    name = name_run(task.out, task.run_id, plan.loaded, datetime.now(UTC)) if task.out else None
    if name is not None:
        for left in (name.path, name.partial):
            left.unlink(missing_ok=True)  # of a worker that died; a file of another series was refused before
    report = carry_out(plan, task.seed, observer or Unobserved(), name)
    if isinstance(report.error, Interrupted | RunFileError):
        raise report.error
    exit_code = error_exit_code(report.error) if report.error else 0
    return run_of(task.seed, exit_code, report)
