"""Many simulated runs over the cores of this computer."""

from __future__ import annotations

import multiprocessing
import os
import threading
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from datetime import UTC, datetime
from multiprocessing import util
from typing import TYPE_CHECKING

from edmctl.__main__ import spare_start_up
from edmctl.cli.shell import shell
from edmctl.cli.signals import ignore_signals
from edmctl.console.progress import Reporter
from edmctl.errors import Interrupted, RunFileError
from edmctl.exitcodes import ExitCode, error_exit_code
from edmctl.jobs.checking import check
from edmctl.jobs.job import carry_out
from edmctl.jobs.run_header import name_run, run_path
from edmctl.jobs.simulate.statistics import run_of

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from edmctl.jobs.plan import JobRequest
    from edmctl.results.simulation import SimulatedRun


@dataclass(frozen=True, slots=True)
class Task:
    """One run: what to do, with which seed, and where its run file goes if it gets one."""

    request: JobRequest
    seed: int
    out: Path | None
    run_id: str


def check_names(tasks: Sequence[Task]) -> None:
    """Raise RunFileError (E9001, E9002) when a run file of `tasks` cannot be, before hours of runs find out."""
    from edmctl.record.disk import refuse_place

    for task in tasks:
        if task.out is None:
            continue
        try:
            refuse_place(run_path(task.out, task.run_id))
        except RunFileError as refused:
            if refused.code == "E9001":
                refused.hint = "Choose another folder with --out, or another --seed. Nothing was run."
            raise


def perform_all(tasks: Sequence[Task], reporter: Reporter) -> list[SimulatedRun]:
    """Perform `tasks`, side by side where there are cores, and return the runs in the order of the tasks."""
    workers = min(len(tasks), _cores())
    if workers == 1:
        return _one_by_one(tasks, reporter)
    _compile(reporter)
    # A forked child would inherit the threads of numba and BLAS half-way through whatever they do.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context, initializer=_serve_parent) as pool:
        futures = [pool.submit(perform, task) for task in tasks]
        try:
            reporter.runs(0, len(tasks))
            for done, future in enumerate(as_completed(futures), start=1):
                future.result()
                reporter.runs(done, len(tasks))
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for child in multiprocessing.active_children():
                child.kill()
            # The process may die of a signal: what its queues hold would be found and told by Python's tracker.
            util._run_finalizers(0)  # type: ignore[attr-defined]
            raise
        return [future.result() for future in futures]


def perform(task: Task, reporter: Reporter | None = None) -> SimulatedRun:
    """Perform one task.

    A run that fails is a result too. A stop (Interrupted) or a disk that refuses (RunFileError) is raised.
    """
    plan = check(task.request, shell())
    name = name_run(task.out, task.run_id, plan.loaded, datetime.now(UTC)) if task.out else None
    report = carry_out(plan, task.seed, reporter or Reporter(), name)
    if isinstance(report.error, Interrupted | RunFileError):
        raise report.error
    exit_code = error_exit_code(report.error) if report.error else 0
    return run_of(task.seed, exit_code, report)


def _compile(reporter: Reporter) -> None:
    """Compile once what all workers load then, and say so."""
    from edmctl.actuator.compiling import compiling_told
    from edmctl.simulator import BenchConfig, open_bench

    with compiling_told(reporter.note):
        open_bench(BenchConfig(), 0).warm_up()


def _serve_parent() -> None:
    """Prepare a worker process: the parent answers for all signals, and no worker outlives it."""
    spare_start_up()
    ignore_signals()
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(int(ExitCode.INTERNAL))


def _one_by_one(tasks: Sequence[Task], reporter: Reporter) -> list[SimulatedRun]:
    if len(tasks) == 1:
        return [perform(tasks[0], reporter)]
    runs = []
    for done, task in enumerate(tasks):
        reporter.runs(done, len(tasks))
        runs.append(perform(task))
    return runs


def _cores() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
