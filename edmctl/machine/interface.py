"""The one interface between procedures and a machine.

Everything a procedure needs of the machine is imported from here.
"""

from __future__ import annotations

from typing import Protocol

from edmctl.dataclasses import dataclass
from edmctl.machine.faults import host_fault
from edmctl.machine.requests import (
    ControllerSettings,
    CutRequest,
    JumpRequest,
    MotionSettings,
    PulseSettings,
    ScanLine,
    TelemetrySettings,
    TouchRequest,
)
from edmctl.machine.states import (
    Axis,
    EventCode,
    Interlock,
    MachineState,
    PulseClass,
    PulseLog,
    PulseMode,
    ServoLaw,
    TelemetryFlag,
)
from edmctl.results.telemetry import (
    LinkReport,
    PulseBlockBatch,
    PulseTrain,
    TelemetryBlock,
    WaveformBatch,
    joined,
)

__all__ = [
    "Axis",
    "ControllerSettings",
    "CutRequest",
    "EventCode",
    "Interlock",
    "JumpRequest",
    "Machine",
    "MachineEvent",
    "MachineIdentity",
    "MachineListener",
    "MachineState",
    "MachineStatus",
    "MotionSettings",
    "PulseBlockBatch",
    "PulseClass",
    "PulseLog",
    "PulseMode",
    "PulseSettings",
    "PulseTrain",
    "SampleListener",
    "ScanLine",
    "ServoLaw",
    "TelemetryBlock",
    "TelemetryFlag",
    "TelemetrySettings",
    "Touch",
    "TouchRequest",
    "WaveformBatch",
    "host_fault",
    "joined",
]


@dataclass(frozen=True, slots=True)
class MachineIdentity:
    """Who answered: board serial, firmware version, and whether it is the virtual machine."""

    transport: str
    serial: str
    firmware: str
    protocol: str
    simulated: bool


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


class MachineListener(Protocol):
    """Who hears the machine. Called within the machine's waits, in order; what it raises ends the wait."""

    def telemetry(self, block: TelemetryBlock) -> None:
        """Take consecutive samples."""

    def pulse_blocks(self, batch: PulseBlockBatch) -> None:
        """Take consecutive pulse blocks."""

    def pulses(self, batch: PulseTrain) -> None:
        """Take consecutive pulses."""

    def event(self, event: MachineEvent) -> None:
        """Take an event."""

    def log(self, level: int, text: str) -> None:
        """Take a line of the controller's own log."""


class SampleListener:
    """A listener without pulses, events and log; subclasses take the samples."""

    def pulse_blocks(self, batch: PulseBlockBatch) -> None:
        """Do nothing."""

    def pulses(self, batch: PulseTrain) -> None:
        """Do nothing."""

    def event(self, event: MachineEvent) -> None:
        """Do nothing."""

    def log(self, level: int, text: str) -> None:
        """Do nothing."""


SLICE_S = 0.1
"""A wait on a live line looks around so often; frames of samples come as often."""


class Machine(Protocol):
    """A piezo-fed micro-EDM machine.

    Every call but `start_cut` and `start_scan` returns when the motion has ended, and raises `MachineFault` when the
    controller latched a fault, `LinkLost` when it no longer answers, `PreconditionError` when it refuses, and
    `Interrupted` when a stop was asked for.
    """

    @property
    def identity(self) -> MachineIdentity:
        """Return who answered."""

    @property
    def time_s(self) -> float:
        """Controller time of the newest message, in s since the first sample."""

    @property
    def uptime_s(self) -> float:
        """How long the controller has been on, s."""

    @property
    def zero_um(self) -> float:
        """Where the controller takes home to be: what `set_zero` has said since the newest `arm`, else 0."""

    def configure(
        self, settings: ControllerSettings | MotionSettings, pulses: PulseSettings | None = None
    ) -> None:
        """Upload and commit every parameter and set the generator. The machine must be idle.

        Parameters that `settings` does not have get the controller's defaults; without `pulses` the generator is
        left alone.
        """

    def start_telemetry(self, settings: TelemetrySettings, listener: MachineListener) -> None:
        """Begin to send samples to `listener`."""

    def stop_telemetry(self) -> None:
        """Send no more samples; what is pending reaches the listener."""

    def arm(self, *, pulses: bool = True) -> None:
        """Start the watchdog; from here on the machine may move, and make pulses unless that is forbidden."""

    def status(self) -> MachineStatus:
        """Ask what the controller sees now."""

    def self_test(self) -> float:
        """Test the gap sensor with the tool retracted, armed and with pulses permitted.

        The mean gap voltage with the generator on, V. MachineFault E63003 where the sensor is wrong.
        """

    def rest(self, duration_s: float) -> None:
        """Let time pass."""

    def ramp(self, actuator_v: float, slew_v_s: float) -> None:
        """Ramp the actuator."""

    def move_stage(self, axis: Axis, target: float, speed: float) -> None:
        """Move a stage to `target` µm (rotary: degrees) at `speed` per s. Refused unless retracted."""

    def set_zero(self, zero_um: float) -> None:
        """Say where home is at rest at 0 V, armed: `safe_z_um` counts from it until the next `arm`.

        Refused where the controller's own reading is more than 5 µm below or 25 µm above it.
        """

    def approach(self, speed_um_s: float, max_travel_um: float, gap_reference_v: float) -> MachineEvent:
        """Advance with pulses until the mean gap voltage falls to the reference; the tool is then held."""

    def touch(self, request: TouchRequest) -> tuple[Touch, ...]:
        """Find the surface by contact, without pulses; the tool ends a back-off above it."""

    def start_cut(self, request: CutRequest) -> None:
        """Start the gap servo."""

    def start_scan(self, request: CutRequest) -> None:
        """Start the gap servo with the tool held at its limit; the stages wait for `path_move`."""

    def path_move(self, line: ScanLine) -> bool:
        """Append a line to the path of a scan; False where the queue is full: try again after `watch_cut`."""

    @property
    def slice_s(self) -> float:
        """How long a cut may be left alone, s: less on a live line than where time is virtual."""

    def watch_cut(self, duration_s: float) -> MachineEvent | None:
        """Let at most `duration_s` of a cut or scan pass; the event that ended it, None while it goes on."""

    def stop_cut(self) -> MachineEvent:
        """End a cut or scan: pulses off, tool and stages held."""

    def jump(self, request: JumpRequest) -> None:
        """Lift the tool to flush the gap, and return."""

    def set_pulses(self, pulses: PulseSettings) -> None:
        """Set the generator anew: armed, and not while it makes pulses."""

    def clear_fault(self, code: int) -> None:
        """Clear the latched fault `code` once the tool has retracted; the machine is idle then.

        Raises `NothingLatched`, `WrongFault` or `InterlockOpen` where that cannot be.
        """

    def disarm(self) -> None:
        """Pulses off, retract to 0 V, idle."""

    def safe_stop(self) -> None:
        """Pulses off, retract to 0 V, idle, whatever the state. Raises no `EdmError`: one is on its way."""

    def black_box(self) -> TelemetryBlock | None:
        """Return every millisecond of the last two seconds before the latched fault; None where nothing is held."""

    def waveforms(self) -> WaveformBatch | None:
        """Return gap voltage and current about the latched fault, with some periods after it; None without any.

        A slow line takes seconds: every sample comes.
        """

    def link_report(self) -> LinkReport:
        """Return how the line did since the session opened."""

    @property
    def bad_frames(self) -> int:
        """Frames that arrived damaged since the session opened."""
