"""What a controller can say: the values that its messages may hold, whoever wrote its firmware.

Each check returns what cannot be, in words, and nothing where all can; `impossible` makes the error of it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from edmctl.link.faults import FAULTS, FaultCode
from edmctl.machine.faults import host_fault
from edmctl.machine.states import EventCode, Interlock, MachineState, PulseClass, TelemetryFlag

if TYPE_CHECKING:
    from edmctl.errors import EdmError
    from edmctl.link.messages import Event, Fault, GetStatusReply
    from edmctl.machine.reports import PulseBatch, PulseBlockBatch, TelemetryBlock

FARTHEST_UM = 2000.0
"""Four times the stroke of the actuator: no displacement sensor reads beyond, not after hours of drift either."""
GREATEST_V = 160.0
"""The actuator gets 150 V at most, and its applied voltage is read within some volts."""
GREATEST_GAP_V = 300.0
"""Open voltages go to 120 V; a reading of more than twice that is none."""
GREATEST_A = 30.0
"""Peak currents go to 3 A, a dead short draws twice that, a broken limit of the generator three times."""
GREATEST_MONITOR_V = 250.0
COLDEST_C, HOTTEST_C = -40.0, 200.0
GREATEST_FLOW_LPM = 200.0

_STATES = frozenset(map(int, MachineState))
_LAST_STATE = max(_STATES)
_LAST_CLASS = max(map(int, PulseClass))
_CODES = frozenset(map(int, EventCode))
_FLAGS = sum(map(int, TelemetryFlag))
_INTERLOCKS = sum(map(int, Interlock))
_HOLDS_FAULT = (MachineState.FAULT, MachineState.ESTOP)
_TOUCHES = range(1, 256)


def impossible(told: str) -> EdmError:
    """The error of a controller that says what cannot be."""
    return host_fault("TELEMETRY_WRONG", f" ({told})")


def wrong_block(block: TelemetryBlock) -> str:
    """Judge samples. Lists of some ten numbers have their extremes sooner than arrays."""
    state, flags = max(block.state.tobytes()), max(block.flags.tobytes())
    if state > _LAST_STATE or flags > _FLAGS:
        return f"samples with state {state} and flags {flags:#04x}"
    heights_um = block.displacement_um.tolist()
    farthest_um = max(max(heights_um), -min(heights_um))
    if farthest_um > FARTHEST_UM:
        return f"samples at {farthest_um:.0f} µm"
    for unit, values, most in (
        ("V on the actuator", block.actuator_v, GREATEST_V),
        ("V at the gap", block.gap_v, GREATEST_GAP_V),
        ("A", block.current_a, GREATEST_A),
    ):
        greatest = max(values.tolist())
        if greatest > most:
            return f"samples with {greatest:.0f} {unit}"
    return ""


def wrong_blocks(batch: PulseBlockBatch, block_pulses: int) -> str:
    """Judge sums over blocks of pulses."""
    counts = (batch.n_open, batch.n_normal, batch.n_arc, batch.n_short)
    most = int(sum(part.astype(np.int64) for part in counts).max())  # type: ignore[union-attr]
    return f"{most} pulses in a block of {block_pulses}" if most > block_pulses else ""


def wrong_pulses(batch: PulseBatch) -> str:
    """Judge single pulses."""
    last = int(batch.pulse_class.max())
    return f"pulses of class {last}" if last > _LAST_CLASS else ""


def wrong_event(event: Event) -> str:
    """Judge an event, but for its time."""
    if event.code not in _CODES:
        return f"EVENT with code {event.code}"
    name = f"EVENT {EventCode(event.code).name}"
    if event.code == EventCode.TOUCH and event.arg not in _TOUCHES:
        return f"{name} number {event.arg}"
    if event.code == EventCode.TEST_DONE and not 0 <= event.arg <= 1000.0 * GREATEST_GAP_V:
        return f"{name} with {event.arg} mV"
    if abs(event.displacement_um) > FARTHEST_UM:
        return f"{name} at {event.displacement_um:.0f} µm"
    return f"{name} at {event.actuator_v:.0f} V" if event.actuator_v > GREATEST_V else ""


def wrong_fault(fault: Fault) -> str:
    """Judge the report of a fault. Codes that this version does not know may be those of a newer firmware."""
    row = FAULTS.get(fault.code)
    known_as_host_s = row is not None and row.who == "host"
    return (
        f"FAULT with code {fault.code}"
        if known_as_host_s or not 0 < fault.code < FaultCode.Z_MISMATCH
        else ""
    )


def wrong_status(reply: GetStatusReply) -> str:
    """Judge a status."""
    if reply.state not in _STATES:
        return f"state {reply.state}"
    if reply.interlocks & ~_INTERLOCKS:
        return f"interlocks {reply.interlocks:#06x}"
    if reply.flags & ~_FLAGS:
        return f"flags {reply.flags:#04x}"
    holds = reply.state in _HOLDS_FAULT
    if holds != bool(reply.fault) and reply.state != MachineState.BOOT:
        return f"state {MachineState(reply.state).name} with fault {reply.fault}"
    limits = (
        ("µm", reply.displacement_um, -FARTHEST_UM, FARTHEST_UM),
        ("V on the actuator", reply.actuator_v, 0.0, GREATEST_V),
        ("V at the gap", reply.gap_v, 0.0, GREATEST_GAP_V),
        ("°C", reply.temperature_c, COLDEST_C, HOTTEST_C),
        ("L/min", reply.flow_lpm, 0.0, GREATEST_FLOW_LPM),
        ("V at the monitor", reply.monitor_v, -GREATEST_MONITOR_V, GREATEST_MONITOR_V),
    )
    for unit, value, low, high in limits:
        if not low <= value <= high:
            return f"a status with {value:.0f} {unit}"
    return ""
