"""A stop request: set once by a signal handler, honoured by every wait of the machine."""

from __future__ import annotations

import signal

from edmctl.errors import Interrupted


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
