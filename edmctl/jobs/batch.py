"""Many simulated runs over the cores of this computer."""

from __future__ import annotations

import multiprocessing
import os
import shlex
import threading
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from multiprocessing import util
from typing import TYPE_CHECKING, Protocol

from edmctl.errors import Interrupted, ProfileError, RunFileError, UsageError
from edmctl.exitcodes import ExitCode, error_exit_code
from edmctl.jobs.job import carry_out
from edmctl.jobs.plan import check
from edmctl.jobs.run_header import name_run, plain_name, run_path
from edmctl.jobs.statistics import run_of
from edmctl.jobs.surroundings import Unobserved
from edmctl.jobs.sweep import grid_of, of_sweep
from edmctl.results.progress import Observer

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from edmctl.jobs.plan import JobRequest, Plan
    from edmctl.jobs.surroundings import Surroundings
    from edmctl.results.simulation import SimulatedRun


class BatchObserver(Observer, Protocol):
    """Is told how many runs are done as well."""

    def runs(self, done: int, total: int) -> None:
        """`done` of `total` runs are finished."""
        ...


@dataclass(frozen=True, slots=True)
class Task:
    """One run: what to do, with which seed, and where its run file goes if it gets one."""

    request: JobRequest
    seed: int
    out: Path | None
    run_id: str


@dataclass(frozen=True, slots=True)
class Program:
    """The program that runs a batch: its surroundings, and how a worker process of its own begins.

    Both are called in each worker, because signal handlers do not travel.
    """

    surroundings: Callable[[], Surroundings]
    begin_worker: Callable[[], None]


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
        Task(case.request, seed, out, f"{plain_name(case.label)}-seed{seed}")
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
    from edmctl.record.disk import refuse_place

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
    tasks: Sequence[Task], program: Program, observer: BatchObserver
) -> Iterator[tuple[int, SimulatedRun]]:
    """Perform `tasks`, side by side where there are cores; yield each with its number when it is finished.

    A run that fails is finished too. A stop (Interrupted) or a disk that refuses (RunFileError) is raised.
    """
    workers = min(len(tasks), _cores())
    if workers == 1:
        for number, task in enumerate(tasks):
            if len(tasks) > 1:
                observer.runs(number, len(tasks))
            yield number, perform(task, program, observer if len(tasks) == 1 else Unobserved())
        return
    _compile(observer)
    # A forked child would inherit the threads of numba and BLAS half-way through whatever they do.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context, initializer=_begin, initargs=(program,)) as pool:
        futures = {pool.submit(perform, task, program): number for number, task in enumerate(tasks)}
        try:
            observer.runs(0, len(tasks))
            for done, future in enumerate(as_completed(futures), start=1):
                yield futures[future], future.result()
                observer.runs(done, len(tasks))
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for child in multiprocessing.active_children():
                child.kill()
            # The process may die of a signal: what its queues hold would be found and told by Python's tracker.
            util._run_finalizers(0)  # type: ignore[attr-defined]
            raise


def perform(task: Task, program: Program, observer: Observer | None = None) -> SimulatedRun:
    """Perform one task. Raises Interrupted and RunFileError; every other error is in the run."""
    plan = check(task.request, program.surroundings())
    name = name_run(task.out, task.run_id, plan.loaded, datetime.now(UTC)) if task.out else None
    report = carry_out(plan, task.seed, observer or Unobserved(), name)
    if isinstance(report.error, Interrupted | RunFileError):
        raise report.error
    exit_code = error_exit_code(report.error) if report.error else 0
    return run_of(task.seed, exit_code, report)


def _compile(observer: Observer) -> None:
    """Compile once what all workers load then, and say so."""
    from edmctl.actuator.compiling import compiling_told
    from edmctl.simulator import BenchConfig, open_bench

    with compiling_told(observer.note):
        open_bench(BenchConfig(), 0).warm_up()


def _begin(program: Program) -> None:
    """Begin a worker process, which does not outlive its parent."""
    program.begin_worker()
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(int(ExitCode.INTERNAL))


def _cores() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
