"""The machine behind an EDM Link session."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict

from edmctl import failures
from edmctl.errors import EdmError, LinkLost
from edmctl.link.link_errors import CommandRefused
from edmctl.link.messages import (
    PARAMS,
    Approach,
    Arm,
    CommitProfile,
    Disarm,
    HelloReply,
    Jump,
    PathMove,
    PiezoSet,
    PulseConfig,
    PulseEnable,
    ScanStart,
    SelfTest,
    ServoStart,
    ServoStop,
    SetParam,
    SetZero,
    StageMove,
    Status,
    TlmStart,
    TlmStop,
    TouchOff,
    param_crc,
)
from edmctl.link.session import Session
from edmctl.machine.faults import FaultLatched, latched_error
from edmctl.machine.inbox import Inbox
from edmctl.machine.interface import (
    SLICE_S,
    Axis,
    ControllerSettings,
    CutRequest,
    EventCode,
    JumpRequest,
    MachineEvent,
    MachineIdentity,
    MachineListener,
    MachineState,
    MachineStatus,
    MotionSettings,
    PulseSettings,
    ScanLine,
    TelemetryBlock,
    TelemetrySettings,
    Touch,
    TouchRequest,
    WaveformBatch,
    default_settings,
    settings_by_name,
)
from edmctl.machine.plausibility import impossible, wrong_touch
from edmctl.machine.queries import (
    clear_fault,
    identity_of,
    read_black_box,
    read_status,
    read_unbelieved,
    read_waveforms,
    wait_for_rest,
)
from edmctl.machine.stop import StopRequest
from edmctl.machine.waits import CUT_ENDS, GRACE_S, SLOWEST, Waits, touch_time_s
from edmctl.results.telemetry import LinkReport

SELF_TEST_S = 1.0
"""A self-test takes no longer: it averages the gap voltage twice for some tenths of a second."""

ATTEND_S = 0.1
"""So long at a time the line is read while something else is waited for."""

STANDS_WITHIN = 20.0
"""A stage that nothing has moved tells its place within so many µm (rotary: degrees), however it is measured."""


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
        self._waits = Waits(session, self._inbox, stop or StopRequest(), default_settings())
        self._origin_s: float | None = None
        self._position: dict[Axis, float] = {}
        self._stands: dict[Axis, float] = {}
        self._scans = False
        self._actuator_v = self._zero_um = 0.0

    @property
    def identity(self) -> MachineIdentity:
        return identity_of(self._session)

    @property
    def hello(self) -> HelloReply:
        """What the controller said of itself when the session opened."""
        return self._session.hello

    @property
    def time_s(self) -> float:
        """Controller time of the newest message, in s since the first one of the run."""
        return self._inbox.time_s

    @property
    def uptime_s(self) -> float:
        """How long the controller has been on, s: by the newest answer to a heartbeat."""
        return self._session.heard_s

    @property
    def zero_um(self) -> float:
        return self._zero_um

    def _run_seconds(self, t_us: int) -> float:
        seconds = self._session.seconds(t_us)
        if self._origin_s is None:
            self._origin_s = seconds
        return seconds - self._origin_s

    def configure(
        self, settings: ControllerSettings | MotionSettings, pulses: PulseSettings | None = None
    ) -> None:
        """Upload and commit every parameter and set the generator; refused while a fault is latched."""
        latched = self.latched_fault()
        if latched:
            raise latched
        self._waits.settings = {**default_settings(), **settings_by_name(settings)}
        with self._waits.faults_first():
            upload(self._session, self._waits.settings)
            if pulses is not None:
                set_generator(self._session, pulses)

    def start_telemetry(self, settings: TelemetrySettings, listener: MachineListener) -> None:
        self._waits.listener = listener
        self._inbox.begin_telemetry(settings)
        self._session.request(TlmStart(settings.period_us, settings.batch, settings.pulse_log))

    def stop_telemetry(self) -> None:
        self._session.request(TlmStop())
        self._waits.hand_over(everything=True)
        self._inbox.end_telemetry()

    def arm(self, *, pulses: bool = True) -> None:
        with self._waits.faults_first():
            self._session.request(Arm(param_crc(self._waits.settings)))
            self._zero_um = 0.0
            self._session.request(PulseEnable(on=int(pulses)))
        status = self.status()
        self._actuator_v = status.actuator_v
        self._position = {Axis.X: status.x_um, Axis.Y: status.y_um, Axis.THETA: status.theta_deg}

    def status(self) -> MachineStatus:
        status = read_status(self._session)
        places = {Axis.X: status.x_um, Axis.Y: status.y_um, Axis.THETA: status.theta_deg}
        for axis, stood in self._stands.items():
            if abs(places[axis] - stood) > STANDS_WITHIN:
                raise impossible(f"{axis.name} at {places[axis]:.1f}, nothing has moved it from {stood:.1f}")
        follows = self._scans and status.state in (MachineState.MACHINING, MachineState.JUMP)
        self._stands = {} if follows else places
        return status

    def self_test(self) -> float:
        self._waits.begin(SelfTest())
        return 1e-3 * self._waits.event((EventCode.TEST_DONE,), SELF_TEST_S).argument

    def rest(self, duration_s: float) -> None:
        self._waits.rest(duration_s)

    def ramp(self, actuator_v: float, slew_v_s: float) -> None:
        duration_s = abs(actuator_v - self._actuator_v) / slew_v_s
        self._waits.begin(PiezoSet(actuator_v, slew_v_s))
        self._waits.event((EventCode.MOVE_DONE,), duration_s)
        self._actuator_v = actuator_v

    def move_stage(self, axis: Axis, target: float, speed: float) -> None:
        """Move one stage and wait until it stands; the controller refuses unless the tool is retracted."""
        duration_s = abs(target - self._position.get(axis, 0.0)) / speed
        self._stands.pop(axis, None)
        self._waits.begin(StageMove(axis, round(1000.0 * target), round(1000.0 * speed)))
        self._waits.event((EventCode.STAGE_DONE,), duration_s)
        self._position[axis] = self._stands[axis] = target

    def set_zero(self, zero_um: float) -> None:
        with self._waits.faults_first():
            self._session.request(SetZero(zero_um))
        self._zero_um = zero_um

    def approach(self, speed_um_s: float, max_travel_um: float, gap_reference_v: float) -> MachineEvent:
        self._waits.begin(Approach(speed_um_s, max_travel_um, gap_reference_v))
        return self._waits.event((EventCode.APPROACH_DONE,), SLOWEST * max_travel_um / speed_um_s)

    def touch(self, request: TouchRequest) -> tuple[Touch, ...]:
        self._waits.begin(TouchOff(**asdict(request)))
        with self._inbox.gathering() as samples:
            found: list[Touch] = []
            while True:
                event = self._waits.event((EventCode.TOUCH, EventCode.TOUCH_DONE), touch_time_s(request))
                if event.code is EventCode.TOUCH_DONE:
                    break
                if problem := wrong_touch(event, len(found) + 1, request, samples):
                    raise impossible(problem)
                found.append(Touch(event.time_s, event.displacement_um, event.actuator_v))
        if len(found) != request.touches:
            raise impossible(f"TOUCH_DONE after {len(found)} of {request.touches} touches")
        return tuple(found)

    def start_cut(self, request: CutRequest) -> None:
        self._scans = False
        self._waits.begin(ServoStart(request.gap_reference_v, request.z_limit_um, request.max_time_s))

    def start_scan(self, request: CutRequest) -> None:
        self._stands.clear()
        self._scans = True
        self._waits.begin(ScanStart(request.gap_reference_v, request.z_limit_um, request.max_time_s))

    def path_move(self, line: ScanLine) -> bool:
        self._stands.clear()
        try:
            with self._waits.faults_first():
                self._session.request(
                    PathMove(line.x_um, line.y_um, line.speed_um_s, line.z_limit_um, int(line.last))
                )
        except CommandRefused as refused:
            if refused.status is not Status.BUSY:
                raise
            return False
        self._position |= {Axis.X: line.x_um, Axis.Y: line.y_um}
        return True

    @property
    def slice_s(self) -> float:
        return self._waits.slice_s

    def watch_cut(self, duration_s: float) -> MachineEvent | None:
        return self._waits.cut(duration_s)

    def stop_cut(self) -> MachineEvent:
        with self._waits.faults_first():
            self._session.request(ServoStop())
        return self._waits.event(CUT_ENDS, 0.0)

    def jump(self, request: JumpRequest) -> None:
        """Lift the tool to flush the gap, and wait until it is back.

        A cut that ends meanwhile is still there for `watch_cut` to report.
        """
        self._waits.look()
        with self._waits.faults_first():
            self._session.request(
                Jump(request.height_um, request.speed_um_s, request.dwell_s, request.clearance_um)
            )
        travel_s = 2.0 * request.height_um / request.speed_um_s
        self._waits.event((EventCode.JUMP_DONE,), travel_s + request.dwell_s)

    def set_pulses(self, pulses: PulseSettings) -> None:
        with self._waits.faults_first():
            set_generator(self._session, pulses)

    def disarm(self) -> None:
        self._waits.retreat(Disarm())
        self._waits.event((EventCode.MOVE_DONE,), self._retract_time_s())
        self._waits.rest(SLICE_S)  # the last samples are to show the rest
        self._actuator_v = 0.0

    def safe_stop(self) -> None:
        """Pulses off, retract to 0 V, idle, whatever the state.

        Raises nothing that is in errors.py: where the line is dead the controller's watchdog does the same.
        Stop requests are not heeded here, for this is how they end.
        """
        with suppress(EdmError):
            state = self._reported_state()
            if state in (MachineState.FAULT, MachineState.ESTOP):
                # The controller retracts by itself and reports no end of it.
                self._session.pump(self._retract_time_s())
            elif state is not MachineState.IDLE:
                self._waits.retreat(Disarm())
                self._waits.event_whatever_comes(EventCode.MOVE_DONE, self._retract_time_s() + GRACE_S)
        with suppress(EdmError):
            self._session.pump(SLICE_S)  # as in `disarm`
        with suppress(EdmError):
            self._session.request(TlmStop())
        with suppress(EdmError):
            self._waits.hand_over(everything=True)
        self._inbox.end_telemetry()

    def _reported_state(self) -> MachineState | None:
        """Return the state that the controller reports, None where it reports what cannot be. Raises LinkLost."""
        try:
            return read_status(self._session).state
        except LinkLost:
            raise
        except EdmError:
            return None

    def wait_for_rest(self) -> None:
        """Wait until a tool that retracts from what another host did is back."""
        wait_for_rest(self._session)

    def latched_fault(self) -> FaultLatched | None:
        """Return the error of starting a job with the fault that the controller holds; None where it holds none."""
        status = self.status()
        if status.state not in (MachineState.FAULT, MachineState.ESTOP):
            return None
        return latched_error(status.fault, self._waits.settings, self._session.transport.name)

    def attend(self, is_done: Callable[[], bool]) -> bool:
        """Read the line while something else is waited for, a short while at most: the controller hears its host.

        What comes meanwhile is heard, and raised by the next wait. Only on a live line: virtual time would pass.
        """
        return self._session.pump_until(is_done, ATTEND_S)

    def readings(self) -> MachineStatus:
        """Ask what the controller sees now, unbelieved: for a machine whose wires are looked at."""
        return read_unbelieved(self._session)

    def pass_time(self, duration_s: float) -> None:
        """Let time pass while nothing is armed: faults that are told meanwhile are for `readings` to show."""
        self._session.pump(duration_s)
        self._waits.check_stop()

    def wait_for(self, is_done: Callable[[], bool]) -> None:
        """Wait for something that is not the machine's, as long as it takes; `is_done` waits a moment by itself.

        The machine is not armed. Raises Interrupted.
        """
        while not is_done():
            self._waits.check_stop()
            if self.is_live:
                self._session.catch_up()

    def fall_silent(self, duration_s: float) -> None:
        """Send nothing for so long. What the controller does about it is for `readings` and listeners to show."""
        self._session.fall_silent(duration_s)
        self._waits.hand_over(everything=True)

    @property
    def is_live(self) -> bool:
        """Whether the machine's time passes by itself, and not only while the host waits for it."""
        return self._session.transport.live

    def clear_fault(self, code: int) -> None:
        clear_fault(self._session, code, self._waits.settings)
        self._inbox.fault = None

    def black_box(self) -> TelemetryBlock | None:
        return read_black_box(self._session, self._run_seconds)

    def waveforms(self) -> WaveformBatch | None:
        return read_waveforms(self._session, self._run_seconds)

    def link_report(self) -> LinkReport:
        return self._session.link_report()

    @property
    def bad_frames(self) -> int:
        return self._session.statistics.bad_frames

    def _retract_time_s(self) -> float:
        return self._waits.settings["piezo_max_v"] / self._waits.settings["retract_v_s"]


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
        raise failures.controller_refuses_settings(error=error) from error
