"""What a controller answers to questions: who it is, what it sees, what its black box holds."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.link.messages import BlackboxRead, BlackboxReadReply, GetStatus, Tlm
from edmctl.machine.decode import telemetry_block
from edmctl.machine.reports import MachineIdentity, MachineStatus, TelemetryBlock
from edmctl.machine.states import Interlock, MachineState, TelemetryFlag

if TYPE_CHECKING:
    from edmctl.link.session import Session
    from edmctl.machine.decode import ToSeconds

SIMULATED_BOARD = 0
"""Board number of the virtual controller."""
BLACK_BOX_PERIOD_US = 1000
"""Time between two samples of the black box."""


def identity_of(session: Session) -> MachineIdentity:
    """Who answered HELLO."""
    hello = session.hello
    return MachineIdentity(
        transport=session.transport.name,
        serial=hello.serial,
        firmware=f"{hello.fw_major}.{hello.fw_minor}.{hello.fw_patch}",
        protocol=f"{hello.proto_major}.{hello.proto_minor}",
        simulated=hello.board == SIMULATED_BOARD,
    )


def read_status(session: Session) -> MachineStatus:
    """What the controller sees now."""
    reply = session.request(GetStatus())
    return MachineStatus(
        state=MachineState(reply.state),
        fault=reply.fault,
        interlocks=Interlock(reply.interlocks),
        displacement_um=reply.displacement_um,
        x_um=reply.x_um,
        y_um=reply.y_um,
        theta_deg=reply.theta_deg,
        actuator_v=reply.actuator_v,
        gap_v=reply.gap_v,
        temperature_c=reply.temperature_c,
        flow_lpm=reply.flow_lpm,
        monitor_v=reply.monitor_v,
        flags=TelemetryFlag(reply.flags),
    )


def read_black_box(session: Session, to_seconds: ToSeconds) -> TelemetryBlock | None:
    """Every sample that the black box holds, oldest first; None where it holds none."""
    pages: list[Tlm] = []
    offset = 0
    while True:
        page = session.request(BlackboxRead(offset))
        if page.n == 0:
            break
        pages.append(_as_telemetry(page, len(pages)))
        offset += page.n
        if offset >= page.total:
            break
    return telemetry_block(pages, to_seconds, 0) if pages else None


def _as_telemetry(page: BlackboxReadReply, counter: int) -> Tlm:
    """A page as a frame of telemetry, whose samples it has."""
    return Tlm(
        counter=counter,
        t0_us=page.t0_us,
        period_us=BLACK_BOX_PERIOD_US,
        n=page.n,
        dropped=0,
        records=page.records,
    )
