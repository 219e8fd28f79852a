"""The commands of the virtual controller but for motions: session, arming, faults, parameters, status, telemetry."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from functools import cache

from edmctl.link import messages as m
from edmctl.link.messages import State, Status
from edmctl.link.wire import Message, saturated
from edmctl.simulator.controller import VirtualController
from edmctl.simulator.controller_state import HOLD
from edmctl.simulator.injection import Trigger
from edmctl.simulator.link_endpoint import OK, Outcome
from edmctl.simulator.motion_commands import MotionCommands
from edmctl.simulator.telemetry import bytes_per_second

FIRMWARE = (1, 0, 0)
SERVO_HZ = 1000
TLM_MAX_HZ = 1000
RATE_RESERVE = 0.25  # of a line, for replies and events
BITS_PER_BYTE = 10
SCHEMA_PER_REPLY = 243
REBOOT_MAGIC = 0x0B007EDB


class Commands:
    """Executes the commands of one controller."""

    def __init__(self, controller: VirtualController) -> None:
        self._c = controller
        self._handlers: dict[type, Callable[..., Outcome]] = {
            m.Hello: self._hello,
            m.Heartbeat: self._heartbeat,
            m.Arm: self._arm,
            m.Disarm: self._disarm,
            m.ClearFault: self._clear_fault,
            m.SetParam: self._set_param,
            m.GetParam: self._get_param,
            m.CommitProfile: self._commit,
            **MotionCommands(controller).handlers,
            **ServiceCommands(controller).handlers,
        }

    def execute(self, message: Message) -> Outcome:
        return self._handlers[type(message)](message)

    def _hello(self, request: m.Hello) -> Outcome:
        is_served = (request.proto_major, request.schema_hash) == (m.PROTO_MAJOR, m.SCHEMA_HASH)
        reply = m.HelloReply(
            proto_major=m.PROTO_MAJOR,
            proto_minor=m.PROTO_MINOR,
            host_nonce=request.host_nonce,
            schema_hash=m.SCHEMA_HASH,
            fw_major=FIRMWARE[0],
            fw_minor=FIRMWARE[1],
            fw_patch=FIRMWARE[2],
            git=0,
            serial=self._c.plant.serial,
            board=self._c.board,
            servo_hz=SERVO_HZ,
            tlm_max_hz=TLM_MAX_HZ,
            rx_window=1,
            boot_count=self._c.boot_count,
            reset_cause=self._c.reset_cause,
            fault=self._c.fault,
            state=self._c.state,
            clock=m.Clock.DRIVEN if self._c.link.driven else m.Clock.RUNNING,
            baud=self._c.baud,
        )
        return Status.OK if is_served else Status.VERSION, reply.pack()

    def _heartbeat(self, request: m.Heartbeat) -> Outcome:
        self._c.link.acknowledge(request.last_event)
        reply = m.HeartbeatReply(
            t_host_us=request.t_host_us,
            t_dev_us=self._c.time_us,
            state=self._c.state,
            fault=self._c.fault,
            rx_bad=self._c.link.rx_bad & 0xFFFF,
            rx_drop=self._c.link.rx_drop & 0xFFFF,
        )
        return Status.OK, reply.pack()

    def _arm(self, request: m.Arm) -> Outcome:
        if self._c.state is not State.IDLE:
            return Status.BAD_STATE, b""
        if request.param_crc != self._c.parameters.crc:
            return Status.PROFILE_MISMATCH, b""
        if open_inputs := self._c.guards.open_interlocks():
            return Status.INTERLOCK, open_inputs.to_bytes(2, "little")
        self._c.host_heard()
        self._c.zero_um = 0.0
        self._c.set_state(State.ARMED)
        self._c.injector.note(Trigger.ARM)
        return OK

    def _disarm(self, _: m.Disarm) -> Outcome:
        if not self._c.armed:
            return Status.BAD_STATE, b""
        self._c.motion.stop_stage()
        self._c.pulses_allowed = False
        self._c.disarming = True
        self._c.set_state(State.MOVING)
        self._c.motion.start_ramp(0.0, self._c.parameters.retract_v_s)
        return OK

    def _clear_fault(self, request: m.ClearFault) -> Outcome:
        if self._c.state not in (State.FAULT, State.ESTOP):
            return Status.BAD_STATE, b""
        if request.fault != self._c.fault:
            return Status.OUT_OF_RANGE, b""
        if self._c.loop.mode != HOLD or not self._c.link.takes_faults:
            return Status.BUSY, b""
        if open_inputs := self._c.guards.open_interlocks():
            return Status.INTERLOCK, open_inputs.to_bytes(2, "little")
        self._c.clear_fault()
        return OK

    def _set_param(self, request: m.SetParam) -> Outcome:
        if self._c.state is not State.IDLE:
            return Status.BAD_STATE, b""
        return OK if self._c.parameters.stage(request.param, request.value) else (Status.OUT_OF_RANGE, b"")

    def _get_param(self, request: m.GetParam) -> Outcome:
        value = self._c.parameters.wire_value(request.param)
        return (Status.OUT_OF_RANGE, b"") if value is None else (Status.OK, m.GetParamReply(value).pack())

    def _commit(self, request: m.CommitProfile) -> Outcome:
        if self._c.state is not State.IDLE:
            return Status.BAD_STATE, b""
        return OK if self._c.parameters.commit(request.crc) else (Status.PROFILE_MISMATCH, b"")


@cache
def compressed_schema() -> bytes:
    """The canonical schema, as GET_SCHEMA hands it out."""
    from edmctl.link.schema import load_schema

    return zlib.compress(load_schema().canonical_json().encode(), 9)


class ServiceCommands:
    """Answers questions; changes nothing that moves."""

    def __init__(self, controller: VirtualController) -> None:
        self._c = controller
        self.handlers: dict[type, Callable[..., Outcome]] = {
            m.GetSchema: self._get_schema,
            m.Advance: self._advance,
            m.GetStatus: self._get_status,
            m.BlackboxRead: self._black_box,
            m.WaveformRead: self._waveforms,
            m.Reboot: self._reboot,
            m.TlmStart: self._tlm_start,
            m.TlmStop: self._tlm_stop,
        }

    def _get_schema(self, request: m.GetSchema) -> Outcome:
        data = compressed_schema()
        part = data[request.offset : request.offset + SCHEMA_PER_REPLY]
        return Status.OK, m.GetSchemaReply(len(data), len(part), part).pack()

    def _advance(self, request: m.Advance) -> Outcome:
        if not self._c.link.driven:
            return Status.UNKNOWN_TYPE, b""
        if self._c.link.reboots:
            self._c.reset(m.ResetCause.COMMANDED)
        if request.timeout_us:
            self._c.host_wait.wait(request.timeout_us * 1e-6)
        return Status.OK, m.AdvanceReply(self._c.time_us).pack()

    def _get_status(self, _: m.GetStatus) -> Outcome:
        plant = self._c.plant
        inputs = plant.inputs()
        reply = m.GetStatusReply(
            state=self._c.state,
            fault=self._c.fault,
            interlocks=self._c.guards.open_interlocks(),
            displacement_um=self._c.loop.displacement_um,
            x_um=plant.reported[m.Axis.X],
            y_um=plant.reported[m.Axis.Y],
            theta_deg=plant.reported[m.Axis.THETA],
            actuator_v=self._c.plant.drive.actuator_v,
            gap_v=self._c.loop.gap_v,
            temperature_c=inputs.temperature_c,
            flow_lpm=inputs.flow_lpm,
            monitor_v=inputs.monitor_v,
            flags=self._c.black_box.newest_flags(self._c.tick),
        )
        return Status.OK, saturated(reply).pack()

    def _black_box(self, request: m.BlackboxRead) -> Outcome:
        c = self._c
        return Status.OK, c.black_box.read(request.offset, c.tick, c.boot_tick).pack()

    def _waveforms(self, request: m.WaveformRead) -> Outcome:
        reply = self._c.waveforms.read(request.offset, self._c.tick)
        return (Status.BUSY, b"") if reply is None else (Status.OK, reply.pack())

    def _reboot(self, request: m.Reboot) -> Outcome:
        if self._c.armed:
            return Status.BAD_STATE, b""
        if request.magic != REBOOT_MAGIC:
            return Status.OUT_OF_RANGE, b""
        self._c.link.reboots = True  # the reply goes first
        self._c.telemetry.forget()
        return OK

    def _tlm_start(self, request: m.TlmStart) -> Outcome:
        if request.period_us * TLM_MAX_HZ < 1_000_000:
            return Status.RATE_TOO_HIGH, b""
        pulses = request.period_us * 1000 / self._c.settings.pulse_period_ns
        fits = not request.period_us % 1000 and 1 <= request.batch <= 14 and pulses <= 255
        if not fits or request.pulse_log > m.PulseLog.FULL:
            return Status.OUT_OF_RANGE, b""
        needed = (1.0 + RATE_RESERVE) * bytes_per_second(
            request, self._c.settings.pulse_period_ns, self._c.settings.block_size
        )
        if self._c.baud and needed > self._c.baud / BITS_PER_BYTE:
            return Status.RATE_TOO_HIGH, b""
        self._c.telemetry.start(request)
        return OK

    def _tlm_stop(self, _: m.TlmStop) -> Outcome:
        self._c.telemetry.stop()
        return OK
