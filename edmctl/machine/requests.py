"""What a machine is asked to do, in µm, V, A and s, and how its settings get onto the wire."""

from __future__ import annotations

from collections.abc import Mapping

from edmctl.dataclasses import asdict, dataclass
from edmctl.errors import PreconditionError
from edmctl.link.messages import PARAMS, CommitProfile, PulseConfig, SetParam, param_crc
from edmctl.link.session import Session
from edmctl.machine.states import PulseLog, PulseMode, ServoLaw


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


def upload(session: Session, settings: Mapping[str, float]) -> None:
    """Set and commit every parameter. Raises PreconditionError E8011 where the wire cannot carry a value."""
    for name, value in settings.items():
        session.request(SetParam(PARAMS[name].id, _on_the_wire(name, value)))
    session.request(CommitProfile(param_crc(settings)))


def set_generator(session: Session, pulses: PulseSettings) -> None:
    """Set the pulses of the generator."""
    session.request(PulseConfig(**asdict(pulses)))


def _on_the_wire(name: str, value: float) -> int:
    try:
        return PARAMS[name].to_wire(value)
    except ValueError as error:
        raise PreconditionError(
            f"The controller cannot be set so: {error}.",
            hint="Change the value in the setup or in the profile.",
            code="E8011",
        ) from error
