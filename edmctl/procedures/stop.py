"""The way out: whatever ends a procedure early, the machine is brought to its safe state first."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

    from edmctl.machine.interface import Machine


@contextmanager
def safe_state_on_error(machine: Machine) -> Iterator[None]:
    """Pulses off, retract, idle, when anything is raised inside; the error then goes on its way unchanged.

    A failure of the safe stop itself becomes a note of that error and never takes its place: the controller's
    watchdog reaches the safe state without the host.
    """
    try:
        yield
    except BaseException as error:
        try:
            machine.safe_stop()
        except Exception as failure:
            error.add_note(f"While stopping: {failure!r}")
        raise
