"""What a job is told of the program that runs it; it looks at no terminal, shell or signal by itself."""

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
    """Tell doubts as warnings of Python, at the line of the program that called."""
    frame, level = sys._getframe(), 1
    while frame.f_back is not None and frame.f_globals["__name__"].startswith("edmctl."):
        frame, level = frame.f_back, level + 1
    for one in found:
        warnings.warn(str(one), EdmWarning, stacklevel=level)


class Unobserved:
    """An observer that nobody looks at."""

    def progress(self, p: Progress) -> None:
        """Ignore it."""

    def note(self, text: str) -> None:
        """Ignore it."""


@dataclass(frozen=True, slots=True)
class Surroundings:
    """The program around a job.

    `command` is kept in run files; `environ` names calibrations and secrets as environment variables do. `stop`
    makes the request to stop of a machine, which may say a word when it is honoured; while the machine is connected
    `guard` is entered with that request and with what ends the session at once. `settled` is called when a result
    stands: a stop could only cut off how it is kept.
    """

    command: tuple[str, ...] = ("edmctl",)
    environ: Mapping[str, str] = field(default_factory=dict)
    stop: Callable[[Callable[[str], None]], StopRequest] = lambda _: StopRequest()
    guard: Callable[[StopRequest, Callable[[], None]], AbstractContextManager[None]] = lambda _stop, _abort: (
        nullcontext()
    )
    settled: Callable[[], None] = lambda: None


NONE = Surroundings()
"""A program that says nothing of itself."""
