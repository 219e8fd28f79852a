"""The virtual controller: states, commands, watchdog, faults and the safe state, as a board's firmware has them.

It owns hard real time (through the kernel), obeys EDM Link frames, and protects the machine without the host:
whatever goes wrong, pulses go off first, then the tool retracts, then everything holds and the fault is latched.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from edmctl.link import messages as m
from edmctl.link.faults import FaultCode
from edmctl.link.messages import EventCode, Interlocks, State, Status
from edmctl.simulator import kernel as k
from edmctl.simulator.parameters import Parameters
from edmctl.simulator.port import DevicePort, Outcome
from edmctl.simulator.telemetry import SLICE_TICKS, Telemetry

if TYPE_CHECKING:
    from collections.abc import Callable

    from edmctl.link.wire import Message
    from edmctl.simulator.plant import Plant

FIRMWARE = (1, 0, 0)
SERIAL = "EDM-VIRTUAL"
SERVO_HZ = TLM_MAX_HZ = 1000
EVENT_REPEAT_TICKS = 100
STAGE_SETTLE_TICKS = 50
INTERLOCK_TICKS = 10  # how often the interlock inputs are read while armed
HISTORY = 64  # servo decisions remembered, for latency
OK: Outcome = (Status.OK, b"")

_AFTER = {
    k.SPARK_FOUND: EventCode.APPROACH_DONE,
    k.CUT_DONE: EventCode.CUT_DONE,
    k.TIME_UP: EventCode.TIME_UP,
    k.TOUCHES_DONE: EventCode.TOUCH_DONE,
}
_FAULTS = {
    k.FAULT_TRAVEL: FaultCode.TRAVEL_LIMIT,
    k.FAULT_NO_CONTACT: FaultCode.NO_CONTACT,
    k.FAULT_STUCK_CONTACT: FaultCode.STUCK_CONTACT,
    k.FAULT_COLLISION: FaultCode.COLLISION,
    k.FAULT_SHORT: FaultCode.SHORT_STUCK,
    k.FAULT_ARC: FaultCode.ARC_BURN,
    k.FAULT_NO_SPARK: FaultCode.NO_SPARK,
}


class VirtualController:
    """One controller over one plant. Feed it bytes, let time pass, take bytes."""

    def __init__(self, plant: Plant) -> None:
        self.plant = plant
        self._st, self._ist, self._par = plant.st, plant.ist, plant.par
        self._port = DevicePort(self._execute)
        self._parameters = Parameters(plant)
        self._telemetry = Telemetry(plant, self._port.send)
        self._history = np.zeros(HISTORY)
        self._fault = 0
        self._disarming = False
        self._pulses_allowed = False
        self._heard_tick = 0
        self._repeat_tick = 0
        self._stage: tuple[int, float, int] | None = None  # axis, target, arrival tick
        self._commands: dict[type, Callable[..., Outcome]] = {
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
        plant.set_generator(130.435, 304.348, 40.0, 0.12, 0.0)
        self._set_state(State.IDLE)

    # ------------------------------------------------------------------------------------------ time and bytes
    @property
    def state(self) -> State:
        """Present state."""
        return self._state

    @property
    def fault(self) -> int:
        """Latched fault, 0 = none."""
        return self._fault

    @property
    def now_s(self) -> float:
        """Controller time."""
        return float(self._ist[k.TICK]) * k.TICK_S

    @property
    def has_output(self) -> bool:
        """Whether bytes are waiting to be sent."""
        return self._port.has_output

    def take_output(self) -> bytes:
        """Hand over the bytes to be sent."""
        return self._port.take_output()

    def receive(self, data: bytes) -> None:
        """Take bytes from the line and execute the commands in them."""
        heard, aborted = self._port.receive(data)
        if heard:
            self._heard_tick = int(self._ist[k.TICK])
        if aborted:
            self._raise_fault(FaultCode.ABORT_RUN)

    def advance(self, ticks: int) -> None:
        """Let `ticks` milliseconds pass."""
        end = int(self._ist[k.TICK]) + ticks
        while (now := int(self._ist[k.TICK])) < end:
            step = min(end, self._next_deadline(now)) - now
            pulses = math.ceil(step * 1e6 / int(self._ist[k.PULSE_PERIOD])) + 1
            self.plant.random.provide(self._ist, pulses, 2 * step + 2)
            happened = k.run(
                step,
                self._par,
                self._st,
                self._ist,
                self.plant.plays,
                self.plant.creep,
                self._history,
                self.plant.random.pulse,
                self.plant.random.tables,
                self.plant.random.noise,
                self._telemetry.samples,
                self._telemetry.blocks,
                self._telemetry.pulses,
            )
            self._telemetry.send_full_frames()
            if happened:
                self._conclude(happened)
            self._watch()

    def _next_deadline(self, now: int) -> int:
        deadline = now + SLICE_TICKS
        if self._armed:
            deadline = min(deadline, self._heard_tick + self._watchdog_ticks)
        if self._stage:
            deadline = min(deadline, self._stage[2])
        if self._port.has_unacknowledged:
            deadline = min(deadline, self._repeat_tick)
        return max(deadline, now + 1)

    @property
    def _armed(self) -> bool:
        return self._state not in (State.BOOT, State.IDLE, State.FAULT, State.ESTOP)

    @property
    def _watchdog_ticks(self) -> int:
        return round(self._parameters["watchdog_s"] / k.TICK_S)

    def _watch(self) -> None:
        """Everything that is due by the clock: stage arrival, watchdog, interlocks, repetition of events."""
        now = int(self._ist[k.TICK])
        if self._stage and now >= self._stage[2]:
            axis, target, _ = self._stage
            self._stage = None
            self.plant.stage_lands(axis, target)
            self._set_state(State.ARMED)
            self._emit(EventCode.STAGE_DONE)
        if self._armed:
            if now - self._heard_tick >= self._watchdog_ticks:
                self._raise_fault(FaultCode.HOST_SILENT)
            elif open_inputs := self._interlocks():
                estop = Interlocks.ESTOP in open_inputs
                self._raise_fault(FaultCode.ESTOP if estop else FaultCode.DIELECTRIC, int(open_inputs))
        if self._port.has_unacknowledged and now >= self._repeat_tick:
            self._port.repeat_events()
            self._repeat_tick = now + EVENT_REPEAT_TICKS

    def _interlocks(self) -> Interlocks:
        plant, config = self.plant, self.plant.config
        bits = Interlocks.ESTOP if plant.estop else Interlocks(0)
        if self._parameters["dielectric_required"]:
            if not plant.dielectric_level_ok:
                bits |= Interlocks.DIELECTRIC_LEVEL
            if plant.dielectric_flow_lpm < self._parameters["flow_min_lpm"]:
                bits |= Interlocks.DIELECTRIC_FLOW
            if config.dielectric_temperature_c > self._parameters["temperature_max_c"]:
                bits |= Interlocks.DIELECTRIC_HOT
        return bits

    # ------------------------------------------------------------------------------------------ states and events
    def _set_state(self, state: State) -> None:
        self._state = state
        self._ist[k.TLM_STATE] = state

    def _emit(
        self,
        code: EventCode,
        arg: int = 0,
        z_um: float | None = None,
        v: float | None = None,
        ago_ticks: int = 0,
    ) -> None:
        self._telemetry.flush()
        event = m.Event(
            event_no=self._port.next_event_no(),
            t_us=self._time_us(ago_ticks),
            code=code,
            arg=arg,
            displacement_um=float(self._st[k.SENSOR_Z]) if z_um is None else z_um,
            actuator_v=float(self._st[k.APPLIED_V]) if v is None else v,
        )
        self._port.send_event(event)
        self._repeat_tick = int(self._ist[k.TICK]) + EVENT_REPEAT_TICKS

    def _time_us(self, ago_ticks: int = 0) -> int:
        return ((int(self._ist[k.TICK]) - ago_ticks) * 1000) & 0xFFFFFFFF

    def _conclude(self, happened: int) -> None:
        """Turn what the kernel reports into states and events."""
        if happened in _FAULTS:
            self._raise_fault(_FAULTS[happened])
        elif happened == k.RAMP_DONE:
            self._end_ramp()
        elif happened == k.TOUCHED:
            mean = float(self._st[k.TOUCH_SUM]) / max(1, int(self._ist[k.TOUCH_COUNT]))
            self._emit(
                EventCode.TOUCH,
                int(self._ist[k.TOUCH_NO]),
                mean,
                float(self._st[k.TOUCH_V]),
                int(self._ist[k.DWELL_TICKS]),
            )
        elif happened == k.JUMP_DONE:
            self._set_state(State.MACHINING if self._ist[k.JUMP_RESUMES] else State.ARMED)
            self._emit(EventCode.JUMP_DONE)
        elif happened in _AFTER:
            self._set_state(State.ARMED)
            self._emit(_AFTER[happened])

    def _end_ramp(self) -> None:
        if self._state is State.FAULT or self._state is State.ESTOP:
            return
        self._set_state(State.IDLE if self._disarming else State.ARMED)
        self._disarming = False
        self._emit(EventCode.MOVE_DONE)

    def _raise_fault(self, code: FaultCode, detail: int = 0) -> None:
        """Pulses off, retract, latch, report. The first fault stays the latched one."""
        self._start_ramp(0.0, float(self._par[k.RETRACT_SLEW]))
        if self._fault:
            return
        self._telemetry.flush()
        self._fault = code
        self._stage = None
        self._disarming = False
        self._pulses_allowed = False
        self._set_state(State.ESTOP if code is FaultCode.ESTOP else State.FAULT)
        report = m.Fault(
            event_no=self._port.next_event_no(),
            t_us=self._time_us(),
            code=code,
            detail=detail,
            displacement_um=float(self._st[k.SENSOR_Z]),
            gap_v=float(self._st[k.GAP_V]),
        )
        self._port.send_event(report)
        self._repeat_tick = int(self._ist[k.TICK]) + EVENT_REPEAT_TICKS

    def _start_ramp(self, target_v: float, slew_v_s: float) -> None:
        self._ist[k.PULSES_ON] = 0
        self._st[k.TARGET_V], self._st[k.RAMP_V_S] = target_v, slew_v_s
        self._begin(k.RAMP)

    def _begin(self, mode: int) -> None:
        self._ist[k.MODE] = mode
        self._ist[k.PHASE] = 0
        self._ist[k.LIMIT_TICKS] = 0

    def _pulses_on(self) -> None:
        ist, st = self._ist, self._st
        ist[k.PULSES_ON] = 1
        ist[k.NEXT_PULSE] = int(ist[k.TICK]) * k.TICK_NS
        ist[k.OPEN_TICKS] = ist[k.SHORT_TICKS] = ist[k.SHORTED] = ist[k.ARC_RUN] = 0
        st[k.LAST_SPARK_Z] = st[k.SLOW_Z]

    # -------------------------------------------------------------------------------------------------- commands
    def _execute(self, message: Message) -> Outcome:
        return self._commands[type(message)](message)

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
            serial=SERIAL,
            board=0,
            servo_hz=SERVO_HZ,
            tlm_max_hz=TLM_MAX_HZ,
            rx_window=1,
            boot_count=1,
            reset_cause=0,
            fault=self._fault,
            state=self._state,
        )
        return Status.OK, reply.pack()

    def _heartbeat(self, request: m.Heartbeat) -> Outcome:
        self._port.acknowledge(request.last_event)
        reply = m.HeartbeatReply(
            t_host_us=request.t_host_us,
            t_dev_us=int(self._ist[k.TICK]) * 1000,
            state=self._state,
            fault=self._fault,
            rx_bad=self._port.rx_bad & 0xFFFF,
            rx_drop=self._port.rx_drop & 0xFFFF,
        )
        return Status.OK, reply.pack()

    def _get_status(self, _: m.GetStatus) -> Outcome:
        plant = self.plant
        reply = m.GetStatusReply(
            state=self._state,
            fault=self._fault,
            interlocks=self._interlocks(),
            displacement_um=float(self._st[k.SENSOR_Z]),
            x_um=float(plant.commanded_um[0]),
            y_um=float(plant.commanded_um[1]),
            theta_deg=plant.commanded_deg,
            actuator_v=float(self._st[k.APPLIED_V]),
            gap_v=float(self._st[k.GAP_V]),
            temperature_c=plant.config.dielectric_temperature_c,
            flow_lpm=plant.dielectric_flow_lpm,
        )
        return Status.OK, reply.pack()

    def _arm(self, request: m.Arm) -> Outcome:
        if self._state is not State.IDLE:
            return Status.BAD_STATE, b""
        if request.param_crc != self._parameters.crc:
            return Status.PROFILE_MISMATCH, b""
        if open_inputs := self._interlocks():
            return Status.INTERLOCK, int(open_inputs).to_bytes(2, "little")
        self._heard_tick = int(self._ist[k.TICK])
        self._set_state(State.ARMED)
        return OK

    def _disarm(self, _: m.Disarm) -> Outcome:
        if not self._armed:
            return Status.BAD_STATE, b""
        self._stage = None
        self._pulses_allowed = False
        self._disarming = True
        self._set_state(State.MOVING)
        self._start_ramp(0.0, float(self._par[k.RETRACT_SLEW]))
        return OK

    def _clear_fault(self, request: m.ClearFault) -> Outcome:
        if self._state not in (State.FAULT, State.ESTOP):
            return Status.BAD_STATE, b""
        if request.fault != self._fault:
            return Status.OUT_OF_RANGE, b""
        if self._ist[k.MODE] != k.HOLD:
            return Status.BUSY, b""
        if self._interlocks():
            return Status.INTERLOCK, b""
        self._fault = 0
        self._set_state(State.IDLE)
        return OK

    def _set_param(self, request: m.SetParam) -> Outcome:
        if self._state is not State.IDLE:
            return Status.BAD_STATE, b""
        return OK if self._parameters.stage(request.param, request.value) else (Status.OUT_OF_RANGE, b"")

    def _get_param(self, request: m.GetParam) -> Outcome:
        value = self._parameters.wire_value(request.param)
        return (Status.OUT_OF_RANGE, b"") if value is None else (Status.OK, m.GetParamReply(value).pack())

    def _commit(self, request: m.CommitProfile) -> Outcome:
        if self._state is not State.IDLE:
            return Status.BAD_STATE, b""
        return OK if self._parameters.commit(request.crc) else (Status.PROFILE_MISMATCH, b"")

    def _piezo_set(self, request: m.PiezoSet) -> Outcome:
        if self._state is not State.ARMED:
            return Status.BAD_STATE, b""
        if request.actuator_v > self._parameters["piezo_max_v"] or request.slew_v_s <= 0.0:
            return Status.OUT_OF_RANGE, b""
        self._set_state(State.MOVING)
        self._start_ramp(request.actuator_v, request.slew_v_s)
        return OK

    def _stage_move(self, request: m.StageMove) -> Outcome:
        if self._state is not State.ARMED:
            return Status.BAD_STATE, b""
        if request.axis > m.Axis.THETA or request.speed == 0:
            return Status.OUT_OF_RANGE, b""
        if self._st[k.SLOW_Z] > self._parameters["safe_z_um"]:
            return Status.INTERLOCK, b""
        target, speed = request.target * 1e-3, request.speed * 1e-3
        travel_s = self.plant.command_stage(request.axis, target) / speed
        arrival = int(self._ist[k.TICK]) + math.ceil(travel_s / k.TICK_S) + STAGE_SETTLE_TICKS
        self._stage = (request.axis, target, arrival)
        self._set_state(State.MOVING)
        return OK

    def _approach(self, request: m.Approach) -> Outcome:
        if self._state is not State.ARMED or not self._pulses_allowed:
            return Status.BAD_STATE, b""
        st = self._st
        st[k.GAP_REF] = request.gap_ref_v
        st[k.SLOW_V_S] = self._volts(request.speed_um_s)
        st[k.START_Z] = st[k.SLOW_Z]
        st[k.Z_MAX] = request.max_travel_um
        st[k.GAP_V] = k.open_circuit_mean(self._par, self._ist)
        self._pulses_on()
        self._begin(k.APPROACH)
        self._set_state(State.APPROACH)
        return OK

    def _servo_start(self, request: m.ServoStart) -> Outcome:
        if self._state is not State.ARMED or not self._pulses_allowed:
            return Status.BAD_STATE, b""
        st, ist = self._st, self._ist
        st[k.GAP_REF] = st[k.GAP_V] = request.gap_ref_v
        st[k.Z_LIMIT] = request.z_limit_um
        st[k.RATE_V_S] = st[k.INTEGRAL] = 0.0
        ist[k.TIME_TICKS] = max(1, round(request.max_time_s / k.TICK_S))
        ist[k.SERVO_COUNT] = 0
        ist[k.DIRECTION] = 1
        self._pulses_on()
        self._begin(k.SERVO)
        self._set_state(State.MACHINING)
        return OK

    def _servo_stop(self, _: m.ServoStop) -> Outcome:
        if not self._armed or self._stage or self._disarming:
            return Status.BAD_STATE, b""
        self._stop_motion()
        return OK

    def _stop_motion(self) -> None:
        self._ist[k.PULSES_ON] = 0
        self._begin(k.HOLD)
        self._set_state(State.ARMED)
        self._emit(EventCode.STOPPED)

    def _jump(self, request: m.Jump) -> Outcome:
        resumes = self._ist[k.MODE] == k.SERVO
        if not resumes and self._state is not State.ARMED:
            return Status.BAD_STATE, b""
        if request.speed_um_s <= 0.0:
            return Status.OUT_OF_RANGE, b""
        st, ist = self._st, self._ist
        slew = min(self._volts(request.speed_um_s), self._parameters["slew_limit_v_s"])
        st[k.START_V] = st[k.COMMAND_V]
        st[k.JUMP_V] = min(self._volts(request.height_um), float(st[k.COMMAND_V]))
        st[k.CLEARANCE_V] = min(self._volts(request.clearance_um), float(st[k.JUMP_V]))
        st[k.FAST_V_S] = self._volts(self._parameters["short_back_um_s"])
        ramp_ticks = math.ceil(float(st[k.JUMP_V]) / slew / k.TICK_S)
        ist[k.PHASE_TICKS] = ramp_ticks + k.BLEND_TICKS
        ist[k.DWELL_TICKS] = max(1, round(request.dwell_s / k.TICK_S))
        ist[k.JUMP_RESUMES] = int(resumes)
        ist[k.PULSES_ON] = 0
        self._telemetry.flush()
        self._begin(k.JUMP_UP)
        self._set_state(State.JUMP)
        return OK

    def _touch_off(self, request: m.TouchOff) -> Outcome:
        if self._state is not State.ARMED:
            return Status.BAD_STATE, b""
        if request.touches == 0 or request.speed_um_s <= 0.0 or request.fast_um_s <= 0.0:
            return Status.OUT_OF_RANGE, b""
        if self._ist[k.CONTACT]:
            self._raise_fault(FaultCode.STUCK_CONTACT)
            return OK
        st, ist = self._st, self._ist
        st[k.FAST_V_S], st[k.SLOW_V_S] = self._volts(request.fast_um_s), self._volts(request.speed_um_s)
        st[k.FAST_TO], st[k.Z_MAX] = request.fast_to_um, request.z_max_um
        st[k.BACK_V] = self._volts(request.back_off_um)
        ist[k.DWELL_TICKS] = max(1, round(request.dwell_s / k.TICK_S))
        ist[k.TOUCHES_LEFT], ist[k.TOUCH_NO] = request.touches, 0
        self._begin(k.TOUCH_FAST)
        self._set_state(State.TOUCH)
        return OK

    def _pulse_config(self, request: m.PulseConfig) -> Outcome:
        if self._ist[k.PULSES_ON]:
            return Status.BAD_STATE, b""
        period_us = request.on_time_us + request.off_time_us
        if not (request.on_time_us > 0.0 and period_us >= 20.0 and request.peak_current_a > 0.0):
            return Status.OUT_OF_RANGE, b""
        isopulse = request.mode == m.PulseMode.ISOPULSE
        self.plant.set_generator(
            request.on_time_us,
            request.off_time_us,
            request.open_voltage_v,
            request.peak_current_a,
            request.discharge_us if isopulse else 0.0,
        )
        return OK

    def _pulse_enable(self, request: m.PulseEnable) -> Outcome:
        if request.on and self._state is not State.ARMED:
            return Status.BAD_STATE, b""
        self._pulses_allowed = bool(request.on)
        if not request.on and self._state in (State.APPROACH, State.MACHINING, State.JUMP):
            self._stop_motion()
        return OK

    def _tlm_start(self, request: m.TlmStart) -> Outcome:
        period_ns = request.period_us * 1000
        pulses = period_ns / int(self._ist[k.PULSE_PERIOD])
        if (
            request.period_us < 1000
            or request.period_us % 1000
            or not 1 <= request.batch <= 14
            or pulses > 255
        ):
            return Status.OUT_OF_RANGE, b""
        self._telemetry.start(request)
        return OK

    def _tlm_stop(self, _: m.TlmStop) -> Outcome:
        self._telemetry.stop()
        return OK

    def _volts(self, length_um: float) -> float:
        return length_um / float(self._par[k.UM_PER_V])
