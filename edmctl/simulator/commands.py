"""The commands of the virtual controller: session, arming, faults and parameters; motions and services join them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.link import messages as m
from edmctl.link.messages import State, Status
from edmctl.simulator.controller_state import HOLD
from edmctl.simulator.injection import Trigger
from edmctl.simulator.motion_commands import MotionCommands
from edmctl.simulator.service_commands import TLM_MAX_HZ, ServiceCommands

if TYPE_CHECKING:
    from collections.abc import Callable

    from edmctl.link.wire import Message
    from edmctl.simulator.controller import VirtualController
    from edmctl.simulator.port import Outcome

FIRMWARE = (1, 0, 0)
SERVO_HZ = 1000
OK: Outcome = (Status.OK, b"")


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
        """Carry out a command and return the status and payload of its reply."""
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
            clock=m.Clock.DRIVEN if self._c.port.driven else m.Clock.RUNNING,
            baud=self._c.baud,
        )
        return Status.OK if is_served else Status.VERSION, reply.pack()

    def _heartbeat(self, request: m.Heartbeat) -> Outcome:
        self._c.port.acknowledge(request.last_event)
        reply = m.HeartbeatReply(
            t_host_us=request.t_host_us,
            t_dev_us=self._c.time_us,
            state=self._c.state,
            fault=self._c.fault,
            rx_bad=self._c.port.rx_bad & 0xFFFF,
            rx_drop=self._c.port.rx_drop & 0xFFFF,
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
        if self._c.loop.mode != HOLD:
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
