"""Who stands at the machine: does what the program cannot do, and says what it cannot see."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import Protocol

from edmctl import failures
from edmctl.dataclasses import dataclass
from edmctl.errors import UsageError
from edmctl.files import read_bytes

CHAIN_HIGH_V, CHAIN_LOW_V = 2.3, 0.8
"""Of the break chain, at the pin: what is high and what is low to the chip."""


class Done(StrEnum):
    """What became of an act."""

    DONE = "done"
    SKIP = "skip"
    ABSENT = "absent"


@dataclass(frozen=True, slots=True)
class Act:
    """Something to do by hand.

    changes : what it is on a virtual machine: injections that begin (+) or end (-). may_be_absent : a machine may be
    without the part that it is about.
    """

    key: str
    changes: str
    text: str
    may_be_absent: bool = False


@dataclass(frozen=True, slots=True)
class Question:
    """Something to see or to allow: `options` are the answers, none for a number. `danger`: it energises."""

    key: str
    text: str
    options: tuple[str, ...] = ("yes", "no")
    danger: bool = False


class Person(Protocol):
    """Does and answers. What nobody answers is skipped: nothing is taken for granted."""

    def act(self, act: Act) -> Done:
        """Do it, and say so."""

    def answer(self, question: Question) -> str:
        """One of the options or a number; empty where there is no answer."""


class Asked(Person, Protocol):
    """Who is asked behind the hands and eyes of a virtual machine."""

    def has_answered(self, key: str) -> bool:
        """Whether this was said before: then no program's hands or eyes take the person's place."""


ACTS = {
    act.key: act
    for act in (
        Act("estop-press", "+ESTOP", "Press the emergency stop."),
        Act("estop-release", "-ESTOP", "Release the emergency stop."),
        Act("door-open", "+DOOR", "Open the door."),
        Act("door-close", "-DOOR", "Close the door."),
        Act(
            "level-low",
            "+DIELECTRIC_LEVEL",
            "Bring the level switch of the dielectric to 'too low': let its float sink, or drain.",
        ),
        Act(
            "level-ok",
            "-DIELECTRIC_LEVEL",
            "Bring the level switch back to 'ok': let its float rise, or fill up.",
        ),
        Act("pump-off", "+DIELECTRIC_FLOW", "Switch the pump of the dielectric off."),
        Act("pump-on", "-DIELECTRIC_FLOW", "Switch the pump on again."),
        Act("contact-close", "+WIRE_SHORT", "Connect tool and work with a wire."),
        Act("contact-open", "-WIRE_SHORT", "Take the wire off."),
        Act(
            "battery-on",
            "+BATTERY",
            "Connect the battery over 1 kΩ to the gap, plus to the generator's plus.",
        ),
        Act(
            "low-battery-on",
            "+LOW_BATTERY",
            "Connect the battery of lower voltage over 1 kΩ to the gap, plus to the generator's plus.",
        ),
        Act(
            "battery-turn",
            "-BATTERY -LOW_BATTERY +BATTERY_TURNED",
            "Turn the battery round, plus to minus.",
        ),
        Act("battery-off", "-BATTERY -LOW_BATTERY -BATTERY_TURNED", "Take the battery off."),
        Act(
            "supply-on",
            "-HV_SUPPLY",
            "Switch the high-voltage supply on; the amplifier of the actuator stays off.",
        ),
        Act(
            "limit-close",
            "+STAGE_LIMIT",
            "Hold a limit switch of the stages closed by hand.",
            may_be_absent=True,
        ),
        Act("limit-open", "-STAGE_LIMIT", "Let go of the limit switch."),
        Act("amplifier-on", "-AMPLIFIER_DEAD", "Switch the amplifier of the actuator on."),
    )
}
"""Everything that may be asked to be done, by its key."""

DIRECTIONS = ("plus", "minus", "none", "other", "absent")
QUESTIONS = {
    question.key: question
    for question in (
        Question(
            "ready",
            "High-voltage supply and amplifier off, tool at least 2 mm from work and holder, e-stop released, door "
            "closed, dielectric flowing, nobody's hand at the stages?",
        ),
        Question("battery-volts", "Voltage of a 9 V block by a meter, V:", ()),
        Question("low-battery-volts", "Voltage of a battery of 3 to 6 V by a meter, V:", ()),
        Question(
            "break-chain",
            f"A meter at the break chain: above {CHAIN_HIGH_V:g} V as it is, below {CHAIN_LOW_V:g} V with the "
            "e-stop pressed, and again with the door open?",
        ),
        Question(
            "high-voltage", "May the high-voltage supply be switched on? Nothing sparks yet.", danger=True
        ),
        Question("stages", "May the stages move by 1 mm (theta by 5 degrees)?", danger=True),
        Question("x-direction", "Which way did X go? Plus was commanded.", DIRECTIONS),
        Question("y-direction", "Which way did Y go? Plus was commanded.", DIRECTIONS),
        Question("theta-direction", "Which way did theta turn? Plus was commanded.", DIRECTIONS),
        Question("actuator", "May the actuator be driven, in small steps up to 40 V?", danger=True),
        Question(
            "generator", "May the generator make pulses, 40 V and 0.1 A, tool far from the work?", danger=True
        ),
    )
}
"""Everything that may be asked, by its key."""


class Answers:
    """Answers that were written down before. What is not among them is skipped, and no dangerous step is allowed."""

    def __init__(self, given: Mapping[str, str]) -> None:
        self._given = given

    def act(self, act: Act) -> Done:
        """What the answers say of it."""
        return Done(self._given.get(act.key) or Done.SKIP)

    def answer(self, question: Question) -> str:
        """What the answers say."""
        return self._given.get(question.key, "")

    def has_answered(self, key: str) -> bool:
        """Whether it is among the answers."""
        return key in self._given


ALL_ALLOWED = Answers(
    {key: "yes" for key, question in QUESTIONS.items() if question.options == ("yes", "no")}
)
"""Every step is allowed: for a virtual machine alone."""


def read_answers(path: Path) -> Answers:
    """Read a TOML file of answers by their keys.

    Raises UsageError E2065 where it cannot be read, or says what nobody asks or cannot be answered so: that there is
    none of what no machine may do without, too.
    """
    try:
        table = tomllib.loads(read_bytes(path).decode("utf-8"))
    except OSError as refused:
        raise _unfit(f"Cannot read {path}: {refused.strerror}.") from refused
    except ValueError as wrong:
        raise _unfit(f"{path} is no TOML: {wrong}.") from wrong
    except RecursionError as deep:
        raise _unfit(f"{path}: its brackets go too deep.") from deep
    given = {}
    for key, value in table.items():
        if key not in ACTS and key not in QUESTIONS:
            raise _unfit(f"{path}: nobody asks for {key}.")
        given[key] = word = str(value)
        allowed = _words_for(key)
        if word == Done.ABSENT and word not in allowed:
            raise _unfit(f"{path}: {key} = {word!r}: {_why_not_absent(key)}.")
        if not (word in allowed or word == "" or (not allowed and is_number(word))):
            raise _unfit(f"{path}: {key} = {word!r} is none of {', '.join(allowed) or 'the numbers'}.")
    return Answers(given)


def _words_for(key: str) -> list[str]:
    if key not in ACTS:
        return [*QUESTIONS[key].options]
    return [str(one) for one in Done if one is not Done.ABSENT or ACTS[key].may_be_absent]


def _why_not_absent(key: str) -> str:
    if key in ("level-low", "level-ok", "pump-off", "pump-on"):
        return "the checklist arms with the dielectric required, and goes by its level and flow"
    offered = ", ".join(key for key in (*ACTS, *QUESTIONS) if Done.ABSENT in _words_for(key))
    return f"no machine is used without it; only these may be absent: {offered}"


def is_number(text: str) -> bool:
    """Whether a text is a number."""
    try:
        return abs(float(text)) < float("inf")
    except ValueError:
        return False


def _unfit(message: str) -> UsageError:
    return failures.answer_unusable(problem=message)
