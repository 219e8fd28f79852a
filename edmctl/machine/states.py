"""Enumerations of the controller that the interface speaks in; their values are those of the wire."""

from __future__ import annotations

from edmctl.link.messages import Axis, EventCode, PulseClass, PulseLog, PulseMode, ServoLaw
from edmctl.link.messages import Interlocks as Interlock
from edmctl.link.messages import State as MachineState
from edmctl.link.messages import TlmFlags as TelemetryFlag

__all__ = [
    "Axis",
    "EventCode",
    "Interlock",
    "MachineState",
    "PulseClass",
    "PulseLog",
    "PulseMode",
    "ServoLaw",
    "TelemetryFlag",
]
