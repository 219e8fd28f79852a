"""Why a session ended: the errors of a line or a controller that does not answer."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.errors import LinkLost
from edmctl.link.faults import FAULTS, FaultCode
from edmctl.link.messages import Hello, ResetCause

if TYPE_CHECKING:
    from edmctl.link.messages import Boot
    from edmctl.link.statistics import Statistics
    from edmctl.link.wire import Request

_CAUSES: dict[int, str] = {
    ResetCause.POWER_ON: "its supply failed and came back",
    ResetCause.COMMANDED: "somebody restarted it",
    ResetCause.WATCHDOG: "its own watchdog found it hanging",
    ResetCause.BROWN_OUT: "its supply dipped",
    ResetCause.EXTERNAL: "its reset line was pulled",
}


def no_answer(name: str, command: str, waited_s: float) -> LinkLost:
    """Return the error of a command that was repeated in vain."""
    return LinkLost(
        f"The controller at {name} did not answer {command} within {1000 * waited_s:.0f} ms.",
        hint="Check that the controller is on and that the cable and the port are the right ones.",
        code="E4010",
    )


def unanswered(name: str, message: Request[object], waited_s: float, counts: Statistics) -> LinkLost:
    """Return the error of a command that was repeated in vain; HELLO tells whether there is a controller at all."""
    if message.ID == Hello.ID:
        return _no_controller(name, waited_s, counts.bytes_received)
    return no_answer(name, message.NAME, waited_s)


def _no_controller(name: str, waited_s: float, bytes_received: int) -> LinkLost:
    if bytes_received:
        return LinkLost(
            f"What is at {name} is no controller of this kind: {bytes_received} bytes came, and no answer to HELLO.",
            hint="Name the controller's port (`edmctl ports` lists them), and check link.baud in the setup.",
            code="E4011",
        )
    return LinkLost(
        f"No controller answered at {name} within {waited_s:.1f} s.",
        hint="Check that the controller is on and that this is its port (`edmctl ports` lists them).",
        code="E4011",
    )


def fell_silent(name: str, silence_s: float) -> LinkLost:
    """Return the error of a controller that stopped answering in mid-session."""
    return LinkLost(
        f"The controller at {name} fell silent for {1000 * silence_s:.0f} ms.",
        hint="Check cable and supply; the controller switches the pulses off by itself when it hears nothing.",
        code="E4012",
    )


def other_host(name: str) -> LinkLost:
    """Return the error of an answer to somebody else's HELLO."""
    return LinkLost(
        f"The answer to HELLO from {name} was meant for another host.",
        hint="Close the other program.",
        code="E4013",
    )


def taken_over(name: str) -> LinkLost:
    """Return the error of a controller that has become another host's in mid-session."""
    return LinkLost(
        f"Another host has opened a session with the controller at {name}.",
        hint="Close the other program; the controller has made the machine safe by itself.",
        code="E4013",
    )


def restarted(name: str, boot: Boot) -> LinkLost:
    """Return the error of a controller that restarted in mid-session."""
    cause = _CAUSES.get(boot.reset_cause, f"reset cause {boot.reset_cause}")
    hint = FAULTS[FaultCode.POWER_LOSS].hint
    if boot.reset_cause in (ResetCause.WATCHDOG, ResetCause.BROWN_OUT):
        # After these the controller stays latched.
        row = FAULTS[FaultCode.RESET]
        hint = f"{row.hint.removesuffix('.')}; then `edmctl reset --ack {row.code} --port {name}`."
    return LinkLost(
        f"The controller at {name} restarted: {cause} (boot {boot.boot_count}).",
        hint=f"{hint} Pulses are off and the tool is back; measure again before machining.",
        code="E4005",
    )
