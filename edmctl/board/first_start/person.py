"""The operator of a first start: who acts and answers, and the hands of a virtual machine."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path

from edmctl import failures
from edmctl.board.first_start.checklist import ACTS, PROMPTS, QUESTIONS, YES_NO, Person
from edmctl.files import read_bytes
from edmctl.link.messages import Axis
from edmctl.simulator import VirtualBench
from edmctl.simulator.injection import BATTERY_V, LOW_BATTERY_V, parse_injection


class Answers:
    """Answers written down before. What they lack is skipped, so no dangerous step is allowed by default."""

    def __init__(self, given: Mapping[str, str]) -> None:
        self._given = given

    def ask(self, key: str) -> str:
        answer = self._given.get(key, "")
        return "" if answer == "skip" else answer

    def has_answered(self, key: str) -> bool:
        return key in self._given


ALL_ALLOWED = Answers({key: "yes" for key, question in QUESTIONS.items() if question.options == YES_NO})
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
        allowed = ["", *options, *(["skip"] if key in ACTS else [])]
        if answer in allowed or (not options and is_number(answer)):
            continue
        problem = f"{path}: {key} = {answer!r} is not one of {', '.join(options) or 'numbers'}."
        if answer == "absent":
            problem += " A machine without it is not used."
        raise failures.answer_unusable(problem=problem)
    return Answers(given)


def is_number(text: str) -> bool:
    try:
        return abs(float(text)) < float("inf")
    except ValueError:
        return False


_BATTERIES = {"battery-volts": str(BATTERY_V), "low-battery-volts": str(LOW_BATTERY_V)}
_AXES = {"x-direction": Axis.X, "y-direction": Axis.Y, "theta-direction": Axis.THETA}
_MOVED = (100.0, 100.0, 1.0)
"""Least visible moves of x, y (µm) and theta (degrees): more than a stage's repeatability."""


class VirtualHands:
    """Acts by injections on a virtual machine in this process and observes its stages; `person` allows the steps."""

    def __init__(self, bench: VirtualBench, person: Person) -> None:
        self._bench, self._person = bench, person
        self._positions = self._now()
        self._change("+HV_SUPPLY +AMPLIFIER_DEAD")  # both supplies are off at first

    def ask(self, key: str) -> str:
        """Act or observe unless the person has answered beforehand."""
        if key == "stages":
            self._positions = self._now()
        if key in ACTS and not self.has_answered(key):
            self._change(ACTS[key].changes)
            return "done"
        if self.has_answered(key) or key not in (*_BATTERIES, *_AXES):
            answer = self._person.ask(key)
            if answer == "done":
                self._change(ACTS[key].changes)
            return answer
        if key in _BATTERIES:
            return _BATTERIES[key]
        ways = [now - before for now, before in zip(self._now(), self._positions, strict=True)]
        moved = [abs(way) >= least for way, least in zip(ways, _MOVED, strict=True)]
        axis = _AXES[key]
        if not moved[axis]:
            return "other" if any(moved) else "none"
        return "plus" if ways[axis] > 0.0 else "minus"

    def has_answered(self, key: str) -> bool:
        return self._person.has_answered(key)

    def _change(self, changes: str) -> None:
        for change in changes.split():
            if change[0] == "+":
                self._bench.inject(parse_injection(f"{change[1:]}@0"))
            else:
                self._bench.controller.injector.mend(change[1:])

    def _now(self) -> list[float]:
        plant = self._bench.plant
        return [*map(float, plant.position_um), plant.theta_deg]
