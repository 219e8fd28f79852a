"""The commands of the virtual controller: what each checks, starts and answers."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from edmctl.link import messages as m
from edmctl.link.faults import FaultCode
from edmctl.link.messages import State, Status
from edmctl.simulator import kernel as k

if TYPE_CHECKING:
    from collections.abc import Callable

    from edmctl.link.wire import Message
    from edmctl.simulator.controller import VirtualController
    from edmctl.simulator.port import Outcome

FIRMWARE = (1, 0, 0)
SERVO_HZ = TLM_MAX_HZ = 1000
# What the virtual generator can do.
PERIOD_US_MIN, PERIOD_US_MAX = 20.0, 1e6
OPEN_V_MAX, CURRENT_A_MAX = 300.0, 10.0
OK: Outcome = (Status.OK, b"")


class Commands:
    """Executes the commands of one controller."""

    def __init__(self, controller: VirtualController) -> None:
        self._c = controller
        self._handlers: dict[type, Callable[..., Outcome]] = {
            m.Hello: self._hello,
            m.Heartbeat: self._heartbeat,
            m.GetStatus: self._get_status,
            m.Arm: self._arm,
            m.Disarm: self._disarm,
            m.ClearFault: self._clear_fault,
            m.SetParam: self._set_param,
            m.GetParam: self._get_param,
            m.CommitProfile: self._commit,
            m.PiezoSet: self._piezo_set,
            m.StageMove: self._stage_move,
            m.Approach: self._approach,
            m.ServoStart: self._servo_start,
            m.ServoStop: self._servo_stop,
            m.Jump: self._jump,
            m.TouchOff: self._touch_off,
            m.PulseConfig: self._pulse_config,
            m.PulseEnable: self._pulse_enable,
            m.TlmStart: self._tlm_start,
            m.TlmStop: self._tlm_stop,
        }

    def execute(self, message: Message) -> Outcome:
        """Carry out a command and return the status and payload of its reply."""
        return self._handlers[type(message)](message)

    def _hello(self, request: m.Hello) -> Outcome:
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
            board=0,
            servo_hz=SERVO_HZ,
            tlm_max_hz=TLM_MAX_HZ,
            rx_window=1,
            boot_count=1,
            reset_cause=0,
            fault=self._c.fault,
            state=self._c.state,
        )
        return Status.OK, reply.pack()

    def _heartbeat(self, request: m.Heartbeat) -> Outcome:
        self._c.port.acknowledge(request.last_event)
        reply = m.HeartbeatReply(
            t_host_us=request.t_host_us,
            t_dev_us=self._c.tick * 1000,
            state=self._c.state,
            fault=self._c.fault,
            rx_bad=self._c.port.rx_bad & 0xFFFF,
            rx_drop=self._c.port.rx_drop & 0xFFFF,
        )
        return Status.OK, reply.pack()

    def _get_status(self, _: m.GetStatus) -> Outcome:
        plant = self._c.plant
        reply = m.GetStatusReply(
            state=self._c.state,
            fault=self._c.fault,
            interlocks=self._c.open_interlocks(),
            displacement_um=self._c.st.item(k.SENSOR_Z),
            x_um=plant.reported[m.Axis.X],
            y_um=plant.reported[m.Axis.Y],
            theta_deg=plant.reported[m.Axis.THETA],
            actuator_v=self._c.st.item(k.APPLIED_V),
            gap_v=self._c.st.item(k.GAP_V),
            temperature_c=plant.dielectric_temperature_c,
            flow_lpm=plant.dielectric_flow_lpm,
        )
        return Status.OK, reply.pack()

    def _arm(self, request: m.Arm) -> Outcome:
        if self._c.state is not State.IDLE:
            return Status.BAD_STATE, b""
        if request.param_crc != self._c.parameters.crc:
            return Status.PROFILE_MISMATCH, b""
        if open_inputs := self._c.open_interlocks():
            return Status.INTERLOCK, open_inputs.to_bytes(2, "little")
        self._c.host_heard()
        self._c.set_state(State.ARMED)
        return OK

    def _disarm(self, _: m.Disarm) -> Outcome:
        if not self._c.armed:
            return Status.BAD_STATE, b""
        self._c.stop_stage()
        self._c.pulses_allowed = False
        self._c.disarming = True
        self._c.set_state(State.MOVING)
        self._c.start_ramp(0.0, self._c.parameters.retract_v_s)
        return OK

    def _clear_fault(self, request: m.ClearFault) -> Outcome:
        if self._c.state not in (State.FAULT, State.ESTOP):
            return Status.BAD_STATE, b""
        if request.fault != self._c.fault:
            return Status.OUT_OF_RANGE, b""
        if self._c.ist[k.MODE] != k.HOLD:
            return Status.BUSY, b""
        if self._c.open_interlocks():
            return Status.INTERLOCK, b""
        self._c.fault = 0
        self._c.set_state(State.IDLE)
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

    def _piezo_set(self, request: m.PiezoSet) -> Outcome:
        if self._c.state is not State.ARMED:
            return Status.BAD_STATE, b""
        if request.actuator_v > self._c.parameters["piezo_max_v"] or request.slew_v_s <= 0.0:
            return Status.OUT_OF_RANGE, b""
        self._c.set_state(State.MOVING)
        self._c.start_ramp(request.actuator_v, request.slew_v_s)
        return OK

    def _stage_move(self, request: m.StageMove) -> Outcome:
        if self._c.state is not State.ARMED:
            return Status.BAD_STATE, b""
        if request.axis > m.Axis.THETA or request.speed == 0:
            return Status.OUT_OF_RANGE, b""
        if self._c.st[k.SLOW_Z] > self._c.parameters["safe_z_um"]:
            return Status.INTERLOCK, b""
        self._c.start_stage(request.axis, request.target * 1e-3, request.speed * 1e-3)
        self._c.set_state(State.MOVING)
        return OK

    def _approach(self, request: m.Approach) -> Outcome:
        if self._c.state is not State.ARMED or not self._c.pulses_allowed:
            return Status.BAD_STATE, b""
        if request.speed_um_s <= 0.0:
            return Status.OUT_OF_RANGE, b""
        st = self._c.st
        st[k.GAP_REF] = request.gap_ref_v
        st[k.SLOW_V_S] = self._volts(request.speed_um_s)
        st[k.START_Z] = st[k.SLOW_Z]
        st[k.Z_MAX] = request.max_travel_um
        st[k.GAP_V] = self._c.par[k.DUTY_V]
        self._c.pulses_on()
        self._c.begin(k.APPROACH)
        self._c.set_state(State.APPROACH)
        return OK

    def _servo_start(self, request: m.ServoStart) -> Outcome:
        if self._c.state is not State.ARMED or not self._c.pulses_allowed:
            return Status.BAD_STATE, b""
        st, ist = self._c.st, self._c.ist
        st[k.GAP_REF] = st[k.GAP_V] = request.gap_ref_v
        st[k.Z_LIMIT] = request.z_limit_um
        st[k.RATE_V_S] = st[k.INTEGRAL] = 0.0
        ist[k.TIME_TICKS] = max(1, round(request.max_time_s / k.TICK_S))
        ist[k.SERVO_COUNT] = 0
        ist[k.DIRECTION] = 1
        self._c.pulses_on()
        self._c.begin(k.SERVO)
        self._c.set_state(State.MACHINING)
        return OK

    def _servo_stop(self, _: m.ServoStop) -> Outcome:
        if not self._c.armed or self._c.stage or self._c.disarming:
            return Status.BAD_STATE, b""
        self._c.stop_motion()
        return OK

    def _jump(self, request: m.Jump) -> Outcome:
        resumes = self._c.ist[k.MODE] == k.SERVO
        if not resumes and self._c.state is not State.ARMED:
            return Status.BAD_STATE, b""
        if request.speed_um_s <= 0.0:
            return Status.OUT_OF_RANGE, b""
        st, ist = self._c.st, self._c.ist
        slew = min(self._volts(request.speed_um_s), self._c.parameters["slew_limit_v_s"])
        st[k.START_V] = st[k.COMMAND_V]
        st[k.JUMP_V] = min(self._volts(request.height_um), float(st[k.COMMAND_V]))
        st[k.CLEARANCE_V] = min(self._volts(request.clearance_um), float(st[k.JUMP_V]))
        st[k.FAST_V_S] = self._volts(self._c.parameters["short_back_um_s"])
        ramp_ticks = math.ceil(float(st[k.JUMP_V]) / slew / k.TICK_S)
        ist[k.PHASE_TICKS] = ramp_ticks + k.BLEND_TICKS
        ist[k.DWELL_TICKS] = max(1, round(request.dwell_s / k.TICK_S))
        ist[k.JUMP_RESUMES] = int(resumes)
        ist[k.PULSES_ON] = 0
        self._c.telemetry.flush()
        self._c.begin(k.JUMP_UP)
        self._c.set_state(State.JUMP)
        return OK

    def _touch_off(self, request: m.TouchOff) -> Outcome:
        if self._c.state is not State.ARMED:
            return Status.BAD_STATE, b""
        if request.touches == 0 or request.speed_um_s <= 0.0 or request.fast_um_s <= 0.0:
            return Status.OUT_OF_RANGE, b""
        if self._c.ist[k.CONTACT]:
            self._c.raise_fault(FaultCode.STUCK_CONTACT)
            return OK
        st, ist = self._c.st, self._c.ist
        st[k.FAST_V_S], st[k.SLOW_V_S] = self._volts(request.fast_um_s), self._volts(request.speed_um_s)
        st[k.FAST_TO], st[k.Z_MAX] = request.fast_to_um, request.z_max_um
        st[k.BACK_V] = self._volts(request.back_off_um)
        ist[k.DWELL_TICKS] = max(1, round(request.dwell_s / k.TICK_S))
        ist[k.TOUCHES_LEFT], ist[k.TOUCH_NO] = request.touches, 0
        self._c.begin(k.TOUCH_FAST)
        self._c.set_state(State.TOUCH)
        return OK

    def _pulse_config(self, request: m.PulseConfig) -> Outcome:
        if self._c.state not in (State.IDLE, State.ARMED):
            return Status.BAD_STATE, b""
        period_us = request.on_time_us + request.off_time_us
        times_fit = request.on_time_us > 0.0 and PERIOD_US_MIN <= period_us <= PERIOD_US_MAX
        supply_fits = (
            0.0 < request.open_voltage_v <= OPEN_V_MAX and 0.0 < request.peak_current_a <= CURRENT_A_MAX
        )
        if not (times_fit and supply_fits):
            return Status.OUT_OF_RANGE, b""
        isopulse = request.mode == m.PulseMode.ISOPULSE
        self._c.plant.set_generator(
            request.on_time_us,
            request.off_time_us,
            request.open_voltage_v,
            request.peak_current_a,
            request.discharge_us if isopulse else 0.0,
        )
        return OK

    def _pulse_enable(self, request: m.PulseEnable) -> Outcome:
        if request.on and self._c.state is not State.ARMED:
            return Status.BAD_STATE, b""
        self._c.pulses_allowed = bool(request.on)
        if not request.on and self._c.state in (State.APPROACH, State.MACHINING, State.JUMP):
            self._c.stop_motion()
        return OK

    def _tlm_start(self, request: m.TlmStart) -> Outcome:
        if request.period_us * TLM_MAX_HZ < 1_000_000:
            return Status.RATE_TOO_HIGH, b""
        pulses = request.period_us * 1000 / self._c.ist.item(k.PULSE_PERIOD)
        if request.period_us % 1000 or not 1 <= request.batch <= 14 or pulses > 255:
            return Status.OUT_OF_RANGE, b""
        self._c.telemetry.start(request)
        return OK

    def _tlm_stop(self, _: m.TlmStop) -> Outcome:
        self._c.telemetry.stop()
        return OK

    def _volts(self, length_um: float) -> float:
        return length_um * self._c.par.item(k.V_PER_UM)
