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
from multiprocessing import util
from multiprocessing.synchronize import Event
from typing import Any, Generic, TypeVar

from edmctl import failures
from edmctl.dataclasses import dataclass, replace
from edmctl.errors import ExitCode, installing
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
    """A task whose worker died repeatedly."""


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
            raise failures.workers_end_early()  # this is a worker that imports the main module
        begun.append(context.Event())
        initial = (program, begun[-1])
        return ProcessPoolExecutor(workers, mp_context=context, initializer=_begin, initargs=initial)

    def kill(executor: Executor) -> None:
        for process in list((getattr(executor, "_processes", None) or {}).values()):
            process.kill()
        _close(executor)
        if program.begin_worker is not _nothing:
            # The process may die of a signal: Python's tracker would report what its queues hold.
            util._run_finalizers(0)  # type: ignore[attr-defined]

    return Pool(make, workers, kill, can_begin=lambda: any(event.is_set() for event in begun))


def pool_of(make: Callable[[], Executor], workers: int) -> Pool:
    """Return a pool of executors that a caller makes, with `workers` each."""
    return Pool(make, workers, _close)


def _close(executor: Executor) -> None:
    """Shut an executor down without waiting."""
    try:
        executor.shutdown(wait=False, cancel_futures=True)
    except TypeError:
        executor.shutdown(wait=False)


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
        series = _Series(function, tasks, pool, on_result)
        while series.waiting:
            executor = pool.make()
            try:
                series.run_on(executor)
            except BrokenExecutor as broken:
                pool.kill(executor)
                if not pool.can_begin():
                    raise failures.workers_end_early() from broken
                series.take_back()
            except BaseException:
                try:
                    series.deliver_finished()
                finally:
                    pool.kill(executor)
                raise
            else:
                executor.shutdown()


@contextmanager
def _silent_feeders() -> Iterator[None]:
    """Silence Python's feeder threads when their workers die: the pool is replaced."""
    before = threading.excepthook

    def report(raised: threading.ExceptHookArgs) -> None:
        if raised.thread is None or raised.thread.name != FEEDER:
            before(raised)

    threading.excepthook = report
    try:
        yield
    finally:
        if threading.excepthook is report:  # else another series has begun meanwhile and uses it
            threading.excepthook = before


class _Series(Generic[TaskT, ResultT]):
    """The tasks of `perform` by number: waiting, under way, and how often each was present at a loss."""

    def __init__(
        self,
        function: Callable[[TaskT], ResultT],
        tasks: Sequence[TaskT],
        pool: Pool,
        on_result: Callable[[int, ResultT | Lost], None],
    ) -> None:
        self._function, self._tasks, self._pool, self._on_result = function, tasks, pool, on_result
        self.waiting = list(range(len(tasks) - 1, -1, -1))
        self._losses: dict[int, int] = {}
        self._under_way: dict[Future[ResultT], int] = {}

    def run_on(self, executor: Executor) -> None:
        """Run all waiting tasks. Raises BrokenExecutor if a worker dies."""
        # After a loss one at a time is under way per worker, so that the guilty one is found soon.
        most = self._pool.workers * (1 if self._losses else AHEAD)
        while self.waiting or self._under_way:
            while self.waiting and len(self._under_way) < most and self._may_begin(self.waiting[-1]):
                number = self.waiting[-1]
                self._under_way[executor.submit(self._function, self._tasks[number])] = number
                self.waiting.pop()
            finished, _ = wait(self._under_way, return_when=FIRST_COMPLETED)
            for future in finished:
                try:
                    result: ResultT | Lost = future.result()
                except self._pool.killers:
                    result = Lost("its workers died repeatedly")
                self._on_result(self._under_way.pop(future), result)

    def _may_begin(self, number: int) -> bool:
        """Whether a task may run with others: a task that was lost too often runs alone."""
        together = (number, *self._under_way.values())
        return not self._under_way or all(self._losses.get(one, 0) < MOST_LOSSES - 1 for one in together)

    def take_back(self) -> None:
        """Queue the running tasks again, or abandon the task that was present at every loss."""
        self.deliver_finished()
        for number in sorted(self._under_way.values(), reverse=True):
            self._losses[number] = self._losses.get(number, 0) + 1
            if self._losses[number] >= MOST_LOSSES:
                self._on_result(number, Lost(f"its worker process died {MOST_LOSSES} times"))
            else:
                self.waiting.append(number)
        self._under_way.clear()

    def deliver_finished(self) -> None:
        """Deliver the results that came before the end of the executor."""
        for future, number in list(self._under_way.items()):
            if future.done() and not future.cancelled() and future.exception() is None:
                del self._under_way[future]
                self._on_result(number, future.result())


def _begin(program: Program, begun: Event) -> None:
    """Begin a worker process, which does not outlive its parent."""
    begun.set()
    spare_start_up()
    program.begin_worker()
    parent = multiprocessing.parent_process()

    def end_with_parent() -> None:
        if parent is not None:
            parent.join()
            os._exit(int(ExitCode.INTERNAL))

    threading.Thread(target=end_with_parent, daemon=True).start()
