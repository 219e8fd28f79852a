"""What a controller can say: the values that its messages may hold, and what the samples of a touch must show.

Each check returns what cannot be, in words, and nothing where all can; `impossible` makes the error of it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from edmctl.array_types import Array
from edmctl.errors import EdmError
from edmctl.link.faults import FAULTS, FaultCode
from edmctl.link.messages import Event, Fault, GetStatusReply
from edmctl.machine.faults import host_fault
from edmctl.machine.interface import (
    EventCode,
    Interlock,
    MachineEvent,
    MachineState,
    PulseClass,
    TelemetryFlag,
    TouchRequest,
)
from edmctl.results.telemetry import PulseBlockBatch, PulseTrain, TelemetryBlock, joined

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

LEAST_SAMPLES = 3
"""Fewer samples of a dwell tell nothing of its mean."""
ALIKE_U_UM, ALIKE_SIGMAS = 0.1, 4.0
ALIKE_V = 0.1
LONGEST_GAP_S = 0.25
"""Voltages are compared where no frame is missing before the contact: three samples at the slowest rate."""
BEYOND_UM = 2.0
"""A tool may be so far beyond the greatest displacement of a touch before the controller's slow reading shows it."""

_STATES = frozenset(map(int, MachineState))
_LAST_STATE = max(_STATES)
_LAST_CLASS = max(map(int, PulseClass))
_CODES = frozenset(map(int, EventCode))
_FLAGS = sum(map(int, TelemetryFlag))
_INTERLOCKS = sum(map(int, Interlock))
_HOLDS_FAULT = (MachineState.FAULT, MachineState.ESTOP)
_TOUCHES = range(1, 256)


def impossible(what: str) -> EdmError:
    """Return the error of a controller that says what cannot be."""
    return host_fault("TELEMETRY_WRONG", f" ({what})")


def wrong_block(block: TelemetryBlock) -> str:
    """Return what in these samples cannot be."""
    state, flags = max(block.state.tobytes()), max(block.flags.tobytes())
    if state > _LAST_STATE or flags > _FLAGS:
        return f"samples with state {state} and flags {flags:#04x}"
    seen = block.summary
    if (farthest_um := max(seen.high_um, -seen.low_um)) > FARTHEST_UM:
        return f"samples at {farthest_um:.0f} µm"
    for unit, greatest, most in (
        ("V on the actuator", seen.actuator_high_v, GREATEST_V),
        ("V at the gap", seen.gap_high_v, GREATEST_GAP_V),
        ("A", seen.current_high_a, GREATEST_A),
    ):
        if greatest > most:
            return f"samples with {greatest:.0f} {unit}"
    return ""


def wrong_blocks(batch: PulseBlockBatch, block_pulses: int) -> str:
    """Judge sums over blocks of pulses."""
    counts = (batch.n_open, batch.n_normal, batch.n_arc, batch.n_short)
    most = int(sum(part.astype(np.int64) for part in counts).max())  # type: ignore[union-attr]
    return f"{most} pulses in a block of {block_pulses}" if most > block_pulses else ""


def wrong_pulses(batch: PulseTrain) -> str:
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


def contradicts_samples(told_um: float, seen_um: Array) -> bool:
    """Whether a touch and the samples of its dwell say different things.

    The displacement of a touch is the mean of the sensor over the dwell, millisecond by millisecond; the samples of
    that time are some of the same readings. With n of them, and their own scatter s (noise of the sensor and the
    hunting), the two means should differ by zero within the standard uncertainty √(s²/n + ALIKE_U_UM²): the ends of
    the dwell are not the same, and the scatter of a few samples is hardly known. Over 54 touches on the virtual
    machine they differed by 0.05 µm rms with 10 samples and 0.03 µm with 30, 0.10 µm at most. Beyond ALIKE_SIGMAS of
    it, 0.4 to 0.5 µm, is a contradiction; of good touches that are one in 16 000 at most. Both sides count: no chip
    does that. Fewer than LEAST_SAMPLES contradict nothing.
    """
    n = len(seen_um)
    if n < LEAST_SAMPLES:
        return False
    u_um = math.hypot(float(seen_um.std(ddof=1)) / math.sqrt(n), ALIKE_U_UM)
    return abs(told_um - float(seen_um.mean())) > ALIKE_SIGMAS * u_um


def wrong_touch(
    event: MachineEvent, number: int, request: TouchRequest, blocks: Sequence[TelemetryBlock]
) -> str:
    """Return what in a touch cannot be, in words; nothing where all can.

    `number` of the touches that `request` asked for is due; `blocks` hold the samples of the whole motion so far.

    The voltage at first contact lies beyond the last sample before it by no more than the feed goes from one sample
    to the next; 0.1 V more are allowed, 0.003 V were seen. One sample of the dwell at least must show contact.
    """
    if event.argument != number or number > request.touches:
        return f"touch {event.argument} of {request.touches} where {number} is due"
    told_um = event.displacement_um
    if told_um > request.z_max_um + BEYOND_UM:
        return f"a touch at {told_um:.1f} µm, {request.z_max_um:.1f} µm was the limit"
    if not blocks:
        return ""
    samples = joined(blocks)
    first = int(np.searchsorted(samples.time_s, event.time_s))
    dwell = slice(first, int(np.searchsorted(samples.time_s, event.time_s + request.dwell_s, side="right")))
    seen_um = samples.displacement_um[dwell]
    if len(seen_um) < LEAST_SAMPLES:
        return ""
    # The event may come before the last samples of the dwell, in which contact opens and closes.
    sample_s = float(samples.time_s[-1] - samples.time_s[-2])
    is_whole = float(samples.time_s[-1]) + sample_s >= event.time_s + request.dwell_s
    if is_whole and not np.any(samples.flags[dwell] & TelemetryFlag.CONTACT):
        return f"a touch at {told_um:.2f} µm, and no sample in contact"
    if contradicts_samples(told_um, seen_um):
        return f"a touch at {told_um:.2f} µm, the samples of it at {float(seen_um.mean()):.2f} µm"
    before_v = samples.actuator_v[max(first - 3, 0) : first]
    if len(before_v) == 3 and np.ptp(samples.time_s[first - 3 : first + 1]) < LONGEST_GAP_S:
        apart_v = abs(event.actuator_v - float(before_v[-1]))
        if apart_v > ALIKE_V + float(np.abs(np.diff(before_v)).max()):
            return f"a touch at {event.actuator_v:.2f} V, the sample before it at {float(before_v[-1]):.2f} V"
    return ""
