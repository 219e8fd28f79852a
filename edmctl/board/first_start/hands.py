"""The person at a virtual machine: hands are injections, eyes look at the plant; what is allowed is still asked."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from edmctl.board.first_start.person import ACTS, Act, Asked, Done, Question
from edmctl.link.messages import Axis
from edmctl.simulator import VirtualBench
from edmctl.simulator.injection import parse_injection
from edmctl.simulator.injector import BATTERY_V, LOW_BATTERY_V

BEFORE = ("+HV_SUPPLY", "+AMPLIFIER_DEAD")
"""What a machine is at the begin: both supplies off."""
HANDS: Mapping[str, tuple[str, ...]] = {
    "estop-press": ("+ESTOP",),
    "estop-release": ("-ESTOP",),
    "door-open": ("+DOOR",),
    "door-close": ("-DOOR",),
    "level-low": ("+DIELECTRIC_LEVEL",),
    "level-ok": ("-DIELECTRIC_LEVEL",),
    "pump-off": ("+DIELECTRIC_FLOW",),
    "pump-on": ("-DIELECTRIC_FLOW",),
    "contact-close": ("+WIRE_SHORT",),
    "contact-open": ("-WIRE_SHORT",),
    "battery-on": ("+BATTERY",),
    "low-battery-on": ("+LOW_BATTERY",),
    "battery-turn": ("-BATTERY", "-LOW_BATTERY", "+BATTERY_TURNED"),
    "battery-off": ("-BATTERY", "-LOW_BATTERY", "-BATTERY_TURNED"),
    "supply-on": ("-HV_SUPPLY",),
    "limit-close": ("+STAGE_LIMIT",),
    "limit-open": ("-STAGE_LIMIT",),
    "amplifier-on": ("-AMPLIFIER_DEAD",),
}
"""What each act does to a virtual machine: an injection that begins, or is mended."""
assert HANDS.keys() == ACTS.keys()
BATTERIES = {"battery-volts": str(BATTERY_V), "low-battery-volts": str(LOW_BATTERY_V)}

_LOOKED_AT = {"x-direction": Axis.X, "y-direction": Axis.Y, "theta-direction": Axis.THETA}
_MOVED = (100.0, 100.0, 1.0)  # µm, µm and degrees: more than a stage's repeatability


class VirtualHands:
    """Acts on a bench in this process, and looks at its stages; `asked` is who allows dangerous steps."""

    def __init__(self, bench: VirtualBench, asked: Asked) -> None:
        self._bench, self._asked = bench, asked
        self._places: list[float] = []
        for change in BEFORE:
            self._do(change)

    def act(self, act: Act) -> Done:
        """Do it, unless the answers leave it out."""
        done = _said(self._asked, act)
        for change in HANDS[act.key] if done is Done.DONE else ():
            self._do(change)
        return done

    def answer(self, question: Question) -> str:
        """Look, where there is something to see and the answers do not tell, and ask otherwise."""
        if self._asked.has_answered(question.key) and question.key != "stages":
            return self._asked.answer(question)
        if question.key in BATTERIES:
            return BATTERIES[question.key]
        if question.key not in _LOOKED_AT:
            if question.key == "stages":
                self._places = self._now()
            return self._asked.answer(question)
        axis, now = _LOOKED_AT[question.key], self._now()
        ways = [new - old for new, old in zip(now, self._places, strict=True)]
        return _direction(axis, ways)

    def _do(self, change: str) -> None:
        name = change[1:]
        if change[0] == "+":
            self._bench.inject(parse_injection(f"{name}@0"))
        else:
            self._bench.controller.injector.mend(name)

    def _now(self) -> list[float]:
        plant = self._bench.plant
        return [*map(float, plant.position_um), plant.theta_deg]


def _said(asked: Asked, act: Act) -> Done:
    """What the answers say of an act; without a word the program's hands do it."""
    return asked.act(act) if asked.has_answered(act.key) else Done.DONE


def _direction(axis: Axis, ways: list[float]) -> str:
    """What somebody sees who looks at three stages."""
    moved = [abs(way) >= least for way, least in zip(ways, _MOVED, strict=True)]
    if not moved[axis]:
        return "other" if any(moved) else "none"
    return "plus" if ways[axis] > 0.0 else "minus"


class WrittenHands:
    """Acts on a served virtual machine by the file that `edmctl simulate serve --acts` reads."""

    def __init__(self, path: Path, asked: Asked) -> None:
        self._path, self._asked = path, asked
        self._write(BEFORE)

    def act(self, act: Act) -> Done:
        """Do it, unless the answers leave it out."""
        done = _said(self._asked, act)
        if done is Done.DONE:
            self._write(HANDS[act.key])
        return done

    def answer(self, question: Question) -> str:
        """Ask: nobody sees the stages from here."""
        if self._asked.has_answered(question.key):
            return self._asked.answer(question)
        return BATTERIES.get(question.key) or self._asked.answer(question)

    def _write(self, changes: tuple[str, ...]) -> None:
        with self._path.open("a", encoding="ascii") as acts:
            acts.writelines(f"{change}\n" for change in changes)
