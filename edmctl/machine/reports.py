"""What a machine tells, in µm, V, A and s.

Displacements are those of the inductive sensor on the actuator, positive towards the work and zero near 0 V.
Times are seconds since the first message of the run, on the controller's clock.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from collections.abc import Sequence

    from edmctl.machine.states import EventCode, Interlock, MachineState, TelemetryFlag

__all__ = [
    "Bytes",
    "Floats",
    "MachineEvent",
    "MachineIdentity",
    "MachineStatus",
    "PulseBatch",
    "PulseBlockBatch",
    "TelemetryBlock",
    "Touch",
    "WaveformBatch",
    "joined",
]

Floats: TypeAlias = NDArray[np.float64]
Bytes: TypeAlias = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class MachineIdentity:
    """Who answered: board serial, firmware version, and whether it is the virtual machine."""

    transport: str
    serial: str
    firmware: str
    protocol: str
    simulated: bool


@dataclass(frozen=True, slots=True)
class TelemetryBlock:
    """Consecutive servo samples in columns, each of shape (n,).

    `gap_v` is the filtered mean gap voltage, `current_a` the mean gap current; `n_*` count the pulses of each
    class since the sample before. `missing_frames` frames were lost on the line before this block.
    """

    time_s: Floats
    displacement_um: Floats
    actuator_v: Floats
    gap_v: Floats
    current_a: Floats
    n_open: Bytes
    n_normal: Bytes
    n_arc: Bytes
    n_short: Bytes
    state: Bytes
    flags: Bytes
    missing_frames: int


def joined(blocks: Sequence[TelemetryBlock]) -> TelemetryBlock:
    """One block of consecutive ones."""
    if len(blocks) == 1:
        return blocks[0]
    return TelemetryBlock(
        time_s=np.concatenate([b.time_s for b in blocks]),
        displacement_um=np.concatenate([b.displacement_um for b in blocks]),
        actuator_v=np.concatenate([b.actuator_v for b in blocks]),
        gap_v=np.concatenate([b.gap_v for b in blocks]),
        current_a=np.concatenate([b.current_a for b in blocks]),
        n_open=np.concatenate([b.n_open for b in blocks]),
        n_normal=np.concatenate([b.n_normal for b in blocks]),
        n_arc=np.concatenate([b.n_arc for b in blocks]),
        n_short=np.concatenate([b.n_short for b in blocks]),
        state=np.concatenate([b.state for b in blocks]),
        flags=np.concatenate([b.flags for b in blocks]),
        missing_frames=sum(b.missing_frames for b in blocks),
    )


@dataclass(frozen=True, slots=True)
class PulseBlockBatch:
    """Sums over consecutive blocks of pulses, columns of shape (n,): ignition delays in µs, energies in µJ."""

    time_s: Floats
    n_open: Bytes
    n_normal: Bytes
    n_arc: Bytes
    n_short: Bytes
    delay_us: Floats
    energy_uj: Floats


@dataclass(frozen=True, slots=True)
class PulseBatch:
    """Consecutive pulses of one period, in columns of shape (n,). `pulse_class` holds `PulseClass` values."""

    first_pulse: int
    start_s: float
    period_s: float
    pulse_class: Bytes
    delay_us: Floats
    discharge_us: Floats
    plateau_v: Floats


@dataclass(frozen=True, slots=True)
class WaveformBatch:
    """The gap about a latched fault, sample by sample at equal distances, columns of shape (n,)."""

    time_s: Floats
    gap_v: Floats
    current_a: Floats


@dataclass(frozen=True, slots=True)
class MachineEvent:
    """Something the controller reported: what, when, and where the tool was."""

    code: EventCode
    time_s: float
    argument: int
    displacement_um: float
    actuator_v: float


@dataclass(frozen=True, slots=True)
class Touch:
    """One contact at `time_s`: actuator voltage then, and mean sensor displacement while hunting after it."""

    time_s: float
    displacement_um: float
    actuator_v: float


@dataclass(frozen=True, slots=True)
class MachineStatus:
    """What the controller sees now.

    `actuator_v` is what was commanded, `monitor_v` what the amplifier's voltage monitor shows of it.
    """

    state: MachineState
    fault: int
    interlocks: Interlock
    displacement_um: float
    x_um: float
    y_um: float
    theta_deg: float
    actuator_v: float
    gap_v: float
    temperature_c: float
    flow_lpm: float
    monitor_v: float
    flags: TelemetryFlag
