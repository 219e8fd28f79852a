"""Many tasks in parallel over any executor of `concurrent.futures`; a broken pool is replaced."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from contextlib import contextmanager
from functools import partial
from multiprocessing import util
from multiprocessing.synchronize import Event
from typing import Any, Generic, TypeVar

from edmctl import failures
from edmctl.dataclasses import dataclass, field, replace
from edmctl.errors import PreconditionError, installing
from edmctl.exitcodes import ExitCode
from edmctl.jobs.surroundings import Surroundings
from edmctl.start_up import spare_start_up

TaskT = TypeVar("TaskT")
ResultT = TypeVar("ResultT")

MOST_LOSSES = 3
"""A task that was running when this many pools broke, alone in the last of them, is the cause."""
FEEDER = "QueueFeederThread"
"""Name of the threads in which `multiprocessing` writes into the queue of a pool."""
AHEAD = 2
"""Tasks handed over per worker: one that is done finds the next one waiting."""


@dataclass(frozen=True, slots=True)
class Program:
    """The program that runs tasks: its surroundings, and how a worker process of its own begins.

    Both are called in each worker, because signal handlers do not travel.
    """

    surroundings: Callable[[], Surroundings]
    begin_worker: Callable[[], None]


def _nothing() -> None:
    pass


def silent_program() -> Program:
    """Return the program of one that has no terminal, signals or environment to hand on."""
    return Program(Surroundings, _nothing)


class Lost(Exception):
    """A task whose worker died again and again."""


@dataclass(frozen=True, slots=True)
class Pool:
    """How an executor is made, how many tasks it takes at a time, and how its workers are ended at once."""

    make: Callable[[], Executor]
    workers: int
    kill: Callable[[Executor], None]
    killers: tuple[type[BaseException], ...] = ()
    """Errors of a task whose workers died repeatedly, for executors that retry by themselves."""
    can_begin: Callable[[], bool] = lambda: True
    """Whether workers begin at all; a worker that has begun and dies later is replaced."""


def cores() -> int:
    """Return how many processors this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def process_pool(workers: int, program: Program) -> Pool:
    """Return a pool of processes of this computer, which do not outlive this one."""
    # A forked child would inherit the threads of BLAS half-way through whatever they do.
    context = multiprocessing.get_context("spawn")
    begun: list[Event] = []

    def make() -> Executor:
        if getattr(multiprocessing.current_process(), "_inheriting", False):
            raise _unguarded()  # this is a worker that imports the main module
        begun.append(context.Event())
        initial = (program, begun[-1])
        return ProcessPoolExecutor(workers, mp_context=context, initializer=_begin, initargs=initial)

    return Pool(
        make,
        workers,
        partial(_kill, is_ending=program.begin_worker is not _nothing),
        can_begin=lambda: any(event.is_set() for event in begun),
    )


def _unguarded() -> PreconditionError:
    return failures.workers_end_early()


def pool_of(make: Callable[[], Executor], workers: int) -> Pool:
    """Return a pool of executors that a caller makes, with `workers` each."""
    return Pool(make, workers, _close)


@contextmanager
def dask_pool(address: str) -> Iterator[Pool]:
    """Give the workers of a dask cluster as a pool. Raises PreconditionError E8212 without dask or a scheduler."""
    try:
        import distributed
    except ImportError:
        raise failures.dask_missing(install=installing("edmctl[cluster]")) from None
    try:
        make: Any = distributed.Client
        client = make(address, timeout=10, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as refused:
        raise failures.dask_scheduler_silent(address=address, reason=type(refused).__name__) from refused
    try:
        with client:
            workers = sum(client.nthreads().values())
            if not workers:
                raise failures.dask_without_workers(address=address)
            killers: tuple[type[BaseException], ...] = (distributed.KilledWorker,)
            yield replace(pool_of(lambda: client.get_executor(pure=False), workers), killers=killers)
    except (CancelledError, ConnectionError) as lost:  # dask cancels the tasks of a lost scheduler
        raise failures.dask_scheduler_gone(address=address) from lost


def perform(
    function: Callable[[TaskT], ResultT],
    tasks: Sequence[TaskT],
    pool: Pool,
    on_result: Callable[[int, ResultT | Lost], None],
) -> None:
    """Call `function` with every task; `on_result` gets number and result of each finished task, in any order.

    The task of a worker that died is repeated; a task that broke three pools, the last time alone, is `Lost`. An
    error of `function` or `on_result`, or a signal, ends all; finished results are still delivered. Raises
    PreconditionError E8218 if no worker can start.
    """
    with _silent_feeders():
        _Series(function, tasks, pool, on_result, list(range(len(tasks) - 1, -1, -1))).run()


@contextmanager
def _silent_feeders() -> Iterator[None]:
    """Silence Python's feeder threads when their workers die: the pool is replaced."""
    before = threading.excepthook

    def say(raised: threading.ExceptHookArgs) -> None:
        if raised.thread is None or raised.thread.name != FEEDER:
            before(raised)

    threading.excepthook = say
    try:
        yield
    finally:
        if threading.excepthook is say:  # else another series has begun meanwhile, and goes on by it
            threading.excepthook = before


@dataclass(slots=True, eq=False)
class _Series(Generic[TaskT, ResultT]):
    function: Callable[[TaskT], ResultT]
    tasks: Sequence[TaskT]
    pool: Pool
    on_result: Callable[[int, ResultT | Lost], None]
    waiting: list[int]
    losses: dict[int, int] = field(default_factory=dict)
    under_way: dict[Future[ResultT], int] = field(default_factory=dict)

    def run(self) -> None:
        while self.waiting:
            executor = self.pool.make()
            try:
                self._run_on(executor)
            except BrokenExecutor as broken:
                self.pool.kill(executor)
                if not self.pool.can_begin():
                    raise _unguarded() from broken
                self._take_back()
            except BaseException:
                try:
                    self._hand_on_rest()
                finally:
                    self.pool.kill(executor)
                raise
            else:
                executor.shutdown()

    def _run_on(self, executor: Executor) -> None:
        # After a loss one at a time is under way per worker, so that the guilty one is found soon.
        most = self.pool.workers * (1 if self.losses else AHEAD)
        while self.waiting or self.under_way:
            while self.waiting and len(self.under_way) < most and self._may_begin(self.waiting[-1]):
                number = self.waiting.pop()
                try:
                    self.under_way[executor.submit(self.function, self.tasks[number])] = number
                except BrokenExecutor:
                    self.waiting.append(number)
                    raise
            finished, _ = wait(self.under_way, return_when=FIRST_COMPLETED)
            for future in finished:
                try:
                    result: ResultT | Lost = future.result()
                except self.pool.killers:
                    result = Lost("its workers died again and again")
                self.on_result(self.under_way.pop(future), result)

    def _may_begin(self, number: int) -> bool:
        """Whether a task may run with others: a task that was lost too often runs alone."""
        together = (number, *self.under_way.values())
        return not self.under_way or all(self.losses.get(one, 0) < MOST_LOSSES - 1 for one in together)

    def _take_back(self) -> None:
        """Queue the running tasks again, or abandon the task that was present at every loss."""
        self._hand_on_rest()
        for number in sorted(self.under_way.values(), reverse=True):
            self.losses[number] = self.losses.get(number, 0) + 1
            if self.losses[number] >= MOST_LOSSES:
                self.on_result(number, Lost(f"its worker process died {MOST_LOSSES} times"))
            else:
                self.waiting.append(number)
        self.under_way.clear()

    def _hand_on_rest(self) -> None:
        for future, number in list(self.under_way.items()):
            if future.done() and not future.cancelled() and future.exception() is None:
                del self.under_way[future]
                self.on_result(number, future.result())


def _kill(executor: Executor, *, is_ending: bool) -> None:
    """Kill the workers of a pool, and no other processes."""
    for process in list((getattr(executor, "_processes", None) or {}).values()):
        process.kill()
    _close(executor)
    if is_ending:
        # The process may die of a signal: what its queues hold would be found and told by Python's tracker.
        util._run_finalizers(0)  # type: ignore[attr-defined]


def _close(executor: Executor) -> None:
    """Shut an executor down without waiting."""
    try:
        executor.shutdown(wait=False, cancel_futures=True)
    except TypeError:
        executor.shutdown(wait=False)


def _begin(program: Program, begun: Event) -> None:
    """Begin a worker process, which does not outlive its parent."""
    begun.set()
    spare_start_up()
    program.begin_worker()
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(int(ExitCode.INTERNAL))
