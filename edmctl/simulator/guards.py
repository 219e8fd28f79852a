"""What the virtual controller watches beside the motions: inputs, the line's noise, its monitors' verdicts."""

from __future__ import annotations

from collections import deque

from edmctl.link.faults import FaultCode
from edmctl.link.messages import Interlocks
from edmctl.simulator import controller_state as c
from edmctl.simulator.parameters import Parameters
from edmctl.simulator.plant import Plant

NOISE_TICKS = 1000
FLOW_MOST_LPM, COLDEST_C = 1000.0, -100.0  # beyond these a reading has failed

KERNEL_FAULTS = {
    c.FAULT_TRAVEL: FaultCode.TRAVEL_LIMIT,
    c.FAULT_NO_CONTACT: FaultCode.NO_CONTACT,
    c.FAULT_STUCK_CONTACT: FaultCode.STUCK_CONTACT,
    c.FAULT_COLLISION: FaultCode.COLLISION,
    c.FAULT_SHORT: FaultCode.SHORT_STUCK,
    c.FAULT_ARC: FaultCode.ARC_BURN,
    c.FAULT_NO_SPARK: FaultCode.NO_SPARK,
    c.FAULT_TRACK: FaultCode.PIEZO_TRACK,
    c.FAULT_MONITOR: FaultCode.PIEZO_OV,
    c.FAULT_GAP_SENSOR: FaultCode.GAP_SENSOR,
    c.FAULT_GENERATOR: FaultCode.GEN_FAULT,
    c.FAULT_MODE_SWITCH: FaultCode.MODE_SWITCH,
}
"""The fault for what the kernel found."""

_BY_INPUT = (
    (Interlocks.ESTOP, FaultCode.ESTOP),
    (Interlocks.DOOR, FaultCode.DOOR),
    (Interlocks.HV_SUPPLY, FaultCode.HV_SUPPLY),
)


class Guards:
    """Reads the inputs of one machine and judges them by its parameters."""

    def __init__(self, plant: Plant, parameters: Parameters) -> None:
        self._plant, self._parameters = plant, parameters
        self._bad_frames: deque[int] = deque()
        self._bad_seen = 0

    def open_interlocks(self) -> int:
        """Interlocks bits of the inputs that forbid machining now. What is no number forbids it."""
        inputs, parameters = self._plant.inputs(), self._parameters
        bits = 0
        if inputs.estop:
            bits |= Interlocks.ESTOP
        if inputs.door_open:
            bits |= Interlocks.DOOR
        if not inputs.hv_supply_ok:
            bits |= Interlocks.HV_SUPPLY
        if parameters.dielectric_required:
            if not inputs.level_ok:
                bits |= Interlocks.DIELECTRIC_LEVEL
            if not parameters.flow_min_lpm <= inputs.flow_lpm <= FLOW_MOST_LPM:
                bits |= Interlocks.DIELECTRIC_FLOW
            if not COLDEST_C <= inputs.temperature_c <= parameters.temperature_max_c:
                bits |= Interlocks.DIELECTRIC_HOT
        return int(bits)

    def restart(self) -> None:
        """Forget, as a reset does, what the line has brought: `rx_bad` counts from 0."""
        self._bad_frames.clear()
        self._bad_seen = 0

    def too_noisy(self, bad_frames: int, now: int, armed: bool, time_scale: float) -> bool:
        """Whether, with a total of `bad_frames` at tick `now`, too many came within a second while armed."""
        new, self._bad_seen = max(0, bad_frames - self._bad_seen), bad_frames
        if not armed:
            self._bad_frames.clear()
            return False
        if not new and not self._bad_frames:
            return False
        self._bad_frames.extend([now] * new)
        while self._bad_frames and self._bad_frames[0] <= now - round(NOISE_TICKS * time_scale):
            self._bad_frames.popleft()
        return new > 0 and len(self._bad_frames) >= self._parameters.bad_frames


def input_fault(bits: int) -> FaultCode:
    """The fault for open interlocks; the gravest where there are several."""
    return next((code for bit, code in _BY_INPUT if bits & bit), FaultCode.DIELECTRIC)
