"""What jobs are told of the shell: its command line and environment, and how its signals stop a machine."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING

from edmctl.cli.signals import ignore_signals, signal_name, stopping_signals
from edmctl.jobs.surroundings import Surroundings
from edmctl.machine.stop import StopRequest

if TYPE_CHECKING:
    from collections.abc import Callable


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
            self._say(f"{name}: pulses off, retracting, closing the file. Once more aborts.")
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
