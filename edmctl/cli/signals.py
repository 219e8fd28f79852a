"""Ctrl-C, SIGTERM and SIGHUP: the first ends the job in order, the second at once."""

from __future__ import annotations

import os
import signal
import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import FrameType

    from edmctl.machine.stop import StopRequest

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


@contextmanager
def raising_signals() -> Iterator[None]:
    """While nothing moves: turn a signal into `SignalArrived`."""

    def handle(number: int, frame: FrameType | None) -> None:
        raise SignalArrived(number)

    with _handling(handle):
        yield


@contextmanager
def stopping_signals(stop: StopRequest, abort: Callable[[], None]) -> Iterator[None]:
    """While a machine may move: the first signal asks `stop`, the second calls `abort` and ends the process.

    The run file needs no closing then: what was flushed can be read.
    """

    def handle(number: int, frame: FrameType | None) -> None:
        if stop.signal_number is None:
            stop.request(number)
            _say(f"{signal_name(number)}: pulses off, retracting, closing the file. Once more aborts.\n")
            return
        abort()
        _say(f"{signal_name(number)} again: aborted.\n")
        os._exit(128 + number)

    with _handling(handle):
        yield


def ignore_signals() -> None:
    """For worker processes: a terminal sends Ctrl-C to all of them, and their parent answers for all."""
    for number in _STOPPING:
        signal.signal(number, signal.SIG_IGN)


@contextmanager
def _handling(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    before = {number: signal.signal(number, handler) for number in _STOPPING if _is_heeded(number)}
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)


def _is_heeded(number: int) -> bool:
    """`nohup` ignores SIGHUP for its program, a shell SIGINT for background jobs: leave them so."""
    return signal.getsignal(number) is not signal.SIG_IGN


def _say(text: str) -> None:
    """Write to stderr below Python's buffers, which the interrupted code may be holding."""
    try:
        os.write(sys.stderr.fileno(), text.encode())
    except (OSError, ValueError):
        return
