"""Faults that can be injected into the virtual machine: names, times and effects, and what a bad line does."""

from __future__ import annotations

import math
import re
from enum import Enum
from random import Random
from typing import Any

from edmctl.core.library import PACK
from edmctl.dataclasses import dataclass
from edmctl.link.faults import FAULTS
from edmctl.link.messages import Advance, ResetCause, State
from edmctl.simulator.plant_records import STUCK_AT_CONTACT, STUCK_AT_GENERATOR, TICK_S

HUGE = 1e12
BATTERY_V, LOW_BATTERY_V = 9.0, 4.5
WEAR_FACTOR = 5.0
DRIFT_UM_S = 5.0
ABORT_ZEROS = 32
CHIPS = ("CHIP", "LOOSE_CHIP")
USUAL_CHIP_UM = 8.0
NEVER = 1 << 62
LOOK_TICKS = 10
"""An injection that waits for sparks checks this often whether the servo runs, ms."""
DAMAGE_SEED = 1
_ADVANCE = bytes([Advance.ID])
_NUMBER = re.compile(r"(?:\d+\.?\d*|\.\d+)(?:E[+-]?\d+)?", re.ASCII | re.IGNORECASE)
_WHEN = re.compile(rf"(?:(arm|touch|sparks)(\d*)\+)?({_NUMBER.pattern})", re.ASCII | re.IGNORECASE)
_SPARK = "sparks+1"

_Change = tuple[str, str, float]
"""Part of the machine, its attribute, and the value."""

INJECTIONS: dict[str, tuple[str, tuple[_Change, ...]]] = {
    "SILENCE": (_SPARK, (("line", "silent", True),)),
    "UNPLUG": (_SPARK, (("line", "unplugged", True),)),
    "LINE_NOISE": (_SPARK, (("line", "noise", 0.5),)),
    "ABORT_RUN": (_SPARK, ()),
    "ACTUATOR_WEAK": (_SPARK, (("unit", "stroke_share", 0.5),)),
    "AMPLIFIER_DEAD": (_SPARK, (("unit", "amplifier_gain", 0.0),)),
    "MONITOR_HIGH": (_SPARK, (("unit", "monitor_gain", 0.0), ("unit", "monitor_zero_v", 160.0))),
    "STAGE_LIMIT": ("arm+0", (("plant", "limit_switch", True),)),
    "TOOL_LOST": (_SPARK, (("plant", "tool_lost_um", 1e4),)),
    "STUCK_CONTACT": ("touch+0.2", (("state", "asperity_um", HUGE),)),
    "OBSTACLE": ("arm+0", (("plant", "obstacle_um", 20.0),)),
    # Asperities so high that they touch at any gap: every pulse is a short, and the contact is closed.
    "WIRE_SHORT": (_SPARK, (("unit", "gap_closed_um", HUGE), ("state", "asperity_um", HUGE))),
    # A spot that ignites at once at any gap, and always as an arc.
    "CARBON": (_SPARK, (("unit", "arc_base", HUGE), ("unit", "tau_reference_us", 0.0))),
    "GAP_SENSOR_HIGH": (_SPARK, ()),
    "GAP_SENSOR_LOW": ("arm+0", (("unit", "gap_stuck_v", 0.0),)),
    "GENERATOR_LEAK": (_SPARK, (("unit", "off_time_a", 0.05),)),
    "OVER_CURRENT": (_SPARK, (("plant", "current_factor", 3.0),)),
    "MODE_SWITCH": ("touch+0.2", (("unit", "stray_pulses", 1),)),
    "ESTOP": (_SPARK, (("plant", "estop", True),)),
    "DOOR": (_SPARK, (("plant", "door_open", True),)),
    "DIELECTRIC_LEVEL": (_SPARK, (("plant", "dielectric_level_ok", False),)),
    "DIELECTRIC_FLOW": (_SPARK, (("plant", "dielectric_flow_lpm", 0.0),)),
    "DIELECTRIC_HOT": (_SPARK, (("plant", "dielectric_temperature_c", 60.0),)),
    "HV_SUPPLY": (_SPARK, (("plant", "hv_supply_ok", False),)),
    "WATCHDOG": (_SPARK, ()),
    "BROWN_OUT": (_SPARK, ()),
    "POWER_LOSS": (_SPARK, ()),
    "SAMPLES_LOST": (_SPARK, (("telemetry", "lost", True),)),
    "SAMPLES_FROZEN": (_SPARK, (("telemetry", "frozen", True),)),
    "SENSOR_DRIFT": (_SPARK, ()),
    "STALL": (_SPARK, (("unit", "threshold_uj", 1e9),)),
    "WEAR_FAST": ("arm+0", ()),
    "CHIP": ("touch+0", ()),
    "LOOSE_CHIP": ("touch+0", ()),
    "BATTERY": ("0", (("unit", "battery_v", BATTERY_V),)),
    "LOW_BATTERY": ("0", (("unit", "battery_v", LOW_BATTERY_V),)),
    "BATTERY_TURNED": ("0", (("unit", "battery_v", -BATTERY_V),)),
}
"""Every injection: its usual time, and what it changes unless that depends on the state of the machine."""

_WIRES: dict[str, _Change] = {
    "ESTOP_DOOR_SWAPPED": ("wiring", "estop_door_swapped", True),
    "ESTOP_OPEN": ("wiring", "estop_open", True),
    "DOOR_BRIDGED": ("wiring", "door_bridged", True),
    "LEVEL_INVERTED": ("wiring", "level_inverted", True),
    "FLOW_OPEN": ("wiring", "flow_open", True),
    "SUPPLY_BRIDGED": ("wiring", "supply_bridged", True),
    "CONTACT_INVERTED": ("unit", "contact_inverted", 1),
    "CONTACT_OPEN": ("unit", "contact_open", 1),
    "MONITOR_OPEN": ("unit", "monitor_gain", 0.0),
    "MONITOR_HALF": ("unit", "monitor_gain", 0.5),
    "MONITOR_REVERSED": ("unit", "monitor_gain", -1.0),
    "SENSOR_REVERSED": ("unit", "sensor_wire", -1.0),
    "SENSOR_OPEN": ("unit", "sensor_wire", math.nan),
    "GAP_OPEN": ("unit", "gap_wire", 0.0),
    "GAP_REVERSED": ("unit", "gap_wire", -1.0),
    "GAP_HALF": ("unit", "gap_wire", 0.5),
    "GATE_STUCK": ("unit", "gate_stuck", 1),
    "GATE_OPEN": ("unit", "gate_open", 1),
    "MODE_STUCK": ("unit", "mode_stuck", STUCK_AT_GENERATOR),
    "MODE_OPEN": ("unit", "mode_stuck", STUCK_AT_CONTACT),
    "DAC_OPEN": ("unit", "dac_open", 1),
    "X_REVERSED": ("wiring", "x_share", -1.0),
    "X_OPEN": ("wiring", "x_share", 0.0),
    "XY_SWAPPED": ("wiring", "xy_swapped", True),
}
WIRING_MISTAKES = tuple(_WIRES)
"""Between plant and controller: wires that are off, reversed, exchanged or bridged, from the start."""
INJECTIONS |= {name: ("0", (change,)) for name, change in _WIRES.items()}

_RESETS = {
    "WATCHDOG": ResetCause.WATCHDOG,
    "BROWN_OUT": ResetCause.BROWN_OUT,
    "POWER_LOSS": ResetCause.POWER_ON,
}
_ALIASES = {row.name: row.inject for row in FAULTS.values() if row.inject.isupper() or "@" in row.inject}


class Trigger(Enum):
    """What an injection counts its seconds from: the controller's start, ARM, TOUCH_OFF, a discharge of a cut."""

    TIME = ""
    ARM = "arm"
    TOUCH = "touch"
    SPARKS = "sparks"


@dataclass(frozen=True, slots=True)
class Injection:
    """A fault `seconds` of controller time after the `nth` next `trigger`; `size_um` is the height of a chip."""

    name: str
    trigger: Trigger
    seconds: float
    nth: int = 1
    size_um: float = math.nan

    def __str__(self) -> str:
        size = "" if math.isnan(self.size_um) else f"_{self.size_um:g}"
        which = str(self.nth) if self.nth > 1 else ""
        start = f"{self.trigger.value}{which}+" if self.trigger.value else ""
        return f"{self.name}{size}@{start}{self.seconds:g}"


@dataclass(slots=True)
class LineState:
    """What is wrong with the line between host and controller.

    unplugged : nothing comes or goes, and both ends notice. silent : what the host sends does not arrive, unnoticed.
    noise : share of the host's frames that arrive damaged, 0 to 1.
    """

    unplugged: bool = False
    silent: bool = False
    noise: float = 0.0

    @property
    def is_damaged(self) -> bool:
        return self.unplugged or self.silent or self.noise > 0.0


def parse_injection(text: str) -> Injection:
    """Read `NAME` or `NAME@WHEN`; WHEN is seconds, or `arm+`, `touch+` or `sparks+` and seconds.

    NAME is one of INJECTIONS, or the name of a fault, which means its usual injection. A chip may be followed by its
    height in µm (`CHIP_5`), a trigger by a number: `touch3+0` is the third touch from now. Raises ValueError.
    """
    name, at, when = (part.strip() for part in text.partition("@"))
    name = name.upper()
    size_um = USUAL_CHIP_UM if name in CHIPS else math.nan
    kind, _, size = name.rpartition("_")
    if kind in CHIPS:
        name, size_um = kind, float(size) if _NUMBER.fullmatch(size) else 0.0
        if not 0.0 < size_um < math.inf:
            raise ValueError(f"{size!r} is not the height of a chip; use {kind}_{USUAL_CHIP_UM:g} for 8 µm")
    if name not in INJECTIONS and name in _ALIASES:
        name, _, usual = _ALIASES[name].partition("@")
        when = when if at else usual
    if name not in INJECTIONS:
        raise ValueError(f"no such fault: {name}; there are {', '.join(sorted(INJECTIONS))}")
    match = _WHEN.fullmatch(when if at else when or INJECTIONS[name][0])
    nth = int(match[2] or 1) if match else 0
    if match is None or not (nth == 1 or (nth > 1 and match[1] != "sparks")) or float(match[3]) == math.inf:
        raise ValueError(f"{when!r} is no time; use SECONDS, arm+S, touch+S, touch3+S or sparks+S")
    return Injection(name, Trigger((match[1] or "").lower()), float(match[3]), nth, size_um)


class LineDamage:
    """Loses or damages the host's frames as the line's state says; always the same ones in a run.

    ADVANCE passes: it is no part of the line that is imitated.
    """

    def __init__(self, line: LineState) -> None:
        self._line = line
        self._random = Random(DAMAGE_SEED)

    def to(self, data: bytes) -> bytes:
        """Return what arrives of `data`, which holds whole frames."""
        if self._line.silent:
            return b"".join(b"\0" + part + b"\0" for part in data.split(b"\0") if _is_advance(part))
        if not self._line.noise:
            return data
        return b"\0".join(self._of_frame(part) for part in data.split(b"\0"))

    def _of_frame(self, part: bytes) -> bytes:
        if not part or _is_advance(part) or self._random.random() >= self._line.noise:
            return part
        damaged = bytearray(part)
        # A byte that becomes zero would only cut the frame in two.
        at = self._random.randrange(len(damaged))
        damaged[at] = damaged[at] ^ 1 or 2
        return bytes(damaged)


def _is_advance(part: bytes) -> bool:
    """COBS puts its first code byte before the type, which is never zero."""
    return part[1:2] == _ADVANCE


@dataclass(slots=True)
class _Pending:
    injection: Injection
    due_tick: int | None  # None until its trigger has come
    to_come: int = 1  # of its triggers


class Injector:
    """Pending injections of one machine, and what was broken already.

    controller : the core in this process, or an emulated board. line : acted on by whoever carries the bytes.
    applied : what has happened, with its tick.
    """

    def __init__(self, controller: Any) -> None:
        self._c = controller
        self.line = LineState()
        self.applied: list[tuple[Injection, int]] = []
        self._pending: list[_Pending] = []
        self._broken: list[tuple[str, _Change]] = []

    def add(self, injection: Injection) -> None:
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
        for change in INJECTIONS[name][1]:
            self._break(name, *change)

    def _break(self, injection: str, where: str, name: str, value: float) -> None:
        self._broken.append((injection, (where, name, getattr(self._owner(where), name))))
        self._write(where, name, value)

    def _owner(self, where: str) -> object:
        plant = self._c.plant
        if where == "line":
            return self.line
        if where == "telemetry":
            return self._c.telemetry
        return plant if where == "plant" else getattr(plant, where)

    def _write(self, where: str, name: str, value: float) -> None:
        plant = self._c.plant
        if where == "plant" and name == "current_factor":
            plant.set_current_factor(value)
            return
        setattr(self._owner(where), name, value)
        if where == "plant":
            plant.set_surface()
