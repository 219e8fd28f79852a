"""What a reply with a status other than OK means to the person at the machine."""

from __future__ import annotations

import struct
from dataclasses import fields
from typing import TYPE_CHECKING

from edmctl.errors import PreconditionError
from edmctl.link.messages import REQUESTS, Interlocks, StageMove, Status

if TYPE_CHECKING:
    from edmctl.link.frame import Frame

_RANGE = struct.Struct("<Bqq")
_BITS = struct.Struct("<H")
_HINTS = {
    Status.BUSY: "Wait until the present motion ends, or stop it first.",
    Status.BAD_STATE: "Start the run again; a fault that the controller has latched must be cleared first.",
    Status.UNKNOWN_TYPE: "The controller's firmware lacks this command; update it.",
    Status.BAD_LENGTH: "Host and firmware disagree about this command; update the older of them.",
    Status.OUT_OF_RANGE: "Correct the value in the profile or the setup file.",
    Status.NOT_CALIBRATED: "The controller holds no calibration, and this version cannot make one.",
    Status.INTERLOCK: "Release the emergency stop, close the door, check level, flow and temperature.",
    Status.PROFILE_MISMATCH: "The controller holds other parameters than this run; start the run again.",
    Status.RATE_TOO_HIGH: "Ask for slower telemetry, or use a faster line.",
    Status.BAD_SESSION: "Another program talks to this controller; close it.",
    Status.NO_CONTACT: "Check the tool, the continuity wire and the site.",
}


_NOT_RETRACTED = (
    "Check the zero of the displacement sensor, its drift, and the actuator's supply with `edmctl doctor`."
)


class CommandRefused(PreconditionError):
    """The controller answered a command with a status other than OK; nothing was executed."""

    default_code = "E8100"

    def __init__(self, message: str, *, status: Status, hint: str = "") -> None:
        super().__init__(message, hint=hint)
        self.status = status


def nak_error(command_id: int, reply: Frame) -> CommandRefused:
    """Return the error that a refused command raises, with what the reply tells of the reason."""
    try:
        status = Status(reply.flags)
    except ValueError:
        status = Status.INTERNAL
    request = REQUESTS[command_id]
    detail = _detail(status, command_id, reply.payload)
    message = f"The controller refused {request.NAME}: {status.name}{f' ({detail})' if detail else ''}."
    if command_id == StageMove.ID and status is Status.INTERLOCK and not detail:
        detail, hint = "the tool is not retracted by the controller's own reading", _NOT_RETRACTED
        message = f"The controller refused {request.NAME}: {status.name} ({detail})."
        return CommandRefused(message, status=status, hint=hint)
    hint = _HINTS.get(status, "This is a fault of the controller's firmware; note what led to it.")
    return CommandRefused(message, status=status, hint=hint)


def _detail(status: Status, command_id: int, payload: bytes) -> str:
    if status is Status.OUT_OF_RANGE and len(payload) == _RANGE.size:
        index, low, high = _RANGE.unpack(payload)
        names = [f.name for f in fields(REQUESTS[command_id])]
        return f"{names[index] if index < len(names) else f'field {index}'}: {low}..{high} counts"
    if status is Status.INTERLOCK and len(payload) == _BITS.size:
        bits = Interlocks(_BITS.unpack(payload)[0])
        return ", ".join(bit.name or "" for bit in Interlocks if bit in bits)
    return ""
