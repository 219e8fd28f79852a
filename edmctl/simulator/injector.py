"""Breaks the virtual machine at the tick asked for, and repairs it."""

from __future__ import annotations

import math
from typing import Any

from edmctl.core.library import PACK
from edmctl.dataclasses import dataclass
from edmctl.link.messages import ResetCause, State
from edmctl.simulator.injection import CHIPS, Injection, LineState, Trigger
from edmctl.simulator.plant_interface import TICK_S
from edmctl.simulator.plant_state import STUCK_AT_CONTACT, STUCK_AT_GENERATOR

NEVER = 1 << 62
LOOK_TICKS = 10
"""An injection that waits for sparks looks this often whether the servo runs, ms."""
HUGE = 1e12
MONITOR_HIGH_V = 160.0
STROKE_LEFT = 0.5
TOOL_LOST_UM = 1e4
OBSTACLE_UM = 20.0
LEAK_A = 0.05
CURRENT_FACTOR = 3.0
HOT_C = 60.0
NOISE_SHARE = 0.5
DRIFT_UM_S = 5.0
WEAR_FACTOR = 5.0
BATTERY_V, LOW_BATTERY_V = 9.0, 4.5
ABORT_ZEROS = 32

_Change = tuple[str, str, float]

_PARTS: dict[str, tuple[_Change, ...]] = {
    "SILENCE": (("line", "silent", True),),
    "UNPLUG": (("line", "unplugged", True),),
    "LINE_NOISE": (("line", "noise", NOISE_SHARE),),
    "ACTUATOR_WEAK": (("unit", "stroke_share", STROKE_LEFT),),
    "AMPLIFIER_DEAD": (("unit", "amplifier_gain", 0.0),),
    "MONITOR_HIGH": (("unit", "monitor_gain", 0.0), ("unit", "monitor_zero_v", MONITOR_HIGH_V)),
    "STAGE_LIMIT": (("plant", "limit_switch", True),),
    "TOOL_LOST": (("plant", "tool_lost_um", TOOL_LOST_UM),),
    "STUCK_CONTACT": (("state", "asperity_um", HUGE),),
    "OBSTACLE": (("plant", "obstacle_um", OBSTACLE_UM),),
    # Asperities so high that they touch at any gap: every pulse is a short, and the contact is closed.
    "WIRE_SHORT": (("unit", "gap_closed_um", HUGE), ("state", "asperity_um", HUGE)),
    # A spot that ignites at once at any gap, and always as an arc.
    "CARBON": (("unit", "arc_base", HUGE), ("unit", "tau_reference_us", 0.0)),
    "GAP_SENSOR_LOW": (("unit", "gap_stuck_v", 0.0),),
    "GENERATOR_LEAK": (("unit", "off_time_a", LEAK_A),),
    "OVER_CURRENT": (("plant", "current_factor", CURRENT_FACTOR),),
    "MODE_SWITCH": (("unit", "stray_pulses", 1),),
    "ESTOP": (("plant", "estop", True),),
    "DOOR": (("plant", "door_open", True),),
    "DIELECTRIC_LEVEL": (("plant", "dielectric_level_ok", False),),
    "DIELECTRIC_FLOW": (("plant", "dielectric_flow_lpm", 0.0),),
    "DIELECTRIC_HOT": (("plant", "dielectric_temperature_c", HOT_C),),
    "HV_SUPPLY": (("plant", "hv_supply_ok", False),),
    "SAMPLES_LOST": (("telemetry", "lost", True),),
    "SAMPLES_FROZEN": (("telemetry", "frozen", True),),
    "STALL": (("unit", "threshold_uj", 1e9),),
    "BATTERY": (("unit", "battery_v", BATTERY_V),),
    "LOW_BATTERY": (("unit", "battery_v", LOW_BATTERY_V),),
    "BATTERY_TURNED": (("unit", "battery_v", -BATTERY_V),),
    "ESTOP_DOOR_SWAPPED": (("wiring", "estop_door_swapped", True),),
    "ESTOP_OPEN": (("wiring", "estop_open", True),),
    "DOOR_BRIDGED": (("wiring", "door_bridged", True),),
    "LEVEL_INVERTED": (("wiring", "level_inverted", True),),
    "FLOW_OPEN": (("wiring", "flow_open", True),),
    "SUPPLY_BRIDGED": (("wiring", "supply_bridged", True),),
    "CONTACT_INVERTED": (("unit", "contact_inverted", 1),),
    "CONTACT_OPEN": (("unit", "contact_open", 1),),
    "MONITOR_OPEN": (("unit", "monitor_gain", 0.0),),
    "MONITOR_HALF": (("unit", "monitor_gain", 0.5),),
    "MONITOR_REVERSED": (("unit", "monitor_gain", -1.0),),
    "SENSOR_REVERSED": (("unit", "sensor_wire", -1.0),),
    "SENSOR_OPEN": (("unit", "sensor_wire", math.nan),),
    "GAP_OPEN": (("unit", "gap_wire", 0.0),),
    "GAP_REVERSED": (("unit", "gap_wire", -1.0),),
    "GAP_HALF": (("unit", "gap_wire", 0.5),),
    "GATE_STUCK": (("unit", "gate_stuck", 1),),
    "GATE_OPEN": (("unit", "gate_open", 1),),
    "MODE_STUCK": (("unit", "mode_stuck", STUCK_AT_GENERATOR),),
    "MODE_OPEN": (("unit", "mode_stuck", STUCK_AT_CONTACT),),
    "DAC_OPEN": (("unit", "dac_open", 1),),
    "X_REVERSED": (("wiring", "x_share", -1.0),),
    "X_OPEN": (("wiring", "x_share", 0.0),),
    "XY_SWAPPED": (("wiring", "xy_swapped", True),),
}
_RESETS = {
    "WATCHDOG": ResetCause.WATCHDOG,
    "BROWN_OUT": ResetCause.BROWN_OUT,
    "POWER_LOSS": ResetCause.POWER_ON,
}


@dataclass(slots=True)
class _Pending:
    injection: Injection
    due_tick: int | None  # None until its trigger has come
    to_come: int = 1  # of its triggers


class Injector:
    """Keeps what is still to happen to one machine, and what was broken already.

    controller : the core in this process, or an emulated board.
    line : what is wrong with the line; whoever carries the bytes acts on it.
    applied : what has happened, with its tick.
    """

    def __init__(self, controller: Any) -> None:
        self._c = controller
        self.line = LineState()
        self.applied: list[tuple[Injection, int]] = []
        self._pending: list[_Pending] = []
        self._broken: list[tuple[str, _Change]] = []

    def add(self, injection: Injection) -> None:
        """Let an injection happen."""
        due = None
        if injection.trigger is Trigger.TIME:
            due = self._c.boot_tick + round(injection.seconds / TICK_S)
        self._pending.append(_Pending(injection, due, injection.nth))

    def clear(self) -> None:
        """Forget what is to come and repair what is broken."""
        self._pending.clear()
        while self._broken:
            self._write(*self._broken.pop()[1])
        self._c.plant.chips.clear()

    def mend(self, name: str) -> None:
        """Repair what the injections of one name have broken, and forget those that are still to come."""
        self._pending = [p for p in self._pending if p.injection.name != name]
        for at in reversed([i for i, (of, _) in enumerate(self._broken) if of == name]):
            _, (where, part, value) = self._broken.pop(at)
            later = [i for i in range(at, len(self._broken)) if self._broken[i][1][:2] == (where, part)]
            if later:  # broken anew by another one since: that is mended to what was before this
                self._broken[later[0]] = (self._broken[later[0]][0], (where, part, value))
            else:
                self._write(where, part, value)

    def note(self, trigger: Trigger) -> None:
        """Tell that a trigger has come; the seconds of whoever waits for it run from now."""
        now = self._c.tick
        for pending in self._pending:
            if pending.due_tick is not None or pending.injection.trigger is not trigger:
                continue
            pending.to_come -= 1
            if pending.to_come == 0:
                pending.due_tick = now + round(pending.injection.seconds / TICK_S)

    def next_tick(self, now: int) -> int:
        """The tick before which the clock must stop for the next injection."""
        if not self._pending:
            return NEVER
        if self._waits_for_sparks:
            return now + (1 if self._c.state is State.MACHINING else LOOK_TICKS)
        return min(NEVER if p.due_tick is None else p.due_tick for p in self._pending)

    def apply_due(self, now: int) -> None:
        """Bring about what is due at tick `now`."""
        if not self._pending:
            return
        if self._c.state is State.MACHINING and self._waits_for_sparks and self._c.loop.tick_counts >> PACK:
            self.note(Trigger.SPARKS)
        due = [p for p in self._pending if p.due_tick is not None and p.due_tick <= now]
        for pending in due:
            self._pending.remove(pending)
            self.applied.append((pending.injection, now))
            self._apply(pending.injection, now)

    @property
    def _waits_for_sparks(self) -> bool:
        return any(p.due_tick is None and p.injection.trigger is Trigger.SPARKS for p in self._pending)

    def _apply(self, injection: Injection, now: int) -> None:
        name, unit = injection.name, self._c.plant.unit
        if name in _RESETS:
            self._c.reset(_RESETS[name])
        elif name == "ABORT_RUN":
            self._c.receive(bytes(ABORT_ZEROS))
        elif name in CHIPS:
            self._c.plant.chips.drop(injection.size_um, loose=name == "LOOSE_CHIP")
        elif name == "GAP_SENSOR_HIGH":
            self._break(name, "unit", "gap_stuck_v", unit.open_v)
        elif name == "WEAR_FAST":
            self._break(name, "unit", "tool_factor", WEAR_FACTOR * unit.tool_factor)
        elif name == "SENSOR_DRIFT":
            # The drift counts from tick 0; what it would be by now is taken off.
            self._break(name, "state", "walk_um", self._c.plant.state.walk_um - DRIFT_UM_S * now * TICK_S)
            self._break(name, "unit", "sensor_drift_um_s", unit.sensor_drift_um_s + DRIFT_UM_S)
        for change in _PARTS.get(name, ()):
            self._break(name, *change)

    def _break(self, injection: str, where: str, name: str, value: float) -> None:
        self._broken.append((injection, (where, name, getattr(self._owner(where), name))))
        self._write(where, name, value)

    def _owner(self, where: str) -> object:
        plant = self._c.plant
        owners: dict[str, object] = {
            "line": self.line,
            "telemetry": self._c.telemetry,
            "plant": plant,
            "unit": plant.unit,
            "state": plant.state,
            "wiring": plant.wiring,
        }
        return owners[where]

    def _write(self, where: str, name: str, value: float) -> None:
        plant = self._c.plant
        if where == "plant" and name == "current_factor":
            plant.set_current_factor(value)
            return
        setattr(self._owner(where), name, value)
        if where == "plant":
            plant.set_surface()
