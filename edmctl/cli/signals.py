"""Ctrl-C, SIGTERM and SIGHUP: the first ends the job in order, the second at once.

Either way the process dies of the signal in the end, so that a shell stops its loop or script as well.
"""

from __future__ import annotations

import os
import signal
import sys
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from edmctl.jobs.surroundings import Surroundings
from edmctl.machine.stop import StopRequest

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from sys import UnraisableHookArgs
    from types import FrameType
    from typing import NoReturn


_SHOW_CURSOR = "\r\x1b[K\x1b[?25h"
"""In the place of the line that the terminal has written ^C into."""
_WAY_ON = "`edmctl run list` has the run, and `edmctl run explain RUN` tells how it goes on"
_STOPPING = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


class SignalArrived(BaseException):
    """A signal came while nothing moved.

    A BaseException, so that no library takes it for an error of its own.
    """

    def __init__(self, signal_number: int) -> None:
        super().__init__(signal_number)
        self.signal_number = signal_number


def signal_name(number: int) -> str:
    """Return `SIGINT` and the like."""
    return signal.Signals(number).name


_lost: list[int] = []
"""Signals whose exception a callback of a library has swallowed: Python can only tell of it."""


@contextmanager
def raising_signals() -> Iterator[None]:
    """While nothing moves: turn a signal into `SignalArrived`.

    One that comes while a library calls back, or an object is finalized, is raised as soon as a machine may move, or
    at the end.
    """

    def handle(number: int, frame: FrameType | None) -> None:
        raise SignalArrived(number)

    def note(unraisable: UnraisableHookArgs) -> None:
        if isinstance(unraisable.exc_value, SignalArrived):
            _lost.append(unraisable.exc_value.signal_number)
        else:
            before(unraisable)

    before, sys.unraisablehook = sys.unraisablehook, note
    _lost.clear()
    try:
        with _handling(handle):
            yield
            _raise_lost()
    finally:
        sys.unraisablehook = before


def _raise_lost() -> None:
    if _lost:
        raise SignalArrived(_lost.pop(0))


@contextmanager
def stopping_signals(stop: StopRequest, abort: Callable[[], None]) -> Iterator[None]:
    """While a machine may move: the first signal asks `stop`, the second calls `abort` and ends the process.

    The first says nothing here: a terminal may be half-way through a picture. The run file needs no closing
    after the second: what was flushed can be read.
    """

    def handle(number: int, frame: FrameType | None) -> None:
        if stop.signal_number is None:
            stop.request(number)
            return
        abort()
        _say(f"{signal_name(number)} again: aborted; {_WAY_ON}.\n")
        die_of(number)

    with _handling(handle):
        _raise_lost()
        yield


@contextmanager
def requests_by_signal(name: str) -> Iterator[Callable[[], bool]]:
    """Give a function that returns whether the signal `name` has come since its last call; never without such."""
    requests: list[int] = []
    number = getattr(signal, name, None)

    def was_requested() -> bool:
        has_come = bool(requests)
        requests.clear()
        return has_come

    before = signal.signal(number, lambda number, _: requests.append(number)) if number else None
    try:
        yield was_requested
    finally:
        if number:
            signal.signal(number, before)


def ignore_signals() -> None:
    """For worker processes, whose parent answers for all of them, and for a process whose result is settled."""
    for number in _STOPPING:
        signal.signal(number, signal.SIG_IGN)


def leave(exit_code: int) -> NoReturn:
    """End this process at once, by the signal that `exit_code` stands for if it does.

    The teardown of libraries is left out: a signal in the middle of it would end a finished run with a traceback.
    """
    ignore_signals()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    if exit_code - 128 in _STOPPING:
        die_of(exit_code - 128)
    os._exit(exit_code)


def die_of(number: int) -> NoReturn:
    """End this process by a signal: only then does a shell that sees it stop its loop too."""
    signal.signal(number, signal.SIG_DFL)
    os.kill(os.getpid(), number)
    os._exit(128 + number)


@contextmanager
def _handling(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    # `nohup` ignores SIGHUP for its program, a shell SIGINT for background jobs: they stay ignored.
    heeded = [number for number in _STOPPING if signal.getsignal(number) is not signal.SIG_IGN]
    before = {number: signal.signal(number, handler) for number in heeded}
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)


def _say(text: str) -> None:
    """Write to stderr below Python's buffers, which the interrupted code may hold."""
    try:
        number = sys.stderr.fileno()
        # The picture that is interrupted had hidden the cursor.
        before = _SHOW_CURSOR if os.isatty(number) else ""
        os.write(number, (before + text).encode())
    except (OSError, ValueError):
        return


class AnnouncedStop(StopRequest):
    """Says once what happens now. A signal handler could not: it may have interrupted the drawing of a picture."""

    __slots__ = ("_announced", "_say")

    def __init__(self, say: Callable[[str], None]) -> None:
        super().__init__()
        self._say = say
        self._announced = False

    def check(self) -> None:
        """Announce the stop that was asked for, and raise `Interrupted`."""
        if self.signal_number is not None and not self._announced:
            self._announced = True
            name = signal_name(self.signal_number)
            self._say(f"{name}: pulses off, retracting, closing the run file. Press Ctrl-C again to abort.")
        super().check()


def shell() -> Surroundings:
    """Return what jobs are told of this process; a signal stops their machine in order."""
    return Surroundings(
        command=("edmctl", *sys.argv[1:]),
        environ=dict(os.environ),
        stop=AnnouncedStop,
        guard=stopping_signals,
        settled=ignore_signals,
    )
