"""Errors of a line or controller that does not answer, and of one that refuses: replies other than OK."""

from __future__ import annotations

import struct
from dataclasses import fields

from edmctl import failures
from edmctl.errors import LinkLost, PreconditionError
from edmctl.link.faults import FAULTS, FaultCode
from edmctl.link.frame import Frame
from edmctl.link.messages import REQUESTS, Boot, Hello, Interlocks, PathMove, ResetCause, StageMove, Status
from edmctl.link.statistics import Statistics
from edmctl.link.wire import Request

_CAUSES: dict[int, str] = {
    ResetCause.POWER_ON: "its supply failed and came back",
    ResetCause.COMMANDED: "somebody restarted it",
    ResetCause.WATCHDOG: "its own watchdog found it hanging",
    ResetCause.BROWN_OUT: "its supply dipped",
    ResetCause.EXTERNAL: "its reset line was pulled",
}


def unanswered(name: str, message: Request[object], waited_s: float, counts: Statistics) -> LinkLost:
    """Return the error of a command that was repeated in vain; without HELLO there may be no controller at all."""
    if message.ID != Hello.ID:
        return failures.no_reply(name=name, command=message.NAME, waited_s=1000 * waited_s)
    if counts.bytes_received:
        return failures.not_a_controller(name=name, bytes_received=counts.bytes_received)
    return failures.no_answer_to_hello(name=name, waited_s=waited_s)


def restarted(name: str, boot: Boot) -> LinkLost:
    """Return the error of a controller that restarted in mid-session."""
    cause = _CAUSES.get(boot.reset_cause, f"reset cause {boot.reset_cause}")
    hint = FAULTS[FaultCode.POWER_LOSS].hint
    if boot.reset_cause in (ResetCause.WATCHDOG, ResetCause.BROWN_OUT):
        # After these the controller stays latched.
        row = FAULTS[FaultCode.RESET]
        hint = f"{row.hint} Then `edmctl reset --ack {row.code} --port {name}`."
    return failures.controller_restarted(name=name, cause=cause, boot_count=boot.boot_count, hint=hint)


_RANGE = struct.Struct("<Bqq")
_SPEED = 2  # field of STAGE_MOVE and PATH_MOVE
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


_TOO_FAST = {
    StageMove.ID: "Lower stage.speed_um_s, for the rotary axis stage.rotary_deg_s, in the setup file.",
    PathMove.ID: "Lower path.speed_um_s in the profile.",
}
"""Of OUT_OF_RANGE: of what a host sends, only a speed can be."""
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
        message = f"{message[:-1]} (the tool is not retracted by the controller's own reading)."
        return CommandRefused(message, status=status, hint=_NOT_RETRACTED)
    if command_id in _TOO_FAST and status is Status.OUT_OF_RANGE:
        return CommandRefused(message, status=status, hint=_TOO_FAST[command_id])
    hint = _HINTS.get(status, "This is a fault of the controller's firmware; note what led to it.")
    return CommandRefused(message, status=status, hint=hint)


def _detail(status: Status, command_id: int, payload: bytes) -> str:
    if status is Status.OUT_OF_RANGE and len(payload) == _RANGE.size:
        index, low, high = _RANGE.unpack(payload)
        if command_id in _TOO_FAST and index == _SPEED:
            unit = "µm/s" if command_id == PathMove.ID else "µm/s, turning degrees/s"
            return f"the stages of this machine do at most {high / 1000.0:g} {unit}"
        names = [f.name for f in fields(REQUESTS[command_id])]
        return f"{names[index] if index < len(names) else f'field {index}'}: {low}..{high} counts"
    if status is Status.INTERLOCK and len(payload) == _BITS.size:
        bits = Interlocks(_BITS.unpack(payload)[0])
        return ", ".join(bit.name or "" for bit in Interlocks if bit in bits)
    return ""
