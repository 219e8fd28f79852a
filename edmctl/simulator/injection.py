"""Faults that can be brought about on the virtual machine: their names, and when they happen."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from edmctl.link.faults import FAULTS


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
    """Something that will go wrong `seconds` of controller time after `trigger`; `name` is one of INJECTIONS."""

    name: str
    trigger: Trigger
    seconds: float

    def __str__(self) -> str:
        start = f"{self.trigger.value}+" if self.trigger.value else ""
        return f"{self.name}@{start}{self.seconds:g}"


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
}
"""Every injection, with its usual time."""

_ALIASES = {row.name: row.inject for row in FAULTS.values() if row.inject.isupper() or "@" in row.inject}


def parse_injection(text: str) -> Injection:
    """Read `NAME` or `NAME@WHEN`; WHEN is seconds, or `arm+`, `touch+` or `sparks+` and seconds.

    NAME is one of INJECTIONS, or the name of a fault, which stands for its usual injection.

    Raises
    ------
    ValueError
        No such name (the message lists them), or WHEN is none of these.
    """
    name, at, when = text.strip().partition("@")
    name = name.strip().upper()
    if name not in INJECTIONS and name in _ALIASES:
        name, _, usual = _ALIASES[name].partition("@")
        when = when if at else usual
    if name not in INJECTIONS:
        raise ValueError(f"no such fault: {name}; there are {', '.join(sorted(INJECTIONS))}")
    if at and not when.strip():
        raise ValueError(f"{text!r} says no time after @")
    return Injection(name, *_when(when.strip() or INJECTIONS[name]))


def _when(text: str) -> tuple[Trigger, float]:
    start, plus, seconds = text.rpartition("+")
    try:
        trigger = Trigger(start.strip().lower()) if plus else Trigger.TIME
        value = float(seconds)
    except ValueError:
        raise ValueError(f"{text!r} is no time; say SECONDS, arm+S, touch+S or sparks+S") from None
    if (plus and trigger is Trigger.TIME) or not (math.isfinite(value) and value >= 0.0):
        raise ValueError(f"{text!r} is no time; say SECONDS, arm+S, touch+S or sparks+S")
    return trigger, value
