"""The number of threads of the BLAS libraries that numpy and scipy call."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from threading import Lock, Thread

VARIABLES = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")
"""Set the number of threads when numpy is loaded; the command line sets them to 1."""

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
