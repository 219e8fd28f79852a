"""What a controller answers to questions, and how a host clears what another host or a fault has left behind."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict
from typing import Protocol, TypeVar

import numpy as np

from edmctl import failures
from edmctl.link.link_errors import CommandRefused
from edmctl.link.messages import (
    BlackboxRead,
    ClearFault,
    GetStatus,
    GetStatusReply,
    Status,
    Tlm,
    WaveformRead,
    WaveformReadReply,
)
from edmctl.link.session import Session
from edmctl.link.wire import Request
from edmctl.machine.decode import ToSeconds, telemetry_block, waveform_batch
from edmctl.machine.faults import (
    InterlockOpen,
    NothingLatched,
    fault_error,
    interlocks_in_words,
    reset_command,
)
from edmctl.machine.interface import (
    Interlock,
    MachineIdentity,
    MachineState,
    MachineStatus,
    TelemetryBlock,
    TelemetryFlag,
    WaveformBatch,
)
from edmctl.machine.plausibility import impossible, wrong_block, wrong_status

SIMULATED_BOARD = 0
"""Board number of the virtual controller."""
BLACK_BOX_PERIOD_US = 1000
"""Time between two samples of the black box."""
BLACK_BOX_SAMPLES, WAVEFORM_SAMPLES = 2048, 65536
"""The most that a controller keeps about a fault."""
SLOWEST_WAVEFORM_NS = 1000
WAVEFORM_PATIENCE_S = 1.0
"""The periods after a fault that waveforms go on for have passed by then."""
_LOOK_S = 0.01
PATIENCE_S = 5.0
"""A tool that retracts is back by then: 150 V at the slowest retraction in use take 2 s."""
_LOOK_AT_REST_S = 0.02
_HELD = (MachineState.FAULT, MachineState.ESTOP)


class _Page(Protocol):
    """A part of what a controller keeps: `n` of `total` samples."""

    @property
    def n(self) -> int: ...

    @property
    def total(self) -> int: ...


PageT = TypeVar("PageT", bound=_Page)
ReplyT = TypeVar("ReplyT")


def identity_of(session: Session) -> MachineIdentity:
    """Return who answered HELLO."""
    hello = session.hello
    return MachineIdentity(
        transport=session.transport.name,
        serial=hello.serial,
        firmware=f"{hello.fw_major}.{hello.fw_minor}.{hello.fw_patch}",
        protocol=f"{hello.proto_major}.{hello.proto_minor}",
        simulated=hello.board == SIMULATED_BOARD,
    )


def read_status(session: Session) -> MachineStatus:
    """Return what the controller sees now. Raises MachineFault where it says what cannot be."""
    reply = session.request(GetStatus())
    if problem := wrong_status(reply):
        raise impossible(f"GET_STATUS: {problem}")
    return _as_status(reply)


def read_unbelieved(session: Session) -> MachineStatus:
    """Return what the controller tells of a machine whose wires nobody has looked at yet, whatever it is.

    Raises MachineFault where its words have no meaning.
    """
    reply = session.request(GetStatus())
    try:
        return _as_status(reply)
    except ValueError as unknown:
        raise impossible(f"GET_STATUS: {unknown}") from unknown


def _as_status(reply: GetStatusReply) -> MachineStatus:
    words = {
        "state": MachineState(reply.state),
        "interlocks": Interlock(reply.interlocks),
        "flags": TelemetryFlag(reply.flags),
    }
    return MachineStatus(**{**asdict(reply), **words})


def read_black_box(session: Session, to_seconds: ToSeconds) -> TelemetryBlock | None:
    """Return every sample that the black box holds, oldest first; None where it holds none."""
    held = _pages(lambda offset: session.request(BlackboxRead(offset)), BLACK_BOX_SAMPLES, "BLACKBOX_READ")
    pages = [
        Tlm(counter, page.t0_us, BLACK_BOX_PERIOD_US, page.n, 0, page.records)
        for counter, page in enumerate(held)
    ]
    if not pages:
        return None
    block = telemetry_block(pages, to_seconds, 0)
    problem = wrong_block(block) or ("samples in disorder" if np.any(np.diff(block.time_s) <= 0.0) else "")
    if problem:
        raise impossible(f"BLACKBOX_READ: {problem}")
    return block


def _pages(ask: Callable[[int], PageT], most: int, name: str) -> Iterator[PageT]:
    """Ask for page after page until all have come. Raises MachineFault where they contradict each other."""
    offset, total = 0, -1
    while True:
        page = ask(offset)
        if page.n == 0 and page.total <= offset:
            return
        if page.n == 0 or not offset + page.n <= page.total <= most or total not in (-1, page.total):
            raise impossible(f"{name}: {page.n} of {page.total} samples from {offset} on")
        yield page
        offset, total = offset + page.n, page.total
        if offset == total:
            return


def read_waveforms(session: Session, to_seconds: ToSeconds) -> WaveformBatch | None:
    """Return every sample of the gap about the latched fault, oldest first; None where none are held."""

    def ask(offset: int) -> WaveformReadReply:
        return request_patiently(session, WaveformRead(offset), WAVEFORM_PATIENCE_S)

    pages = list(_pages(ask, WAVEFORM_SAMPLES, "WAVEFORM_READ"))
    if not pages:
        return None
    times = {(page.t0_us, page.period_ns) for page in pages}
    if len(times) > 1 or not 0 < pages[0].period_ns <= SLOWEST_WAVEFORM_NS:
        raise impossible(
            f"WAVEFORM_READ: samples {pages[0].period_ns} ns apart, from {len(times)} beginnings"
        )
    return waveform_batch(pages, to_seconds)


def request_patiently(session: Session, command: Request[ReplyT], patience_s: float) -> ReplyT:
    """Send a command, again while the controller is still busy. Raises CommandRefused."""
    end_s = session.machine_now_s() + patience_s
    while True:
        try:
            return session.request(command)
        except CommandRefused as refused:
            if refused.status is not Status.BUSY or session.machine_now_s() > end_s:
                raise
            session.pump(_LOOK_S)


def wait_for_rest(session: Session) -> None:
    """Wait until the tool is back at 0 V: a latched fault or a DISARM of another host may still be retracting it.

    The controller ended what that host left running when this session opened. A latched fault stays.
    """
    if not _is_back(session):
        raise failures.tool_not_back(patience_s=PATIENCE_S)


def clear_fault(session: Session, code: int, settings: Mapping[str, float]) -> None:
    """Clear the latched fault `code`; wait until the tool has retracted.

    Raises NothingLatched, UsageError E2030 if another fault is latched, InterlockOpen if its cause persists.
    """
    status = read_status(session)
    port = session.transport.name
    if status.state not in _HELD:
        raise NothingLatched(
            f"The controller at {port} holds no fault.", hint="There is nothing to clear; start the job."
        )
    if status.fault != code:
        latched = fault_error(status.fault, settings, port=port)
        raise failures.other_fault_latched(
            code=code,
            latched=status.fault,
            message=latched.message,
            command=reset_command(status.fault, port),
        )
    try:
        request_patiently(session, ClearFault(code), PATIENCE_S)
    except CommandRefused as refused:
        if refused.status is not Status.INTERLOCK:
            raise
        interlocks = read_status(session).interlocks
        raise InterlockOpen(
            f"Fault {code} cannot be cleared: {interlocks_in_words(interlocks)}.",
            hint=f"Put that right; then `{reset_command(code, port)}`.",
            interlocks=interlocks,
        ) from refused


def _is_back(session: Session) -> bool:
    end_s = session.machine_now_s() + PATIENCE_S
    while (status := read_status(session)).state is not MachineState.IDLE:
        if status.state in _HELD and status.actuator_v == 0.0:
            return True
        if session.machine_now_s() > end_s:
            return False
        session.pump(_LOOK_AT_REST_S)
    return True
