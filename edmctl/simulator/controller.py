"""The virtual controller: time, states, watchdog, faults and the safe state, as a board has them.

It owns hard real time (through the kernel), obeys EDM Link frames, and protects the machine without the host:
whatever goes wrong, pulses go off first, then the tool retracts, then everything holds and the fault is latched.
"""

from __future__ import annotations

from collections.abc import Callable

from edmctl.link import messages as m
from edmctl.link.faults import FaultCode
from edmctl.link.messages import EventCode, Interlocks, State
from edmctl.link.wire import saturated
from edmctl.simulator import controller_state as k
from edmctl.simulator.controller_state import LoopState, Settings
from edmctl.simulator.fault_recorder import BlackBox, Waveforms
from edmctl.simulator.guards import KERNEL_FAULTS, Guards, input_fault
from edmctl.simulator.injector import Injector
from edmctl.simulator.kernel import LOOK, run
from edmctl.simulator.link_endpoint import Executor, HostWait, LinkEndpoint
from edmctl.simulator.motion import Motion
from edmctl.simulator.parameters import Parameters
from edmctl.simulator.plant import USUAL_PULSES, Plant
from edmctl.simulator.plant_interface import TICK_NS
from edmctl.simulator.telemetry import SLICE_TICKS, Telemetry

EVENT_REPEAT_TICKS = 100
NEVER = 1 << 62

_UNARMED = (State.BOOT, State.IDLE, State.FAULT, State.ESTOP)
_AFTER = {
    k.SPARK_FOUND: EventCode.APPROACH_DONE,
    k.CUT_DONE: EventCode.CUT_DONE,
    k.TIME_UP: EventCode.TIME_UP,
    k.TOUCHES_DONE: EventCode.TOUCH_DONE,
    k.PATH_DONE: EventCode.PATH_DONE,
}
_BY_ITSELF = (m.ResetCause.WATCHDOG, m.ResetCause.BROWN_OUT)


class VirtualController:
    """One controller over one plant. Feed it bytes, let time pass, take bytes.

    commands : makes what executes the commands of the line.
    host_time_scale : controller seconds per second of the host. What watches the host counts by the host's time.
    board : kind of board that it says to be, 0 = virtual. baud : of the line, 0 where it has none.
    zero_um : displacement that `safe_z_um` counts from, told by the host since it armed.
    """

    def __init__(self, plant: Plant, commands: Callable[[VirtualController], Executor]) -> None:
        self.plant = plant
        self.settings, self.loop = Settings(), LoopState()
        self.commands = commands(self)
        self.link = LinkEndpoint(self.commands.execute, self.host_heard, self._host_came)
        self.parameters = Parameters(self.settings)
        self.motion = Motion(plant, self.settings, self.loop)
        self.guards = Guards(plant, self.parameters)
        self.black_box = BlackBox()
        self.waveforms = Waveforms(plant)
        self.telemetry = Telemetry(self.settings, self.loop, plant.readings, self.link.send, self.step)
        self.injector = Injector(self)
        self.host_wait = HostWait(self.link, self.advance)
        self.boot_count = 1
        self.boot_tick = 0
        self.reset_cause = m.ResetCause.POWER_ON
        self.baud = self.board = 0
        self.host_time_scale = 1.0
        self.fault = 0
        self.zero_um = 0.0
        self.disarming = self.pulses_allowed = False
        self._heard_tick = 0
        self._repeat_tick = NEVER
        self.set_generator(*USUAL_PULSES)
        self.set_state(State.IDLE)

    def set_generator(
        self, on_time_us: float, off_time_us: float, open_v: float, peak_a: float, set_us: float
    ) -> None:
        """Set the pulse generator: times, open voltage, peak current, discharge time (0: as the pulse comes)."""
        plant, settings = self.plant, self.settings
        plant.set_generator(on_time_us, off_time_us, open_v, peak_a, set_us)
        settings.open_v, settings.nominal_siemens = open_v, plant.unit.nominal_siemens
        settings.pulse_period_ns = plant.unit.pulse_period_ns
        settings.duty_v = open_v * on_time_us / (on_time_us + off_time_us)
        settings.per_duty_v = 1.0 / settings.duty_v

    def count_from(self, time_us: int, event_no: int, boot_count: int, frames: int, pulse_no: int) -> None:
        """Let every counter of the link stand where it does after a long time, as tests of its wrap need it.

        `frames` are those of telemetry, and those that came damaged and for other sessions.
        """
        self.boot_tick = self.tick - time_us // 1000
        self.telemetry.count_from(self.boot_tick, frames)
        self.link.count_from(event_no, frames, frames)
        self.boot_count = boot_count
        self.loop.pulse_no = pulse_no

    @property
    def tick(self) -> int:
        """Milliseconds since the machine was set up; resets do not touch them."""
        return self.plant.readings.tick

    @property
    def time_us(self) -> int:
        """Controller time: µs since its start."""
        return (self.tick - self.boot_tick) * 1000

    def receive(self, data: bytes) -> None:
        """Take bytes from the line and execute the commands in them."""
        for part in self.link.up_to_aborts(data):
            if self.link.receive(part):
                self.raise_fault(FaultCode.ABORT_RUN)
        if self.guards.too_noisy(self.link.rx_bad, self.tick, self.armed, self.host_time_scale):
            self.raise_fault(FaultCode.LINE_NOISE, self.parameters.bad_frames)
        if self.link.reboots:
            self.reset(m.ResetCause.COMMANDED)

    def host_heard(self) -> None:
        """Feed the watchdog."""
        self._heard_tick = self.tick

    def _host_came(self) -> None:
        """A session has opened: what another host left running has nobody who watches it any more."""
        self.telemetry.forget()  # it was the former host's
        self.host_heard()
        if self.armed and not self.disarming:
            self.raise_fault(FaultCode.HOST_SILENT)

    def advance(self, ticks: int) -> None:
        """Let `ticks` milliseconds pass."""
        now = self.tick
        end = now + ticks
        while now < end:
            happened = self.step(min(end, self._next_deadline(now)) - now)
            self.telemetry.send_full_frames()
            self.motion.follow_stages()
            if happened:
                self._conclude(happened)
            now = self.tick
            self._watch(now)

    def step(self, ticks: int) -> int:
        """Run the kernel for at most `ticks` ms; returns what happened, in the kernel's words."""
        plant = self.plant
        pulses = ticks * TICK_NS // self.settings.pulse_period_ns + 2
        plant.random.provide(plant.state, pulses, 2 * ticks + 2)
        return run(
            ticks,
            *plant.shared,
            self.settings.shared,
            self.loop.shared,
            self.black_box.ring,
            self.telemetry.samples,
            self.telemetry.blocks,
            self.telemetry.pulses,
        )

    @property
    def _watchdog_ticks(self) -> int:
        return round(self.parameters.watchdog_ticks * self.host_time_scale)

    def _repeat_later(self) -> None:
        self._repeat_tick = self.tick + round(EVENT_REPEAT_TICKS * self.host_time_scale)

    def _next_deadline(self, now: int) -> int:
        deadline = min(now + SLICE_TICKS, self._repeat_tick, self.injector.next_tick(now))
        deadline = min(deadline, self.plant.chips.next_tick(now) or NEVER)
        if self.armed:
            deadline = min(deadline, self._heard_tick + self._watchdog_ticks)
        if self.motion.stage:
            deadline = min(deadline, self.motion.stage.arrival_tick)
        return max(deadline, now + 1)

    def _watch(self, now: int) -> None:
        """Everything that is due by the clock: stage arrival, watchdog, inputs, repetition of events."""
        self.injector.apply_due(now)
        self.plant.chips.look()
        stage = self.motion.stage
        if self.plant.inputs().limit_switch and (stage or self.motion.stages_follow):
            self.raise_fault(FaultCode.STAGE_LIMIT, stage.axis if stage else m.Axis.X)
        elif stage and now >= stage.arrival_tick:
            self.motion.stop_stage()
            self.set_state(State.ARMED)
            self.emit(EventCode.STAGE_DONE)
        opened = self.guards.open_interlocks()
        if opened & Interlocks.ESTOP and self.state is not State.ESTOP:
            self.raise_fault(FaultCode.ESTOP, opened)
        elif opened and self.armed:
            self.raise_fault(input_fault(opened), opened)
        elif self.armed and now - self._heard_tick >= self._watchdog_ticks:
            self.raise_fault(FaultCode.HOST_SILENT)
        if now >= self._repeat_tick:
            if self.link.repeat_events():
                self._repeat_later()
            else:
                self._repeat_tick = NEVER

    def set_state(self, state: State) -> None:
        """Enter a state; the watchdog runs, inputs and monitors count while it is an armed one."""
        self.state = state
        self.armed = state not in _UNARMED
        self.loop.link_state = state
        self.loop.watched = int(self.armed)

    def emit(
        self,
        code: EventCode,
        arg: int = 0,
        z_um: float | None = None,
        v: float | None = None,
        ago_ticks: int = 0,
    ) -> None:
        """Report an event, after the telemetry up to it.

        A host that lets so many of them wait that there is no place for it is one that does not listen.
        """
        if not self.link.takes_events:
            self.raise_fault(FaultCode.HOST_SILENT, code)
            return
        self.telemetry.flush()
        event = m.Event(
            event_no=self.link.next_event_no(),
            t_us=self.time_us - ago_ticks * 1000 & 0xFFFFFFFF,
            code=code,
            arg=arg,
            displacement_um=self.loop.displacement_um if z_um is None else z_um,
            actuator_v=self.plant.drive.actuator_v if v is None else v,
        )
        self.link.send_event(saturated(event))
        self._repeat_later()

    def _conclude(self, happened: int) -> None:
        """Turn what the kernel reports into states and events."""
        if happened in KERNEL_FAULTS:
            self.raise_fault(KERNEL_FAULTS[happened])
        elif happened == LOOK:
            self.plant.look()
        elif happened == k.RAMP_DONE:
            self._end_ramp()
        elif happened == k.TOUCHED:
            mean = self.loop.touch_sum / max(1, self.loop.touch_count)
            number, dwell = self.loop.touch_no, self.loop.dwell_ticks
            self.emit(EventCode.TOUCH, number, mean, self.loop.touch_v, dwell)
        elif happened == k.JUMP_DONE:
            self.set_state(State.MACHINING if self.loop.jump_resumes else State.ARMED)
            self.emit(EventCode.JUMP_DONE)
        elif happened == k.TESTED:
            self._end_test()
        elif happened in _AFTER:
            self.set_state(State.ARMED)
            self.emit(_AFTER[happened])

    def _end_ramp(self) -> None:
        if self.state is State.BOOT:
            self.set_state(State.IDLE)
        elif not self.fault:
            self.set_state(State.IDLE if self.disarming else State.ARMED)
            self.disarming = False
            self.emit(EventCode.MOVE_DONE)

    def _end_test(self) -> None:
        off_v = self.loop.test_off_v
        on_v = self.loop.touch_sum / max(1, self.loop.touch_count)
        duty_v = self.settings.duty_v
        error_v = self.parameters.test_error * duty_v
        if not (abs(off_v) <= error_v and abs(on_v - duty_v) <= error_v):
            self.raise_fault(FaultCode.GAP_SENSOR, round(1000.0 * on_v))
            return
        self.set_state(State.ARMED)
        self.emit(EventCode.TEST_DONE, round(1000.0 * on_v))

    def raise_fault(self, code: FaultCode, detail: int = 0) -> None:
        """Pulses off, retract, latch, report. The first fault stays the latched one, but for an emergency stop."""
        self.motion.start_ramp(0.0, self.parameters.retract_v_s)
        if self.fault and (code is not FaultCode.ESTOP or self.fault == FaultCode.ESTOP):
            return
        self.telemetry.flush()
        self._freeze()
        self.fault = int(code)
        self.motion.stop_stage()
        self.disarming = self.pulses_allowed = False
        self.set_state(State.ESTOP if code is FaultCode.ESTOP else State.FAULT)
        report = m.Fault(
            event_no=self.link.next_event_no(),
            t_us=self.time_us & 0xFFFFFFFF,
            code=code,
            detail=detail,
            displacement_um=self.loop.displacement_um,
            gap_v=self.loop.gap_v,
        )
        self.link.send_event(saturated(report))
        self._repeat_later()

    def _freeze(self) -> None:
        """Keep what is known of the time before a fault."""
        self.black_box.freeze(self.tick, self.boot_tick)
        self.waveforms.freeze(self.tick, self.boot_tick)

    def clear_fault(self) -> None:
        """Leave FAULT or ESTOP for IDLE."""
        self.fault = 0
        self.black_box.thaw(self.tick)
        self.waveforms.thaw()
        self.set_state(State.IDLE)

    def stop_motion(self) -> None:
        """Pulses off, hold the tool where it is."""
        self.motion.hold()
        self.set_state(State.ARMED)
        self.emit(EventCode.STOPPED)

    def reset(self, cause: m.ResetCause) -> None:
        """Start anew: no session, default parameters, pulses off, tool retracting. A latched fault outlives it."""
        self.telemetry.restart()
        self.link.restart()
        self.guards.restart()
        self.parameters.reset()
        self.plant.look()  # so that a bench that is restored from here goes on bit for bit
        if cause is m.ResetCause.POWER_ON:  # the converter has come back at 0 V
            self.loop.command_v = self.plant.drive.actuator_v = 0.0
        self.motion.start_ramp(0.0, self.parameters.retract_v_s)
        self.motion.stop_stage()
        self.disarming = self.pulses_allowed = False
        if not self.fault and cause in _BY_ITSELF:
            self._freeze()
            self.fault = int(FaultCode.RESET)
        self.waveforms.forget()
        self.boot_count = (self.boot_count + 1) & 0xFFFFFFFF
        self.boot_tick = self.tick
        self.reset_cause = cause
        self._repeat_tick = NEVER
        at_rest = self.loop.command_v == 0.0
        if self.fault:
            self.set_state(State.ESTOP if self.fault == FaultCode.ESTOP else State.FAULT)
        else:
            self.set_state(State.IDLE if at_rest else State.BOOT)
        if at_rest:
            self.motion.hold()
        self.link.send(m.Boot(cause, self.boot_count))
