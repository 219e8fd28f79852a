"""Commands of the virtual controller that move the tool or a stage, or let pulses flow."""

from __future__ import annotations

import math
from collections.abc import Callable

from edmctl.link import messages as m
from edmctl.link.faults import FaultCode
from edmctl.link.messages import State, Status
from edmctl.simulator.controller import VirtualController
from edmctl.simulator.controller_state import APPROACH, HOLD, JUMP_UP, SERVO, TOUCH_FAST
from edmctl.simulator.injection import Trigger
from edmctl.simulator.link_endpoint import OK, Outcome
from edmctl.simulator.plant_interface import TICK_S
from edmctl.simulator.servo import BLEND_TICKS

# What the virtual generator can do.
PERIOD_NS_MIN, PERIOD_NS_MAX = 20_000, 1_000_000_000
OPEN_V_MAX, CURRENT_A_MAX = 300.0, 10.0
MOST_BELOW_ZERO_UM, MOST_ABOVE_ZERO_UM = 5.0, 25.0
"""A tool at rest at 0 V reads no further from its home: noise and drift since the host looked are below 1 µm, and
after a deep cut creep holds it up to 20 µm lower for a while. Another zero is a mistake of the host."""


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
        if self._c.plant.readings.contact and request.actuator_v > self._c.plant.drive.actuator_v:
            self._c.raise_fault(FaultCode.COLLISION)
            return OK
        self._c.set_state(State.MOVING)
        self._c.motion.start_ramp(request.actuator_v, request.slew_v_s)
        return OK

    def _stage_move(self, request: m.StageMove) -> Outcome:
        if self._c.state is not State.ARMED:
            return Status.BAD_STATE, b""
        if request.axis > m.Axis.THETA or request.speed == 0:
            return Status.OUT_OF_RANGE, b""
        if self._c.loop.slow_displacement_um - self._c.zero_um > self._c.parameters["safe_z_um"]:
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
        above_um = self._c.loop.slow_displacement_um - request.zero_um
        if not -MOST_BELOW_ZERO_UM <= above_um <= MOST_ABOVE_ZERO_UM:
            return Status.OUT_OF_RANGE, b""
        self._c.zero_um = request.zero_um
        return OK

    def _armed_at_rest(self) -> bool:
        at_rest = self._c.loop.mode == HOLD and self._c.loop.command_v == 0.0
        return self._c.state is State.ARMED and bool(at_rest)

    def _approach(self, request: m.Approach) -> Outcome:
        if self._c.state is not State.ARMED or not self._c.pulses_allowed:
            return Status.BAD_STATE, b""
        if request.speed_um_s <= 0.0 or request.gap_ref_v <= 0.0:
            return Status.OUT_OF_RANGE, b""
        loop = self._c.loop
        loop.gap_ref_v = request.gap_ref_v
        loop.slow_v_s = self._c.motion.volts(request.speed_um_s)
        loop.start_z_um = self._c.motion.place_um
        loop.z_max_um = request.max_travel_um
        loop.gap_v = self._c.settings.duty_v
        self._c.motion.pulses_on()
        self._c.motion.begin(APPROACH)
        self._c.set_state(State.APPROACH)
        return OK

    def _servo_start(self, request: m.ServoStart | m.ScanStart) -> Outcome:
        if self._c.state is not State.ARMED or not self._c.pulses_allowed:
            return Status.BAD_STATE, b""
        loop = self._c.loop
        loop.gap_ref_v = loop.gap_v = request.gap_ref_v
        loop.z_limit_um = request.z_limit_um
        loop.rate_v_s = loop.integral_um_s = 0.0
        loop.time_ticks = max(1, round(request.max_time_s / TICK_S))
        loop.servo_count = 0
        loop.direction = 1
        self._c.motion.pulses_on()
        self._c.motion.begin(SERVO)
        self._c.set_state(State.MACHINING)
        return OK

    def _scan_start(self, request: m.ScanStart) -> Outcome:
        outcome = self._servo_start(request)
        if outcome == OK:
            self._c.motion.start_scan()
        return outcome

    def _path_move(self, request: m.PathMove) -> Outcome:
        motion = self._c.motion
        scanning = self._c.state is State.MACHINING and self._c.loop.scanning
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
        resumes = self._c.loop.mode == SERVO
        if not resumes and self._c.state is not State.ARMED:
            return Status.BAD_STATE, b""
        if request.speed_um_s <= 0.0:
            return Status.OUT_OF_RANGE, b""
        loop = self._c.loop
        slew = min(self._c.motion.volts(request.speed_um_s), self._c.parameters["slew_limit_v_s"])
        loop.start_v = loop.command_v
        loop.jump_v = min(self._c.motion.volts(request.height_um), loop.command_v)
        loop.clearance_v = min(self._c.motion.volts(request.clearance_um), loop.jump_v)
        loop.fast_v_s = self._c.motion.volts(self._c.parameters["short_back_um_s"])
        ramp_ticks = math.ceil(loop.jump_v / slew / TICK_S)
        loop.phase_ticks = ramp_ticks + BLEND_TICKS
        loop.dwell_ticks = max(1, round(request.dwell_s / TICK_S))
        loop.jump_resumes = int(resumes)
        self._c.plant.drive.pulses_on = 0
        self._c.telemetry.flush()
        self._c.motion.begin(JUMP_UP)
        self._c.set_state(State.JUMP)
        return OK

    def _touch_off(self, request: m.TouchOff) -> Outcome:
        if self._c.state is not State.ARMED:
            return Status.BAD_STATE, b""
        if request.touches == 0 or request.speed_um_s <= 0.0 or request.fast_um_s <= 0.0:
            return Status.OUT_OF_RANGE, b""
        if self._c.plant.readings.contact:
            self._c.raise_fault(FaultCode.STUCK_CONTACT)
            return OK
        loop = self._c.loop
        loop.fast_v_s, loop.slow_v_s = (
            self._c.motion.volts(request.fast_um_s),
            self._c.motion.volts(request.speed_um_s),
        )
        loop.fast_to_um, loop.z_max_um = request.fast_to_um, request.z_max_um
        loop.back_v = self._c.motion.volts(request.back_off_um)
        loop.dwell_ticks = max(1, round(request.dwell_s / TICK_S))
        loop.touches_left, loop.touch_no = request.touches, 0
        self._c.motion.begin(TOUCH_FAST)
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
        isopulse = request.mode == m.PulseMode.ISOPULSE
        period_ns = round(request.on_time_us * 1000.0) + round(request.off_time_us * 1000.0)
        times_fit = request.on_time_us > 0.0 and PERIOD_NS_MIN <= period_ns <= PERIOD_NS_MAX
        mode_fits = request.mode <= m.PulseMode.ISOPULSE and (request.discharge_us > 0.0 or not isopulse)
        supply_fits = (
            0.0 < request.open_voltage_v <= OPEN_V_MAX and 0.0 < request.peak_current_a <= CURRENT_A_MAX
        )
        if not (times_fit and mode_fits and supply_fits):
            return Status.OUT_OF_RANGE, b""
        self._c.waveforms.forget()  # they were made with the setting before
        self._c.set_generator(
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
