"""Faults as errors that people can act on: those that the controller latched, and those that the host finds itself.

PreconditionError
├── FaultLatched          E8010    the controller still holds a fault of an earlier run
├── InterlockOpen         E8012    an interlock keeps a fault from being cleared
└── NothingLatched        E8013    there is no fault to clear
"""

from __future__ import annotations

from collections.abc import Mapping

from edmctl.errors import (
    EdmError,
    LinkLost,
    MachineFault,
    ObjectiveNotReached,
    PreconditionError,
    RunFileError,
)
from edmctl.link.faults import FAULTS, FaultCode, FaultRow
from edmctl.link.messages import Interlocks as Interlock

_NO_PORT = "sim:"
_ERRORS: dict[int, type[EdmError]] = {
    LinkLost.exit_code: LinkLost,
    ObjectiveNotReached.exit_code: ObjectiveNotReached,
    RunFileError.exit_code: RunFileError,
}
INTERLOCKS = {
    Interlock.ESTOP: ("emergency stop", "the emergency stop is pressed", "Release the button."),
    Interlock.DOOR: ("door", "the door is open", "Close the door."),
    Interlock.DIELECTRIC_LEVEL: ("level", "the dielectric is low", "Fill up the dielectric."),
    Interlock.DIELECTRIC_FLOW: (
        "flow",
        "the dielectric does not flow",
        "Start the pump; look at its filter.",
    ),
    Interlock.DIELECTRIC_HOT: ("temperature", "the dielectric is too hot", "Let the dielectric cool down."),
    Interlock.HV_SUPPLY: (
        "high voltage",
        "the high-voltage supply is off",
        "Switch the supply on, and look at its own display and fuse.",
    ),
}
"""Of each interlock its name, what is so when it is open, and what to do."""


class FaultLatched(PreconditionError):
    """The controller still holds `fault`."""

    default_code = "E8010"

    def __init__(self, message: str, *, hint: str, fault: int) -> None:
        super().__init__(message, hint=hint)
        self.fault = fault


class InterlockOpen(PreconditionError):
    """An interlock is open; `interlocks` says which."""

    default_code = "E8012"

    def __init__(self, message: str, *, hint: str, interlocks: Interlock) -> None:
        super().__init__(message, hint=hint)
        self.interlocks = interlocks


class NothingLatched(PreconditionError):
    """The controller holds no fault."""

    default_code = "E8013"


def fault_error(code: int, settings: Mapping[str, float], where: str = "", port: str = _NO_PORT) -> EdmError:
    """Return the error for a latched fault, a MachineFault but where the row's exit code is another.

    `settings` are the controller's parameters, for the figures in the message; `where` says when and where it
    happened and is appended. `port` is where the fault can be cleared.
    """
    row = FAULTS.get(code)
    if row is None:
        message = f"The controller latched fault {code}, which this version does not know."
        hint = "Update edmctl, or look the number up in the firmware."
        return MachineFault(
            f"{message}{where}", hint=_then_reset(hint, code, port), code=f"E6{code}", fault=code
        )
    hint = _then_reset(row.hint, code, port) if row.latched else row.hint
    return _error_of(row, f"{row.message.format_map(settings)}{where}", hint)


def latched_error(code: int, settings: Mapping[str, float], port: str) -> FaultLatched:
    """Return the error of a machine that cannot start because it still holds a fault."""
    found = fault_error(code, settings, port=port)
    return FaultLatched(
        f"The controller still holds fault {code}: {found.message}", hint=found.hint, fault=code
    )


def host_fault(name: str, where: str = "", **numbers: float) -> EdmError:
    """Return the error for a fault that the host found: the row's own text, exit code and error code.

    `where` is appended to the message, `numbers` fill its figures. Nothing is latched then. KeyError where no row
    has that name.
    """
    row = FAULTS[FaultCode[name]]
    return _error_of(row, f"{row.message.format_map(numbers)}{where}", row.hint)


def reset_command(code: int, port: str) -> str:
    """Return the command that clears a fault on the machine at `port`."""
    place = "" if port == _NO_PORT else f" --port {port}"
    return f"edmctl reset --ack {code}{place}"


def interlocks_in_words(interlocks: Interlock) -> str:
    """Return what the open interlocks are, for people; empty where all are closed."""
    return ", ".join(words for bit, (_, words, _) in INTERLOCKS.items() if bit in interlocks)


def _error_of(row: FaultRow, message: str, hint: str) -> EdmError:
    kind = _ERRORS.get(row.exit_code)
    if kind is None:
        return MachineFault(message, hint=hint, code=row.error, fault=row.code)
    return kind(message, hint=hint, code=row.error)


def _then_reset(hint: str, code: int, port: str) -> str:
    return f"{hint.removesuffix('.')}; then `{reset_command(code, port)}`."
