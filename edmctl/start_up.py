"""What a process of its own spares itself, and how many threads BLAS has in one that imports edmctl."""

from __future__ import annotations

import gc
import os
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from threading import Lock, Thread

from edmctl import failures

VARIABLES = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")
"""Set the number of threads when numpy is loaded; the command line sets them to 1."""
FEW_CYCLES = 200_000
"""Objects made since the last search for cycles at which Python searches again; its own number is 700. Rows and
frames are freed without a search, and each search looks at all that was imported, for some 20 ms."""


def spare_start_up() -> None:
    """Spare this process what edmctl never uses; a program that imports edmctl has it all.

    BLAS keeps to one thread: matrices are small, and threads would only wait for each other, on busy cores 40 ms at
    a time. The garbage collector looks for cycles rarely, and pydantic looks for no plugins in all packages that
    are installed.
    """
    gc.set_threshold(FEW_CYCLES)
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    for name in VARIABLES:
        os.environ.setdefault(name, "1")


def collect_garbage() -> None:
    """Free the virtual machine of the run before: plant and controller refer to each other.

    In a process that is spared, what is left is not looked at again: modules and caches, 20 ms each time.
    """
    gc.collect()
    if gc.get_threshold()[0] == FEW_CYCLES:  # spared
        gc.freeze()


def refuse_wrong_clock() -> None:
    """Raise PreconditionError E8096 if the clock of this computer is beyond what Python can represent (2262)."""
    try:
        time.time()
    except OverflowError:
        raise failures.clock_wrong() from None


_limit, _lock = ExitStack(), Lock()
_users = 0


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit BLAS to one thread inside a `with` block or, as a decorator, inside a function.

    The matrices here are small: further threads mostly wait for each other and cost several times the CPU time.
    The limit applies to the process and ends with the last of several concurrent blocks. A number of threads that
    is set in the environment remains.
    """
    if any(name in os.environ for name in VARIABLES):
        yield
        return
    _count(1)
    try:
        yield
    finally:
        _count(-1)


def _count(more: int) -> None:
    """Add to the number of blocks; the first sets the limit and the last removes it."""
    global _users
    with _lock:
        before, _users = _users, _users + more
        if not before:
            _in_own_thread(_set)
        elif not _users:
            _in_own_thread(_limit.close)


def _set() -> None:
    from threadpoolctl import threadpool_limits

    _limit.enter_context(threadpool_limits(1, "blas"))


def _in_own_thread(act: Callable[[], None]) -> None:
    """Run `act` in a thread that ends: while a thread that set a limit lives, threadpoolctl ignores all others."""
    thread = Thread(target=act)
    thread.start()
    thread.join()
