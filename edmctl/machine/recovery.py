"""What a host does with a controller that another host, or a fault, has left behind."""

from __future__ import annotations

from collections.abc import Mapping

from edmctl.errors import MachineFault
from edmctl.link.link_errors import CommandRefused
from edmctl.link.messages import ClearFault, Status
from edmctl.link.session import Session
from edmctl.machine.faults import (
    InterlockOpen,
    NothingLatched,
    WrongFault,
    fault_error,
    interlocks_in_words,
    reset_command,
)
from edmctl.machine.queries import read_status, request_patiently
from edmctl.machine.states import MachineState

PATIENCE_S = 5.0
"""A tool that retracts is back by then: 150 V at the slowest retraction in use take 2 s."""
_LOOK_S = 0.02
_HELD = (MachineState.FAULT, MachineState.ESTOP)


def wait_for_rest(session: Session) -> None:
    """Wait until the tool is back at 0 V: a latched fault or a DISARM of another host may still be retracting it.

    The controller ended what that host left running when this session opened. A latched fault stays.
    """
    if not _is_back(session):
        raise MachineFault(
            f"The controller did not bring the tool back within {PATIENCE_S:.0f} s.",
            hint="Switch the amplifier off, and look at the controller before the next run.",
            code="E6002",
        )


def clear_fault(session: Session, code: int, settings: Mapping[str, float]) -> None:
    """Clear the latched fault `code`; patient until the tool has retracted.

    Raises
    ------
    NothingLatched
        There is no fault.
    WrongFault
        Another fault is latched; the error tells which.
    InterlockOpen
        The reason is still there; the error tells what.
    """
    status = read_status(session)
    port = session.transport.name
    if status.state not in _HELD:
        raise NothingLatched(
            f"The controller at {port} holds no fault.", hint="There is nothing to clear; start the job."
        )
    if status.fault != code:
        latched = fault_error(status.fault, settings, port=port)
        raise WrongFault(
            f"Not fault {code} is latched but {status.fault}: {latched.message}",
            hint=f"When its reason is gone: `{reset_command(status.fault, port)}`.",
            fault=status.fault,
        )
    try:
        request_patiently(session, ClearFault(code), PATIENCE_S)
    except CommandRefused as refused:
        if refused.status is not Status.INTERLOCK:
            raise
        raise _interlock_open(session, code) from refused


def _interlock_open(session: Session, code: int) -> InterlockOpen:
    interlocks = read_status(session).interlocks
    return InterlockOpen(
        f"Fault {code} cannot be cleared: {interlocks_in_words(interlocks)}.",
        hint=f"Put that right; then `{reset_command(code, session.transport.name)}`.",
        interlocks=interlocks,
    )


def _is_back(session: Session) -> bool:
    end_s = session.machine_now_s() + PATIENCE_S
    while (status := read_status(session)).state is not MachineState.IDLE:
        if status.state in _HELD and status.actuator_v == 0.0:
            return True
        if session.machine_now_s() > end_s:
            return False
        session.pump(_LOOK_S)
    return True
