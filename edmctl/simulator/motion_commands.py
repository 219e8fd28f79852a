"""Commands of the virtual controller that move the tool or a stage, or let pulses flow."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from edmctl.link import messages as m
from edmctl.link.faults import FaultCode
from edmctl.link.messages import State, Status
from edmctl.simulator import kernel as k
from edmctl.simulator.injection import Trigger

if TYPE_CHECKING:
    from collections.abc import Callable

    from edmctl.simulator.controller import VirtualController
    from edmctl.simulator.port import Outcome

# What the virtual generator can do.
PERIOD_US_MIN, PERIOD_US_MAX = 20.0, 1e6
OPEN_V_MAX, CURRENT_A_MAX = 300.0, 10.0
MOST_BELOW_ZERO_UM, MOST_ABOVE_ZERO_UM = 5.0, 25.0
"""A tool at rest at 0 V reads no further from its home: noise and drift since the host looked are below 1 µm, and
after a deep cut creep holds it up to 20 µm lower for a while. Another zero is a mistake of the host."""
OK: Outcome = (Status.OK, b"")


class MotionCommands:
    """Checks and begins motions; their ends are events."""

    def __init__(self, controller: VirtualController) -> None:
        self._c = controller
        self.handlers: dict[type, Callable[..., Outcome]] = {
            m.PiezoSet: self._piezo_set,
            m.StageMove: self._stage_move,
            m.StageStop: self._stage_stop,
            m.SetZero: self._set_zero,
            m.Approach: self._approach,
            m.ServoStart: self._servo_start,
            m.ScanStart: self._scan_start,
            m.PathMove: self._path_move,
            m.ServoStop: self._servo_stop,
            m.Jump: self._jump,
            m.TouchOff: self._touch_off,
            m.SelfTest: self._self_test,
            m.PulseConfig: self._pulse_config,
            m.PulseEnable: self._pulse_enable,
        }

    def _piezo_set(self, request: m.PiezoSet) -> Outcome:
        if self._c.state is not State.ARMED:
            return Status.BAD_STATE, b""
        if request.actuator_v > self._c.parameters["piezo_max_v"] or request.slew_v_s <= 0.0:
            return Status.OUT_OF_RANGE, b""
        self._c.set_state(State.MOVING)
        self._c.motion.start_ramp(request.actuator_v, request.slew_v_s)
        return OK

    def _stage_move(self, request: m.StageMove) -> Outcome:
        if self._c.state is not State.ARMED:
            return Status.BAD_STATE, b""
        if request.axis > m.Axis.THETA or request.speed == 0:
            return Status.OUT_OF_RANGE, b""
        if self._c.st[k.SLOW_Z] - self._c.zero_um > self._c.parameters["safe_z_um"]:
            return Status.INTERLOCK, b""
        self._c.motion.start_stage(request.axis, request.target * 1e-3, request.speed * 1e-3)
        self._c.set_state(State.MOVING)
        return OK

    def _stage_stop(self, _: m.StageStop) -> Outcome:
        if self._c.motion.stage is None:
            return Status.BAD_STATE, b""
        self._c.motion.stop_stage()
        self._c.stop_motion()
        return OK

    def _set_zero(self, request: m.SetZero) -> Outcome:
        if not self._armed_at_rest():
            return Status.BAD_STATE, b""
        above_um = self._c.st.item(k.SLOW_Z) - request.zero_um
        if not -MOST_BELOW_ZERO_UM <= above_um <= MOST_ABOVE_ZERO_UM:
            return Status.OUT_OF_RANGE, b""
        self._c.zero_um = request.zero_um
        return OK

    def _armed_at_rest(self) -> bool:
        at_rest = self._c.ist[k.MODE] == k.HOLD and self._c.st[k.COMMAND_V] == 0.0
        return self._c.state is State.ARMED and bool(at_rest)

    def _approach(self, request: m.Approach) -> Outcome:
        if self._c.state is not State.ARMED or not self._c.pulses_allowed:
            return Status.BAD_STATE, b""
        if request.speed_um_s <= 0.0:
            return Status.OUT_OF_RANGE, b""
        st = self._c.st
        st[k.GAP_REF] = request.gap_ref_v
        st[k.SLOW_V_S] = self._c.motion.volts(request.speed_um_s)
        st[k.START_Z] = st[k.SLOW_Z]
        st[k.Z_MAX] = request.max_travel_um
        st[k.GAP_V] = self._c.par[k.DUTY_V]
        self._c.motion.pulses_on()
        self._c.motion.begin(k.APPROACH)
        self._c.set_state(State.APPROACH)
        return OK

    def _servo_start(self, request: m.ServoStart | m.ScanStart) -> Outcome:
        if self._c.state is not State.ARMED or not self._c.pulses_allowed:
            return Status.BAD_STATE, b""
        st, ist = self._c.st, self._c.ist
        st[k.GAP_REF] = st[k.GAP_V] = request.gap_ref_v
        st[k.Z_LIMIT] = request.z_limit_um
        st[k.RATE_V_S] = st[k.INTEGRAL] = 0.0
        ist[k.TIME_TICKS] = max(1, round(request.max_time_s / k.TICK_S))
        ist[k.SERVO_COUNT] = 0
        ist[k.DIRECTION] = 1
        self._c.motion.pulses_on()
        self._c.motion.begin(k.SERVO)
        self._c.set_state(State.MACHINING)
        return OK

    def _scan_start(self, request: m.ScanStart) -> Outcome:
        outcome = self._servo_start(request)
        if outcome == OK:
            self._c.motion.start_scan()
        return outcome

    def _path_move(self, request: m.PathMove) -> Outcome:
        motion = self._c.motion
        scanning = self._c.state is State.MACHINING and self._c.ist[k.SCANNING]
        if not scanning or motion.path_ends:
            return Status.BAD_STATE, b""
        if request.speed_um_s <= 0.0:
            return Status.OUT_OF_RANGE, b""
        line = (request.x_um, request.y_um, request.speed_um_s, request.z_limit_um, bool(request.last))
        return OK if motion.append_line(*line) else (Status.BUSY, b"")

    def _servo_stop(self, _: m.ServoStop) -> Outcome:
        if not self._c.armed or self._c.motion.stage or self._c.disarming:
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
        slew = min(self._c.motion.volts(request.speed_um_s), self._c.parameters["slew_limit_v_s"])
        st[k.START_V] = st[k.COMMAND_V]
        st[k.JUMP_V] = min(self._c.motion.volts(request.height_um), float(st[k.COMMAND_V]))
        st[k.CLEARANCE_V] = min(self._c.motion.volts(request.clearance_um), float(st[k.JUMP_V]))
        st[k.FAST_V_S] = self._c.motion.volts(self._c.parameters["short_back_um_s"])
        ramp_ticks = math.ceil(float(st[k.JUMP_V]) / slew / k.TICK_S)
        ist[k.PHASE_TICKS] = ramp_ticks + k.BLEND_TICKS
        ist[k.DWELL_TICKS] = max(1, round(request.dwell_s / k.TICK_S))
        ist[k.JUMP_RESUMES] = int(resumes)
        ist[k.PULSES_ON] = 0
        self._c.telemetry.flush()
        self._c.motion.begin(k.JUMP_UP)
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
        st[k.FAST_V_S], st[k.SLOW_V_S] = (
            self._c.motion.volts(request.fast_um_s),
            self._c.motion.volts(request.speed_um_s),
        )
        st[k.FAST_TO], st[k.Z_MAX] = request.fast_to_um, request.z_max_um
        st[k.BACK_V] = self._c.motion.volts(request.back_off_um)
        ist[k.DWELL_TICKS] = max(1, round(request.dwell_s / k.TICK_S))
        ist[k.TOUCHES_LEFT], ist[k.TOUCH_NO] = request.touches, 0
        self._c.motion.begin(k.TOUCH_FAST)
        self._c.set_state(State.TOUCH)
        self._c.injector.note(Trigger.TOUCH)
        return OK

    def _self_test(self, _: m.SelfTest) -> Outcome:
        if not self._armed_at_rest() or not self._c.pulses_allowed:
            return Status.BAD_STATE, b""
        self._c.motion.start_test()
        self._c.set_state(State.APPROACH)
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
        self._c.waveforms.forget()  # they were made with the setting before
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
