"""Breaks the virtual machine at the tick asked for, and repairs it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from edmctl.link.messages import ResetCause, State
from edmctl.simulator import kernel as k
from edmctl.simulator.injection import CHIPS, Injection, LineState, Trigger

if TYPE_CHECKING:
    from edmctl.simulator.controller import VirtualController

NEVER = 1 << 62
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
ABORT_ZEROS = 32

_Change = tuple[str, int | str, float]

_PARTS: dict[str, tuple[_Change, ...]] = {
    "SILENCE": (("line", "silent", True),),
    "UNPLUG": (("line", "unplugged", True),),
    "LINE_NOISE": (("line", "noise", NOISE_SHARE),),
    "ACTUATOR_WEAK": (("par", k.STROKE, STROKE_LEFT),),
    "AMPLIFIER_DEAD": (("par", k.DRIVE, 0.0),),
    "MONITOR_HIGH": (("par", k.MONITOR_GAIN, 0.0), ("par", k.MONITOR_ZERO, MONITOR_HIGH_V)),
    "STAGE_LIMIT": (("plant", "limit_switch", True),),
    "TOOL_LOST": (("plant", "tool_lost_um", TOOL_LOST_UM),),
    "STUCK_CONTACT": (("st", k.ASPERITY, HUGE),),
    "OBSTACLE": (("plant", "obstacle_um", OBSTACLE_UM),),
    # Asperities so high that they touch at any gap: every pulse is a short, and the contact is closed.
    "WIRE_SHORT": (("par", k.ROUGHNESS, HUGE), ("st", k.ASPERITY, HUGE)),
    # A spot that ignites at once at any gap, and always as an arc.
    "CARBON": (("par", k.ARC_BASE, HUGE), ("par", k.TAU_REFERENCE, 0.0)),
    "GAP_SENSOR_LOW": (("par", k.GAP_STUCK, 0.0),),
    "GENERATOR_LEAK": (("par", k.OFF_TIME_A, LEAK_A),),
    "OVER_CURRENT": (("plant", "current_factor", CURRENT_FACTOR),),
    "MODE_SWITCH": (("ist", k.STRAY_PULSES, 1),),
    "ESTOP": (("plant", "estop", True),),
    "DOOR": (("plant", "door_open", True),),
    "DIELECTRIC_LEVEL": (("plant", "dielectric_level_ok", False),),
    "DIELECTRIC_FLOW": (("plant", "dielectric_flow_lpm", 0.0),),
    "DIELECTRIC_HOT": (("plant", "dielectric_temperature_c", HOT_C),),
    "HV_SUPPLY": (("plant", "hv_supply_ok", False),),
    "SAMPLES_LOST": (("telemetry", "lost", True),),
    "SAMPLES_FROZEN": (("telemetry", "frozen", True),),
    "STALL": (("par", k.KAPPA, 0.0),),
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

    line : what is wrong with the line; whoever carries the bytes acts on it.
    applied : what has happened, with its tick.
    """

    def __init__(self, controller: VirtualController) -> None:
        self._c = controller
        self.line = LineState()
        self.applied: list[tuple[Injection, int]] = []
        self._pending: list[_Pending] = []
        self._broken: list[_Change] = []

    def add(self, injection: Injection) -> None:
        """Let an injection happen."""
        due = None
        if injection.trigger is Trigger.TIME:
            due = self._c.boot_tick + round(injection.seconds / k.TICK_S)
        self._pending.append(_Pending(injection, due, injection.nth))

    def clear(self) -> None:
        """Forget what is to come and repair what is broken."""
        self._pending.clear()
        while self._broken:
            self._write(*self._broken.pop())
        self._c.plant.chips.clear()

    def note(self, trigger: Trigger) -> None:
        """Tell that a trigger has come; the seconds of whoever waits for it run from now."""
        now = self._c.tick
        for pending in self._pending:
            if pending.due_tick is not None or pending.injection.trigger is not trigger:
                continue
            pending.to_come -= 1
            if pending.to_come == 0:
                pending.due_tick = now + round(pending.injection.seconds / k.TICK_S)

    def next_tick(self, now: int) -> int:
        """The tick before which the clock must stop for the next injection."""
        if not self._pending:
            return NEVER
        if self._looks_for_sparks:
            return now + 1
        return min(NEVER if p.due_tick is None else p.due_tick for p in self._pending)

    def apply_due(self, now: int) -> None:
        """Bring about what is due at tick `now`."""
        if not self._pending:
            return
        if self._looks_for_sparks and self._c.ist.item(k.TICK_COUNTS) >> k.PACK:
            self.note(Trigger.SPARKS)
        due = [p for p in self._pending if p.due_tick is not None and p.due_tick <= now]
        for pending in due:
            self._pending.remove(pending)
            self.applied.append((pending.injection, now))
            self._apply(pending.injection, now)

    @property
    def _looks_for_sparks(self) -> bool:
        return self._c.state is State.MACHINING and any(
            p.due_tick is None and p.injection.trigger is Trigger.SPARKS for p in self._pending
        )

    def _apply(self, injection: Injection, now: int) -> None:
        name, par = injection.name, self._c.par
        if name in _RESETS:
            self._c.reset(_RESETS[name])
        elif name == "ABORT_RUN":
            self._c.receive(bytes(ABORT_ZEROS))
        elif name in CHIPS:
            self._c.plant.chips.drop(injection.size_um, loose=name == "LOOSE_CHIP")
        elif name == "GAP_SENSOR_HIGH":
            self._break("par", k.GAP_STUCK, par.item(k.OPEN_V))
        elif name == "WEAR_FAST":
            self._break("par", k.THETA, WEAR_FACTOR * par.item(k.THETA))
        elif name == "SENSOR_DRIFT":
            # The drift counts from tick 0; what it would be by now is taken off.
            self._break("st", k.WALK, self._c.st.item(k.WALK) - DRIFT_UM_S * now * k.TICK_S)
            self._break("par", k.SENSOR_DRIFT, par.item(k.SENSOR_DRIFT) + DRIFT_UM_S)
        for change in _PARTS.get(name, ()):
            self._break(*change)

    def _break(self, where: str, key: int | str, value: float) -> None:
        self._broken.append((where, key, self._read(where, key)))
        self._write(where, key, value)

    def _read(self, where: str, key: int | str) -> float:
        if isinstance(key, str):
            old: float = getattr(self._owner(where), key)
            return old
        return float(getattr(self._c, where)[key])

    def _owner(self, where: str) -> object:
        return {"line": self.line, "telemetry": self._c.telemetry, "plant": self._c.plant}[where]

    def _write(self, where: str, key: int | str, value: float) -> None:
        plant = self._c.plant
        if isinstance(key, int):
            getattr(self._c, where)[key] = value
        elif where != "plant":
            setattr(self._owner(where), key, value)
        elif key == "current_factor":
            plant.set_current_factor(value)
        else:
            setattr(plant, key, value)
            plant.set_surface()
