"""How a machine is stopped: on an error, and on a request that a signal handler has set."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager

from edmctl.errors import Interrupted
from edmctl.machine.interface import Machine


class StopRequest:
    """Carries a signal from its handler into the procedure that is waiting for the machine.

    A handler only stores the number; the wait that sees it raises `Interrupted`, so the procedure unwinds
    through its own safe stop. The first request wins.
    """

    __slots__ = ("_signal_number",)

    def __init__(self) -> None:
        self._signal_number: int | None = None

    @property
    def signal_number(self) -> int | None:
        """Number of the signal that asked to stop, None when nothing did."""
        return self._signal_number

    def request(self, signal_number: int) -> None:
        """Ask for a stop. Safe to call from a signal handler. Raises ValueError for what is no signal's number."""
        signal.Signals(signal_number)
        if self._signal_number is None:
            self._signal_number = signal_number

    def check(self) -> None:
        """Raise `Interrupted` when a stop was asked for."""
        if self._signal_number is not None:
            name = signal.Signals(self._signal_number).name
            raise Interrupted(f"Stopped by {name}.", signal_number=self._signal_number)


@contextmanager
def safe_state_on_error(machine: Machine) -> Iterator[None]:
    """Pulses off, retract, idle, when anything is raised inside; the error is then raised unchanged.

    A failure of the safe stop itself becomes a note of that error and never replaces it: the controller's watchdog
    reaches the safe state without the host.
    """
    try:
        yield
    except BaseException as error:
        try:
            machine.safe_stop()
        except Exception as failure:
            error.add_note(f"While stopping: {failure!r}")
        raise
