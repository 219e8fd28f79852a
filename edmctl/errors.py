"""Errors a user can act on.

    EdmError
    ├── UsageError            exit 2    the command line asks for something that is not there
    ├── ProfileError          exit 3    profile or setup invalid (carries every diagnostic)
    ├── RecordError           exit 3    measured data, a calibration made of it, or a firmware image, invalid
    ├── LinkLost              exit 4    no port, no answer, or the line went dead
    ├── ProtocolMismatch      exit 5    the controller speaks another version
    ├── MachineFault          exit 6    the controller latched a fault; the safe state is reached
    ├── ObjectiveNotReached   exit 7    depth, time or wear limit
    ├── PreconditionError     exit 8    not calibrated, interlock open, no reference
    ├── RunFileError          exit 9    run file or disk
    └── Interrupted           exit 130 / 143   Ctrl-C or SIGTERM; the safe state is reached

Each carries a stable `code`, a `message` that says what happened with its numbers, and a `hint` that says
what to do. Anything else that escapes is a bug (exit 1).
"""

from __future__ import annotations

import shlex
import sys
from enum import IntEnum
from typing import ClassVar

from edmctl.dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Location:
    """A place in a text file. Lines and columns count from 1, columns in characters."""

    file: str
    line: int
    column: int
    length: int = 1
    source_line: str = ""


@dataclass(frozen=True, slots=True)
class Diagnostic:
    """One thing wrong (or doubtful) in a profile or setup."""

    code: str
    message: str
    hint: str
    where: Location | None = None
    is_warning: bool = False

    def __str__(self) -> str:
        """Return all of it in one line."""
        place = f" in {self.where.file}, line {self.where.line}" if self.where else ""
        message = f": {self.message}" if self.message else ""
        return f"{self.code}{place}{message}" + (f"; help: {self.hint}" if self.hint else "")


class EdmWarning(UserWarning):
    """A warning about a job in Python: code, message and remedy."""


class EdmError(Exception):
    """Base of all expected errors."""

    exit_code: ClassVar[int] = 1
    default_code: ClassVar[str] = "E1000"

    def __init__(
        self, message: str, *, hint: str = "", code: str = "", where: Location | None = None
    ) -> None:
        super().__init__(message)
        self.code = code or self.default_code
        self.message = message
        self.hint = hint
        self.where = where
        # A traceback in Python shows code, place and remedy as well.
        self.add_note(str(Diagnostic(self.code, "", hint, where)))

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle class, message and all attributes."""
        return _again, (type(self), self.args, self.__dict__)


def _again(kind: type[EdmError], args: tuple[object, ...], held: dict[str, object]) -> EdmError:
    """Make an error that was made before, in another process or as a copy."""
    error = kind.__new__(kind, *args)
    error.__dict__.update(held)
    return error


class UsageError(EdmError):
    exit_code = 2


class ProfileError(EdmError):
    """All problems of a profile; `message` and `where` belong to the first error."""

    exit_code = 3

    def __init__(self, diagnostics: tuple[Diagnostic, ...]) -> None:
        first = next(d for d in diagnostics if not d.is_warning)
        super().__init__(first.message, hint=first.hint, code=first.code, where=first.where)
        self.diagnostics = diagnostics
        for other in diagnostics:
            if other is not first:
                self.add_note(str(other))


class RecordError(EdmError):
    """A record of voltage and displacement, a calibration file or a firmware image that cannot be used."""

    exit_code = 3


class LinkLost(EdmError):
    exit_code = 4


class ProtocolMismatch(EdmError):
    exit_code = 5


class MachineFault(EdmError):
    """The controller latched a fault: pulses are off and the tool is retracted. `detail` was reported with it."""

    exit_code = 6

    def __init__(self, message: str, *, hint: str = "", code: str = "", fault: int = 0) -> None:
        super().__init__(message, hint=hint, code=code)
        self.fault = fault
        self.detail = 0


class ObjectiveNotReached(EdmError):
    exit_code = 7


class PreconditionError(EdmError):
    exit_code = 8


class RunFileError(EdmError):
    exit_code = 9


class Interrupted(EdmError):
    """A signal ended the run in order; the exit code is 128 + the signal's number."""

    default_code = "E1300"

    def __init__(self, message: str, *, signal_number: int) -> None:
        super().__init__(message)
        self.signal_number = signal_number


def installing(*packages: str) -> str:
    """Return the command that puts packages where this program runs from, a checkout or an installation alike."""
    return f"`{shlex.quote(sys.executable or 'python3')} -m pip install {shlex.join(packages)}`"


def stages_by_hand(where: str = "the position that `edmctl doctor` shows") -> str:
    """Return how the stage position that a controller counts is made true; every hint about positions uses it.

    A controller counts steps and measures no position: after a power loss, a reset during motion or a move by hand
    it reports a position where the stages may not be.
    """
    return (
        "The controller counts the position of its stages and cannot measure it. Before anything moves, clear the "
        f"tool of the workpiece, switch the stage drives off, bring every stage by hand to {where}, and switch "
        "the drives on."
    )


class ExitCode(IntEnum):
    """What the exit code of `edmctl` says. Codes are only ever added."""

    DONE = 0
    INTERNAL = 1
    USAGE = 2
    PROFILE = 3
    LINK = 4
    PROTOCOL = 5
    FAULT = 6
    OBJECTIVE = 7
    PRECONDITION = 8
    RUN_FILE = 9
    HANGUP = 129
    INTERRUPT = 130
    TERMINATED = 143


MEANING = {
    ExitCode.DONE: "done",
    ExitCode.INTERNAL: "internal error",
    ExitCode.USAGE: "usage",
    ExitCode.PROFILE: "profile, setup or measured data invalid",
    ExitCode.LINK: "no port, or link lost",
    ExitCode.PROTOCOL: "protocol or firmware mismatch",
    ExitCode.FAULT: "machine fault (safe state reached)",
    ExitCode.OBJECTIVE: "objective not reached (depth, time, wear limit)",
    ExitCode.PRECONDITION: "precondition (not calibrated, interlock, no reference)",
    ExitCode.RUN_FILE: "run file or disk",
    ExitCode.HANGUP: "stopped by SIGHUP",
    ExitCode.INTERRUPT: "stopped by Ctrl-C (SIGINT)",
    ExitCode.TERMINATED: "stopped by SIGTERM",
}


def error_exit_code(error: EdmError) -> int:
    """Return 128 + the signal's number for a signal, else the error's own code."""
    if isinstance(error, Interrupted):
        return 128 + error.signal_number
    return error.exit_code


def exit_code_table() -> str:
    """Return one line per code."""
    return "\n".join(f"{code:>5}  {meaning}" for code, meaning in MEANING.items())
