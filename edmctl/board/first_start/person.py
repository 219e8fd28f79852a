"""The operator of a first start: actions and questions, who answers them, and the hands of a virtual machine."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Protocol

from edmctl import failures
from edmctl.dataclasses import dataclass
from edmctl.files import read_bytes
from edmctl.link.messages import Axis
from edmctl.simulator import VirtualBench
from edmctl.simulator.injection import parse_injection
from edmctl.simulator.injector import BATTERY_V, LOW_BATTERY_V

CHAIN_HIGH_V, CHAIN_LOW_V = 2.3, 0.8
"""Voltages at the pin of the break chain that the chip reads as high and as low."""
DIRECTIONS = ("plus", "minus", "none", "other", "absent")


@dataclass(frozen=True, slots=True)
class Prompt:
    """An action (option `done`) or a question; no options: a number.

    danger : the step energises something. changes : of an action, the injections on a virtual machine that begin (+)
    or end (-).
    """

    key: str
    text: str
    options: tuple[str, ...]
    danger: bool = False
    changes: str = ""


def _action(key: str, changes: str, text: str, *more: str) -> Prompt:
    return Prompt(key, text, ("done", *more), changes=changes)


ACTS = {
    act.key: act
    for act in (
        _action("estop-press", "+ESTOP", "Press the emergency stop."),
        _action("estop-release", "-ESTOP", "Release the emergency stop."),
        _action("door-open", "+DOOR", "Open the door."),
        _action("door-close", "-DOOR", "Close the door."),
        _action(
            "level-low",
            "+DIELECTRIC_LEVEL",
            "Bring the level switch of the dielectric to 'too low': let its float sink, or drain.",
        ),
        _action(
            "level-ok",
            "-DIELECTRIC_LEVEL",
            "Bring the level switch back to 'ok': let its float rise, or fill up.",
        ),
        _action("pump-off", "+DIELECTRIC_FLOW", "Switch the pump of the dielectric off."),
        _action("pump-on", "-DIELECTRIC_FLOW", "Switch the pump on again."),
        _action("contact-close", "+WIRE_SHORT", "Connect tool and workpiece with a wire."),
        _action("contact-open", "-WIRE_SHORT", "Take the wire off."),
        _action(
            "battery-on",
            "+BATTERY",
            "Connect the battery over 1 kΩ to the gap, plus to the generator's plus.",
        ),
        _action(
            "low-battery-on",
            "+LOW_BATTERY",
            "Connect the battery of lower voltage over 1 kΩ to the gap, plus to the generator's plus.",
        ),
        _action(
            "battery-turn",
            "-BATTERY -LOW_BATTERY +BATTERY_TURNED",
            "Turn the battery round, plus to minus.",
        ),
        _action("battery-off", "-BATTERY -LOW_BATTERY -BATTERY_TURNED", "Take the battery off."),
        _action(
            "supply-on",
            "-HV_SUPPLY",
            "Switch the high-voltage supply on; the amplifier of the actuator stays off.",
        ),
        _action("limit-close", "+STAGE_LIMIT", "Hold a limit switch of the stages closed by hand.", "absent"),
        _action("limit-open", "-STAGE_LIMIT", "Let go of the limit switch."),
        _action("amplifier-on", "-AMPLIFIER_DEAD", "Switch the amplifier of the actuator on."),
    )
}

_YES_NO = ("yes", "no")
QUESTIONS = {
    question.key: question
    for question in (
        Prompt(
            "ready",
            "High-voltage supply and amplifier off, tool at least 2 mm from workpiece and holder, e-stop released, "
            "door closed, dielectric flowing, no hands at the stages?",
            _YES_NO,
        ),
        Prompt("battery-volts", "Voltage of a 9 V block by a meter, V:", ()),
        Prompt("low-battery-volts", "Voltage of a battery of 3 to 6 V by a meter, V:", ()),
        Prompt(
            "break-chain",
            f"A meter at the break chain: above {CHAIN_HIGH_V:g} V as it is, below {CHAIN_LOW_V:g} V with the "
            "e-stop pressed, and again with the door open?",
            _YES_NO,
        ),
        Prompt(
            "high-voltage",
            "May the high-voltage supply be switched on? Nothing sparks yet.",
            _YES_NO,
            danger=True,
        ),
        Prompt("stages", "May the stages move by 1 mm (theta by 5 degrees)?", _YES_NO, danger=True),
        Prompt("x-direction", "Which way did X go? Plus was commanded.", DIRECTIONS),
        Prompt("y-direction", "Which way did Y go? Plus was commanded.", DIRECTIONS),
        Prompt("theta-direction", "Which way did theta turn? Plus was commanded.", DIRECTIONS),
        Prompt("actuator", "May the actuator be driven, in small steps up to 40 V?", _YES_NO, danger=True),
        Prompt(
            "generator",
            "May the generator make pulses, 40 V and 0.1 A, tool far from the workpiece?",
            _YES_NO,
            danger=True,
        ),
    )
}
PROMPTS = ACTS | QUESTIONS


class Person(Protocol):
    """Acts and answers."""

    def ask(self, prompt: Prompt) -> str:
        """Return one of the options, or a number; empty for skipped."""

    def has_answered(self, key: str) -> bool:
        """Whether the answer is known beforehand and replaces the hands and eyes of a virtual machine."""


class Answers:
    """Answers written down before. What they lack is skipped, so no dangerous step is allowed by default."""

    def __init__(self, given: Mapping[str, str]) -> None:
        self._given = given

    def ask(self, prompt: Prompt) -> str:
        answer = self._given.get(prompt.key, "")
        return "" if answer == "skip" else answer

    def has_answered(self, key: str) -> bool:
        return key in self._given


ALL_ALLOWED = Answers({key: "yes" for key, question in QUESTIONS.items() if question.options == _YES_NO})
"""Every step is allowed: on a virtual machine only."""


def read_answers(path: Path) -> Answers:
    """Read a TOML file of answers by their keys.

    Raises UsageError E2065 if it cannot be read, or for an unknown key or an answer that is not an option.
    """
    try:
        table = tomllib.loads(read_bytes(path).decode("utf-8"))
    except OSError as error:
        raise failures.answer_unusable(problem=f"Cannot read {path}: {error.strerror}.") from error
    except (ValueError, RecursionError) as error:
        raise failures.answer_unusable(problem=f"{path} is not TOML: {error}.") from error
    given = {key: str(value) for key, value in table.items()}
    for key, answer in given.items():
        if key not in PROMPTS:
            raise failures.answer_unusable(problem=f"{path}: no item asks for {key}.")
        options = PROMPTS[key].options
        if answer in ("", *options, *(["skip"] if key in ACTS else [])) or (
            not options and is_number(answer)
        ):
            continue
        listed = ", ".join(options) or "numbers"
        problem = f"{path}: {key} = {answer!r} is not one of {listed}."
        if answer == "absent":
            problem += " A machine without it is not used."
        raise failures.answer_unusable(problem=problem)
    return Answers(given)


def is_number(text: str) -> bool:
    try:
        return abs(float(text)) < float("inf")
    except ValueError:
        return False


BEFORE = "+HV_SUPPLY +AMPLIFIER_DEAD"
"""Both supplies of a virtual machine are off at first."""
_BATTERIES = {"battery-volts": str(BATTERY_V), "low-battery-volts": str(LOW_BATTERY_V)}
_AXES = {"x-direction": Axis.X, "y-direction": Axis.Y, "theta-direction": Axis.THETA}
_MOVED = (100.0, 100.0, 1.0)
"""Least visible moves of x, y (µm) and theta (degrees): more than a stage's repeatability."""


class VirtualHands:
    """Acts by injections on a virtual machine in this process and observes its stages; `person` allows the steps."""

    def __init__(self, bench: VirtualBench, person: Person) -> None:
        self._bench, self._person = bench, person
        self._positions = self._now()
        self._change(BEFORE)

    def ask(self, prompt: Prompt) -> str:
        """Act or observe unless the person has answered beforehand."""
        key = prompt.key
        if key == "stages":
            self._positions = self._now()
        is_answered = self._person.has_answered(key)
        if prompt.changes:
            answer = self._person.ask(prompt) if is_answered else "done"
            if answer == "done":
                self._change(prompt.changes)
            return answer
        if not is_answered and key in _BATTERIES:
            return _BATTERIES[key]
        if is_answered or key not in _AXES:
            return self._person.ask(prompt)
        ways = [now - before for now, before in zip(self._now(), self._positions, strict=True)]
        moved = [abs(way) >= least for way, least in zip(ways, _MOVED, strict=True)]
        axis = _AXES[key]
        if not moved[axis]:
            return "other" if any(moved) else "none"
        return "plus" if ways[axis] > 0.0 else "minus"

    def _change(self, changes: str) -> None:
        for change in changes.split():
            if change[0] == "+":
                self._bench.inject(parse_injection(f"{change[1:]}@0"))
            else:
                self._bench.controller.injector.mend(change[1:])

    def _now(self) -> list[float]:
        plant = self._bench.plant
        return [*map(float, plant.position_um), plant.theta_deg]
