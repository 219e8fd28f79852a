"""The machine behind an EDM Link session."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

from edmctl.errors import EdmError, PreconditionError
from edmctl.link.messages import (
    PARAMS,
    Approach,
    Arm,
    CommitProfile,
    Disarm,
    GetStatus,
    Jump,
    PiezoSet,
    PulseConfig,
    PulseEnable,
    ServoStart,
    ServoStop,
    SetParam,
    StageMove,
    TlmStart,
    TlmStop,
    TouchOff,
    param_crc,
)
from edmctl.machine.faults import fault_error
from edmctl.machine.inbox import Inbox
from edmctl.machine.orders import settings_by_name
from edmctl.machine.port import (
    Axis,
    ControllerSettings,
    CutRequest,
    EventCode,
    Interlock,
    JumpRequest,
    MachineEvent,
    MachineIdentity,
    MachineListener,
    MachineState,
    MachineStatus,
    MotionSettings,
    PulseSettings,
    TelemetrySettings,
    Touch,
    TouchRequest,
)
from edmctl.machine.stop import StopRequest
from edmctl.machine.waits import GRACE_S, Waits

if TYPE_CHECKING:
    from collections.abc import Mapping

    from edmctl.link.session import Session

_CUT_ENDS = (EventCode.CUT_DONE, EventCode.TIME_UP, EventCode.STOPPED)

SLOWEST = 4.0
"""Feeds are commanded in V/s by a mean gain; after a turning point the tool may be this much slower."""


class LinkMachine:
    """A `Machine` whose controller answers on an open session.

    Parameters
    ----------
    session : opened by the caller (HELLO said, versions checked)
    stop : set by a signal handler; every wait looks at it. None where nothing can interrupt
    """

    def __init__(self, session: Session, stop: StopRequest | None = None) -> None:
        self._session = session
        self._inbox = Inbox(session, self._run_seconds)
        self._waits = Waits(session, self._inbox, stop or StopRequest(), _defaults())
        self._origin_s: float | None = None
        self._position: dict[Axis, float] = {}
        self._actuator_v = 0.0

    @property
    def identity(self) -> MachineIdentity:
        """Who answered."""
        hello, transport = self._session.hello, self._session.transport
        return MachineIdentity(
            transport=transport.name,
            serial=hello.serial,
            firmware=f"{hello.fw_major}.{hello.fw_minor}.{hello.fw_patch}",
            protocol=f"{hello.proto_major}.{hello.proto_minor}",
            simulated=transport.simulated,
        )

    @property
    def time_s(self) -> float:
        """Controller time of the newest message, in s since the first one of the run."""
        return self._inbox.time_s

    def _run_seconds(self, t_us: int) -> float:
        seconds = self._session.seconds(t_us)
        if self._origin_s is None:
            self._origin_s = seconds
        return seconds - self._origin_s

    def configure(
        self, settings: ControllerSettings | MotionSettings, pulses: PulseSettings | None = None
    ) -> None:
        """Upload and commit every parameter and set the generator; refused while a fault is latched."""
        status = self.status()
        if status.state in (MachineState.FAULT, MachineState.ESTOP):
            raise _latched(status.fault, self._waits.settings)
        self._waits.settings = {**_defaults(), **settings_by_name(settings)}
        for name, value in self._waits.settings.items():
            self._session.request(SetParam(PARAMS[name].id, _on_the_wire(name, value)))
        self._session.request(CommitProfile(param_crc(self._waits.settings)))
        if pulses is None:
            return
        self._session.request(
            PulseConfig(
                on_time_us=pulses.on_time_us,
                off_time_us=pulses.off_time_us,
                open_voltage_v=pulses.open_voltage_v,
                peak_current_a=pulses.peak_current_a,
                mode=pulses.mode,
                discharge_us=pulses.discharge_us,
            )
        )

    def start_telemetry(self, settings: TelemetrySettings, listener: MachineListener) -> None:
        """Begin to send samples to `listener`."""
        self._waits.listener = listener
        self._inbox.restart_telemetry()
        self._session.request(TlmStart(settings.period_us, settings.batch, settings.pulse_log))

    def stop_telemetry(self) -> None:
        """Send no more samples; what is pending reaches the listener."""
        self._session.request(TlmStop())
        self._waits.hand_over(everything=True)

    def arm(self, *, pulses: bool = True) -> None:
        """Start the watchdog and permit or forbid pulses; from here on the machine may move."""
        self._session.request(Arm(param_crc(self._waits.settings)))
        self._session.request(PulseEnable(on=int(pulses)))
        status = self.status()
        self._actuator_v = status.actuator_v
        self._position = {Axis.X: status.x_um, Axis.Y: status.y_um, Axis.THETA: status.theta_deg}

    def status(self) -> MachineStatus:
        """Ask what the controller sees now."""
        reply = self._session.request(GetStatus())
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
        )

    def rest(self, duration_s: float) -> None:
        """Let time pass."""
        self._waits.rest(duration_s)

    def ramp(self, actuator_v: float, slew_v_s: float) -> None:
        """Ramp the actuator and wait for the end of the ramp."""
        duration_s = abs(actuator_v - self._actuator_v) / slew_v_s
        self._waits.begin(PiezoSet(actuator_v, slew_v_s))
        self._waits.event((EventCode.MOVE_DONE,), duration_s)
        self._actuator_v = actuator_v

    def move_stage(self, axis: Axis, target: float, speed: float) -> None:
        """Move one stage and wait until it stands; the controller refuses unless the tool is retracted."""
        duration_s = abs(target - self._position.get(axis, 0.0)) / speed
        self._waits.begin(StageMove(axis, round(1000.0 * target), round(1000.0 * speed)))
        self._waits.event((EventCode.STAGE_DONE,), duration_s)
        self._position[axis] = target

    def approach(self, speed_um_s: float, max_travel_um: float, gap_reference_v: float) -> MachineEvent:
        """Advance with pulses until the mean gap voltage falls to the reference; the tool is then held."""
        self._waits.begin(Approach(speed_um_s, max_travel_um, gap_reference_v))
        return self._waits.event((EventCode.APPROACH_DONE,), SLOWEST * max_travel_um / speed_um_s)

    def touch(self, request: TouchRequest) -> tuple[Touch, ...]:
        """Find the surface by contact, without pulses; the tool ends a back-off above it."""
        self._waits.begin(
            TouchOff(
                fast_um_s=request.fast_um_s,
                fast_to_um=request.fast_to_um,
                speed_um_s=request.speed_um_s,
                z_max_um=request.z_max_um,
                back_off_um=request.back_off_um,
                dwell_s=request.dwell_s,
                touches=request.touches,
            )
        )
        found: list[Touch] = []
        while True:
            event = self._waits.event((EventCode.TOUCH, EventCode.TOUCH_DONE), _touch_time_s(request))
            if event.code is EventCode.TOUCH_DONE:
                return tuple(found)
            found.append(Touch(event.time_s, event.displacement_um, event.actuator_v))

    def start_cut(self, request: CutRequest) -> None:
        """Start the gap servo."""
        self._waits.begin(ServoStart(request.gap_reference_v, request.z_limit_um, request.max_time_s))

    def watch_cut(self, duration_s: float) -> MachineEvent | None:
        """Let at most `duration_s` of a cut pass; the event that ended the cut, None while it goes on."""
        self._waits.slice(duration_s)
        return self._waits.take(_CUT_ENDS)

    def stop_cut(self) -> MachineEvent:
        """End a cut: pulses off, tool held."""
        self._session.request(ServoStop())
        return self._waits.event(_CUT_ENDS, 0.0)

    def jump(self, request: JumpRequest) -> None:
        """Lift the tool to flush the gap, and wait until it is back.

        A cut that ends meanwhile is still there for `watch_cut` to report.
        """
        self._session.request(
            Jump(request.height_um, request.speed_um_s, request.dwell_s, request.clearance_um)
        )
        travel_s = 2.0 * request.height_um / request.speed_um_s
        self._waits.event((EventCode.JUMP_DONE,), travel_s + request.dwell_s)

    def disarm(self) -> None:
        """Pulses off, retract to 0 V, idle."""
        self._waits.begin(Disarm())
        self._waits.event((EventCode.MOVE_DONE,), self._retract_time_s())
        self._actuator_v = 0.0

    def safe_stop(self) -> None:
        """Pulses off, retract to 0 V, idle, whatever the state.

        Raises nothing that is in errors.py: where the line is dead the controller's watchdog does the same.
        Stop requests are not heeded here, for this is how they end.
        """
        with suppress(EdmError):
            state = self.status().state
            if state in (MachineState.FAULT, MachineState.ESTOP):
                # The controller retracts by itself and reports no end of it.
                self._session.pump(self._retract_time_s())
            elif state is not MachineState.IDLE:
                self._waits.begin(Disarm())
                self._waits.event_whatever_comes(EventCode.MOVE_DONE, self._retract_time_s() + GRACE_S)
            self._session.request(TlmStop())
        with suppress(EdmError):
            self._waits.hand_over(everything=True)

    def _retract_time_s(self) -> float:
        return self._waits.settings["piezo_max_v"] / self._waits.settings["retract_v_s"]


def _defaults() -> Mapping[str, float]:
    return {name: param.default for name, param in PARAMS.items()}


def _on_the_wire(name: str, value: float) -> int:
    try:
        return PARAMS[name].to_wire(value)
    except ValueError as error:
        raise PreconditionError(
            f"The controller cannot be set so: {error}.",
            hint="Change the value in the setup or in the profile.",
            code="E8011",
        ) from error


def _latched(fault: int, settings: Mapping[str, float]) -> PreconditionError:
    error = fault_error(fault, settings)
    return PreconditionError(
        f"The controller still holds fault {fault}: {error.message}", hint=error.hint, code="E8010"
    )


def _touch_time_s(request: TouchRequest) -> float:
    """Longest time to the next contact: the fast leg, the slow leg, the hunting."""
    fast_s = max(request.fast_to_um, 0.0) / request.fast_um_s
    slow_s = (request.z_max_um - request.fast_to_um) / request.speed_um_s
    return SLOWEST * (fast_s + slow_s + request.back_off_um / request.speed_um_s) + request.dwell_s
