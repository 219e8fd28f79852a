"""The virtual controller: time, states, watchdog, interlocks, faults and the safe state, as a board has them.

It owns hard real time (through the kernel), obeys EDM Link frames, and protects the machine without the host:
whatever goes wrong, pulses go off first, then the tool retracts, then everything holds and the fault is latched.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from edmctl.link import messages as m
from edmctl.link.faults import FaultCode
from edmctl.link.messages import EventCode, Interlocks, State
from edmctl.simulator import kernel as k
from edmctl.simulator.commands import Commands
from edmctl.simulator.parameters import Parameters
from edmctl.simulator.port import DevicePort
from edmctl.simulator.telemetry import SLICE_TICKS, Telemetry

if TYPE_CHECKING:
    from edmctl.simulator.plant import Plant

EVENT_REPEAT_TICKS = 100
STAGE_SETTLE_TICKS = 50
NEVER = 1 << 62

_UNARMED = (State.BOOT, State.IDLE, State.FAULT, State.ESTOP)
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


@dataclass(frozen=True, slots=True)
class StageMove:
    """An axis on its way: from where to where (µm, degrees), since when, and how long it travels."""

    axis: int
    start: float
    target: float
    start_tick: int
    travel_ticks: int

    @property
    def arrival_tick(self) -> int:
        """When the stage has come to rest."""
        return self.start_tick + self.travel_ticks + STAGE_SETTLE_TICKS


class VirtualController:
    """One controller over one plant. Feed it bytes, let time pass, take bytes."""

    def __init__(self, plant: Plant) -> None:
        self.plant = plant
        self.st, self.ist, self.par = plant.st, plant.ist, plant.par
        self.commands = Commands(self)
        self.port = DevicePort(self.commands.execute)
        self.parameters = Parameters(plant)
        self.telemetry = Telemetry(plant, self.port.send, self.step)
        self._history = np.zeros(k.HISTORY)
        self.fault = 0
        self.disarming = False
        self.pulses_allowed = False
        self.stage: StageMove | None = None
        self._heard_tick = 0
        self._repeat_tick = NEVER
        self.set_state(State.IDLE)

    # ---------------------------------------------------------------------------------------- time and bytes
    @property
    def tick(self) -> int:
        """Controller time in milliseconds."""
        tick: int = self.ist.item(k.TICK)
        return tick

    def receive(self, data: bytes) -> None:
        """Take bytes from the line and execute the commands in them."""
        heard, aborted = self.port.receive(data)
        if heard:
            self.host_heard()
        if aborted:
            self.raise_fault(FaultCode.ABORT_RUN)

    def host_heard(self) -> None:
        """Feed the watchdog."""
        self._heard_tick = self.tick

    def advance(self, ticks: int) -> None:
        """Let `ticks` milliseconds pass."""
        now = self.tick
        end = now + ticks
        while now < end:
            happened = self.step(min(end, self._next_deadline(now)) - now)
            self.telemetry.send_full_frames()
            if happened:
                self._conclude(happened)
            now = self.tick
            self._watch(now)

    def step(self, ticks: int) -> int:
        """Run the kernel for at most `ticks` ms; returns what happened, in the kernel's words."""
        plant = self.plant
        pulses = ticks * k.TICK_NS // self.ist.item(k.PULSE_PERIOD) + 2
        plant.random.provide(self.ist, pulses, 2 * ticks + 2)
        return k.run(
            ticks,
            self.par,
            self.st,
            self.ist,
            plant.plays,
            plant.creep,
            self._history,
            plant.random.pulse,
            plant.random.tables,
            plant.random.noise,
            self.telemetry.samples,
            self.telemetry.blocks,
            self.telemetry.pulses,
        )

    def _next_deadline(self, now: int) -> int:
        deadline = min(now + SLICE_TICKS, self._repeat_tick)
        if self.armed:
            deadline = min(deadline, self._heard_tick + self.parameters.watchdog_ticks)
        if self.stage:
            deadline = min(deadline, self.stage.arrival_tick)
        return max(deadline, now + 1)

    def _watch(self, now: int) -> None:
        """Everything that is due by the clock: stage arrival, watchdog, interlocks, repetition of events."""
        if self.stage and now >= self.stage.arrival_tick:
            self.stop_stage()
            self.set_state(State.ARMED)
            self.emit(EventCode.STAGE_DONE)
        if self.armed:
            if now - self._heard_tick >= self.parameters.watchdog_ticks:
                self.raise_fault(FaultCode.HOST_SILENT)
            elif opened := self.open_interlocks():
                code = FaultCode.ESTOP if opened & Interlocks.ESTOP else FaultCode.DIELECTRIC
                self.raise_fault(code, opened)
        if now >= self._repeat_tick:
            self._repeat_tick = now + EVENT_REPEAT_TICKS if self.port.repeat_events() else NEVER

    def open_interlocks(self) -> int:
        """Interlocks bits of the inputs that forbid machining now."""
        plant, parameters = self.plant, self.parameters
        bits = int(Interlocks.ESTOP) if plant.estop else 0
        if parameters.dielectric_required:
            if not plant.dielectric_level_ok:
                bits |= Interlocks.DIELECTRIC_LEVEL
            if plant.dielectric_flow_lpm < parameters.flow_min_lpm:
                bits |= Interlocks.DIELECTRIC_FLOW
            if plant.dielectric_temperature_c > parameters.temperature_max_c:
                bits |= Interlocks.DIELECTRIC_HOT
        return bits

    # ------------------------------------------------------------------------------------- states and events
    def set_state(self, state: State) -> None:
        """Enter a state; the watchdog runs and the interlocks count while it is an armed one."""
        self.state = state
        self.armed = state not in _UNARMED
        self.ist[k.TLM_STATE] = state

    def emit(
        self,
        code: EventCode,
        arg: int = 0,
        z_um: float | None = None,
        v: float | None = None,
        ago_ticks: int = 0,
    ) -> None:
        """Report an event, after the telemetry up to it."""
        self.telemetry.flush()
        event = m.Event(
            event_no=self.port.next_event_no(),
            t_us=self._time_us(ago_ticks),
            code=code,
            arg=arg,
            displacement_um=self.st.item(k.SENSOR_Z) if z_um is None else z_um,
            actuator_v=self.st.item(k.APPLIED_V) if v is None else v,
        )
        self.port.send_event(event)
        self._repeat_tick = self.tick + EVENT_REPEAT_TICKS

    def _time_us(self, ago_ticks: int = 0) -> int:
        return ((self.tick - ago_ticks) * 1000) & 0xFFFFFFFF

    def _conclude(self, happened: int) -> None:
        """Turn what the kernel reports into states and events."""
        if happened in _FAULTS:
            self.raise_fault(_FAULTS[happened])
        elif happened == k.RAMP_DONE:
            self._end_ramp()
        elif happened == k.TOUCHED:
            mean = self.st.item(k.TOUCH_SUM) / max(1, self.ist.item(k.TOUCH_COUNT))
            number, dwell = self.ist.item(k.TOUCH_NO), self.ist.item(k.DWELL_TICKS)
            self.emit(EventCode.TOUCH, number, mean, self.st.item(k.TOUCH_V), dwell)
        elif happened == k.JUMP_DONE:
            self.set_state(State.MACHINING if self.ist[k.JUMP_RESUMES] else State.ARMED)
            self.emit(EventCode.JUMP_DONE)
        elif happened in _AFTER:
            self.set_state(State.ARMED)
            self.emit(_AFTER[happened])

    def _end_ramp(self) -> None:
        if self.fault:
            return
        self.set_state(State.IDLE if self.disarming else State.ARMED)
        self.disarming = False
        self.emit(EventCode.MOVE_DONE)

    def raise_fault(self, code: FaultCode, detail: int = 0) -> None:
        """Pulses off, retract, latch, report. The first fault stays the latched one."""
        self.start_ramp(0.0, self.parameters.retract_v_s)
        if self.fault:
            return
        self.telemetry.flush()
        self.fault = int(code)
        self.stop_stage()
        self.disarming = False
        self.pulses_allowed = False
        self.set_state(State.ESTOP if code is FaultCode.ESTOP else State.FAULT)
        report = m.Fault(
            event_no=self.port.next_event_no(),
            t_us=self._time_us(),
            code=code,
            detail=detail,
            displacement_um=self.st.item(k.SENSOR_Z),
            gap_v=self.st.item(k.GAP_V),
        )
        self.port.send_event(report)
        self._repeat_tick = self.tick + EVENT_REPEAT_TICKS

    def start_ramp(self, target_v: float, slew_v_s: float) -> None:
        """Pulses off, then ramp the actuator."""
        self.ist[k.PULSES_ON] = 0
        self.st[k.TARGET_V], self.st[k.RAMP_V_S] = target_v, slew_v_s
        self.begin(k.RAMP)

    def start_stage(self, axis: int, target: float, speed: float) -> None:
        """Let an axis travel (µm and µm/s, degrees and degrees/s) and come to rest."""
        start = self.plant.reported[axis]
        travel_ticks = math.ceil(abs(target - start) / speed / k.TICK_S)
        self.stage = StageMove(axis, start, target, self.tick, travel_ticks)

    def stop_stage(self) -> None:
        """End a stage move where the stage is now."""
        if self.stage is None:
            return
        move, self.stage = self.stage, None
        share = min(1.0, (self.tick - move.start_tick) / max(1, move.travel_ticks))
        self.plant.stage_lands(move.axis, move.start + share * (move.target - move.start))

    def stop_motion(self) -> None:
        """Pulses off, hold the tool where it is."""
        self.ist[k.PULSES_ON] = 0
        self.begin(k.HOLD)
        self.set_state(State.ARMED)
        self.emit(EventCode.STOPPED)

    def begin(self, mode: int) -> None:
        """Let the kernel begin a motion."""
        self.ist[k.MODE] = mode
        self.ist[k.PHASE] = 0
        self.ist[k.LIMIT_TICKS] = 0

    def pulses_on(self) -> None:
        """Switch the generator on, with fresh counters of what would stop it."""
        ist, st = self.ist, self.st
        ist[k.PULSES_ON] = 1
        ist[k.NEXT_PULSE] = self.tick * k.TICK_NS
        ist[k.OPEN_TICKS] = ist[k.SHORT_TICKS] = ist[k.SHORTED] = ist[k.ARC_RUN] = 0
        st[k.LAST_SPARK_Z] = st[k.SLOW_Z]
