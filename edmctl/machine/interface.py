"""The one interface between procedures and a machine.

Everything a procedure needs of the machine is imported from here.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from edmctl.dataclasses import dataclass
from edmctl.link.messages import PARAMS, Axis, EventCode, PulseClass, PulseLog, PulseMode, ServoLaw
from edmctl.link.messages import Interlocks as Interlock
from edmctl.link.messages import State as MachineState
from edmctl.link.messages import TlmFlags as TelemetryFlag
from edmctl.machine.faults import host_fault
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
class ControllerSettings:
    """Every parameter of the controller, by the parameter's own name and unit (docs/protocol.md)."""

    piezo_max_v: float
    slew_limit_v_s: float
    gain_um_per_v: float
    safe_z_um: float
    retract_v_s: float
    sensor_fitted: bool
    servo_law: ServoLaw
    forward_um_s: float
    back_um_s: float
    short_back_um_s: float
    filter_hz: float
    hysteresis: float
    kp_um_s: float
    ki_um_s2: float
    servo_period_us: int
    servo_latency: int
    short_v: float
    arc_v: float
    arc_delay_us: float
    block_pulses: int
    short_stuck_s: float
    arc_run: int
    open_lost_um: float
    open_lost_s: float
    watchdog_s: float
    dielectric_required: bool
    flow_min_lpm: float
    temperature_max_c: float


@dataclass(frozen=True, slots=True)
class MotionSettings:
    """The parameters that matter where the tool only moves: no gap, no sparks."""

    piezo_max_v: float
    slew_limit_v_s: float
    gain_um_per_v: float
    safe_z_um: float
    retract_v_s: float
    sensor_fitted: bool
    watchdog_s: float
    dielectric_required: bool


@dataclass(frozen=True, slots=True)
class PulseSettings:
    """What the generator makes: times in µs, voltage in V, current in A."""

    on_time_us: float
    off_time_us: float
    open_voltage_v: float
    peak_current_a: float
    mode: PulseMode
    discharge_us: float


@dataclass(frozen=True, slots=True)
class TelemetrySettings:
    """How often the controller samples for the host, samples per frame, and which pulses it sends."""

    period_us: int
    batch: int
    pulse_log: PulseLog


@dataclass(frozen=True, slots=True)
class TouchRequest:
    """A contact measurement: fast to `fast_to_um`, then slow until contact, again after each back-off.

    No contact up to `z_max_um` is a fault.
    """

    fast_um_s: float
    fast_to_um: float
    speed_um_s: float
    z_max_um: float
    back_off_um: float
    dwell_s: float
    touches: int


@dataclass(frozen=True, slots=True)
class CutRequest:
    """Gap servo for at most `max_time_s`.

    A cut ends where the filtered displacement reaches `z_limit_um`; in a scan the tool is held there, while the
    stages follow lines.
    """

    gap_reference_v: float
    z_limit_um: float
    max_time_s: float


@dataclass(frozen=True, slots=True)
class ScanLine:
    """A line of a scan: from where the one before ends to (`x_um`, `y_um`), the limit going to `z_limit_um`.

    The scan ends with the line that is the `last`.
    """

    x_um: float
    y_um: float
    speed_um_s: float
    z_limit_um: float
    last: bool


@dataclass(frozen=True, slots=True)
class JumpRequest:
    """Retract by `height_um`, dwell, come back to `clearance_um` above the start point."""

    height_um: float
    speed_um_s: float
    dwell_s: float
    clearance_um: float


def settings_by_name(settings: ControllerSettings | MotionSettings) -> Mapping[str, float]:
    """Return the values by the parameters' names."""
    return {name: float(getattr(settings, name)) for name in type(settings).__slots__}


def default_settings() -> Mapping[str, float]:
    """Return every parameter by name with its default, that of a controller that has just started."""
    return {name: param.default for name, param in PARAMS.items()}


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


class MachineListener:
    """Receives the machine's data, called within its waits, in order; an exception ends the wait.

    A subclass overrides the methods whose data it uses; the others do nothing.
    """

    def telemetry(self, block: TelemetryBlock) -> None:
        """Take consecutive samples."""

    def pulse_blocks(self, batch: PulseBlockBatch) -> None:
        """Take consecutive pulse blocks."""

    def pulses(self, batch: PulseTrain) -> None:
        """Take consecutive pulses."""

    def event(self, event: MachineEvent) -> None:
        """Take an event."""

    def log(self, level: int, text: str) -> None:
        """Take a line of the controller's log."""


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

        Raises `NothingLatched`, `UsageError` E2030 if another fault is latched, or `InterlockOpen`.
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
