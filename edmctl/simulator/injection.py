"""Faults that can be brought about on the virtual machine: names, times, and what a bad line does."""

from __future__ import annotations

import math
from enum import Enum
from random import Random

from edmctl.dataclasses import dataclass
from edmctl.link.faults import FAULTS
from edmctl.link.messages import Advance


class Trigger(Enum):
    """What an injection counts its seconds from."""

    TIME = ""
    """The controller's start."""
    ARM = "arm"
    """The next ARM."""
    TOUCH = "touch"
    """The next TOUCH_OFF."""
    SPARKS = "sparks"
    """The next discharge of a cut."""


@dataclass(frozen=True, slots=True)
class Injection:
    """Something that will go wrong `seconds` of controller time after the `nth` next `trigger`.

    `name` is one of INJECTIONS; `size_um` is the height of a chip, NaN for everything else.
    """

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

    unplugged : nothing comes or goes, and both ends can tell.
    silent : what the host sends does not arrive; it cannot tell.
    noise : share of the host's frames that arrive damaged, 0 to 1.
    """

    unplugged: bool = False
    silent: bool = False
    noise: float = 0.0

    @property
    def is_damaged(self) -> bool:
        """Whether what the host sends may not arrive."""
        return self.unplugged or self.silent or self.noise > 0.0


WIRING_MISTAKES = (
    "ESTOP_DOOR_SWAPPED",
    "ESTOP_OPEN",
    "DOOR_BRIDGED",
    "LEVEL_INVERTED",
    "FLOW_OPEN",
    "SUPPLY_BRIDGED",
    "CONTACT_INVERTED",
    "CONTACT_OPEN",
    "MONITOR_OPEN",
    "MONITOR_HALF",
    "MONITOR_REVERSED",
    "SENSOR_REVERSED",
    "SENSOR_OPEN",
    "GAP_OPEN",
    "GAP_REVERSED",
    "GAP_HALF",
    "GATE_STUCK",
    "GATE_OPEN",
    "MODE_STUCK",
    "MODE_OPEN",
    "DAC_OPEN",
    "X_REVERSED",
    "X_OPEN",
    "XY_SWAPPED",
)
"""Between plant and controller: wires that are off, reversed, exchanged or bridged, from the start."""

INJECTIONS: dict[str, str] = {
    "SILENCE": "sparks+1",
    "UNPLUG": "sparks+1",
    "LINE_NOISE": "sparks+1",
    "ABORT_RUN": "sparks+1",
    "ACTUATOR_WEAK": "sparks+1",
    "AMPLIFIER_DEAD": "sparks+1",
    "MONITOR_HIGH": "sparks+1",
    "STAGE_LIMIT": "arm+0",
    "TOOL_LOST": "sparks+1",
    "STUCK_CONTACT": "touch+0.2",
    "OBSTACLE": "arm+0",
    "WIRE_SHORT": "sparks+1",
    "CARBON": "sparks+1",
    "GAP_SENSOR_HIGH": "sparks+1",
    "GAP_SENSOR_LOW": "arm+0",
    "GENERATOR_LEAK": "sparks+1",
    "OVER_CURRENT": "sparks+1",
    "MODE_SWITCH": "touch+0.2",
    "ESTOP": "sparks+1",
    "DOOR": "sparks+1",
    "DIELECTRIC_LEVEL": "sparks+1",
    "DIELECTRIC_FLOW": "sparks+1",
    "DIELECTRIC_HOT": "sparks+1",
    "HV_SUPPLY": "sparks+1",
    "WATCHDOG": "sparks+1",
    "BROWN_OUT": "sparks+1",
    "POWER_LOSS": "sparks+1",
    "SAMPLES_LOST": "sparks+1",
    "SAMPLES_FROZEN": "sparks+1",
    "SENSOR_DRIFT": "sparks+1",
    "STALL": "sparks+1",
    "WEAR_FAST": "arm+0",
    "CHIP": "touch+0",
    "LOOSE_CHIP": "touch+0",
    "BATTERY": "0",
    "LOW_BATTERY": "0",
    "BATTERY_TURNED": "0",
    **dict.fromkeys(WIRING_MISTAKES, "0"),
}
"""Every injection, with its usual time."""

CHIPS = ("CHIP", "LOOSE_CHIP")
USUAL_CHIP_UM = 8.0

DAMAGE_SEED = 1
_ADVANCE = bytes([Advance.ID])

_ALIASES = {row.name: row.inject for row in FAULTS.values() if row.inject.isupper() or "@" in row.inject}


def parse_injection(text: str) -> Injection:
    """Read `NAME` or `NAME@WHEN`; WHEN is seconds, or `arm+`, `touch+` or `sparks+` and seconds.

    NAME is one of INJECTIONS, or the name of a fault, which stands for its usual injection. A chip may be followed
    by its height in µm (`CHIP_5`), a trigger by a number: `touch3+0` is the third touch from now.

    Raises
    ------
    ValueError
        No such name (the message lists them), or WHEN is none of these.
    """
    name, at, when = text.strip().partition("@")
    name, size_um = _sized(name.strip().upper())
    if name not in INJECTIONS and name in _ALIASES:
        name, _, usual = _ALIASES[name].partition("@")
        when = when if at else usual
    if name not in INJECTIONS:
        raise ValueError(f"no such fault: {name}; there are {', '.join(sorted(INJECTIONS))}")
    if at and not when.strip():
        raise ValueError(f"{text!r} says no time after @")
    return Injection(name, *_when(when.strip() or INJECTIONS[name]), size_um)


def _sized(name: str) -> tuple[str, float]:
    """Name and height of a chip; any other name as it is, without one."""
    kind, _, size = name.rpartition("_")
    if kind not in CHIPS:
        return name, USUAL_CHIP_UM if name in CHIPS else math.nan
    try:
        size_um = float(size)
    except ValueError:
        size_um = math.nan
    if not (math.isfinite(size_um) and size_um > 0.0):
        raise ValueError(f"{size!r} is no height of a chip; say {kind}_{USUAL_CHIP_UM:g} for that many µm")
    return kind, size_um


def _when(text: str) -> tuple[Trigger, float, int]:
    start, plus, seconds = text.rpartition("+")
    word = start.strip().lower().rstrip("0123456789")
    number = start.strip()[len(word) :]
    try:
        trigger = Trigger(word) if plus else Trigger.TIME
        value, nth = float(seconds), int(number or "1")
    except ValueError:
        raise ValueError(f"{text!r} is no time; say SECONDS, arm+S, touch+S, touch3+S or sparks+S") from None
    counted = nth == 1 or (nth > 1 and trigger in (Trigger.ARM, Trigger.TOUCH))
    if (plus and trigger is Trigger.TIME) or not (math.isfinite(value) and value >= 0.0 and counted):
        raise ValueError(f"{text!r} is no time; say SECONDS, arm+S, touch+S, touch3+S or sparks+S")
    return trigger, value, nth


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
