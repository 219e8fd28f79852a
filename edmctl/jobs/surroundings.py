"""What a job needs of the program that runs it: command, environment, stop request."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext

from edmctl.dataclasses import dataclass, field
from edmctl.errors import Diagnostic, EdmWarning
from edmctl.machine.stop import StopRequest
from edmctl.results.progress import Progress

Warn = Callable[[Sequence[Diagnostic]], None]


def python_warnings(found: Sequence[Diagnostic]) -> None:
    """Issue warnings of Python, at the line of the calling program."""
    frame, level = sys._getframe(), 1
    while frame.f_back is not None and frame.f_globals["__name__"].startswith("edmctl."):
        frame, level = frame.f_back, level + 1
    for one in found:
        warnings.warn(str(one), EdmWarning, stacklevel=level)


class Unobserved:
    """An observer that ignores everything."""

    def progress(self, p: Progress) -> None:
        """Ignore it."""

    def note(self, text: str) -> None:
        """Ignore it."""


@dataclass(frozen=True, slots=True)
class Surroundings:
    """The program around a job.

    `command` is kept in run files; `environ` names calibrations and secrets as environment variables do. `stop`
    makes the stop request of a machine, and gets a function that prints a note. While the machine is connected,
    `guard` is entered with that request and a function that ends the session at once. `settled` is called when the
    result is final: from then on a stop could only damage its file.
    """

    command: tuple[str, ...] = ("edmctl",)
    environ: Mapping[str, str] = field(default_factory=dict)
    stop: Callable[[Callable[[str], None]], StopRequest] = lambda _: StopRequest()
    guard: Callable[[StopRequest, Callable[[], None]], AbstractContextManager[None]] = lambda _stop, _abort: (
        nullcontext()
    )
    settled: Callable[[], None] = lambda: None


NONE = Surroundings()
"""A program without command line, environment or signals."""
