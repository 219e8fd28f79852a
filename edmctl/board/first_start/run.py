"""What `edmctl first-start` does, from connecting to the report, and the answers of a file or of a program."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path

from edmctl import failures
from edmctl.board.first_start import cold, generator, motion  # noqa: F401  # declare the checks
from edmctl.board.first_start.checklist import (
    ACTS,
    PROMPTS,
    QUESTIONS,
    YES_NO,
    Checklist,
    FirstStartReport,
    Item,
    ItemStatus,
    Person,
)
from edmctl.errors import EdmError
from edmctl.files import read_bytes
from edmctl.jobs.connect import connected
from edmctl.jobs.plan import MachineAddress
from edmctl.jobs.surroundings import Surroundings
from edmctl.link.messages import Axis
from edmctl.machine.controller import LinkMachine
from edmctl.profile.setup import Setup
from edmctl.simulator import VirtualBench
from edmctl.simulator.injection import BATTERY_V, LOW_BATTERY_V, parse_injection


def first_start(
    setup: Setup,
    where: MachineAddress,
    seed: int,
    person: Callable[[LinkMachine], Person],
    show: Callable[[Item], None],
    say: Callable[[str], None],
    surroundings: Surroundings,
) -> tuple[FirstStartReport, EdmError | None]:
    """Go through the checklist; return the report, and the error that ended it early.

    person : makes the one who answers, of the connected machine. At a virtual machine in this process the program
    acts and observes.

    Raises what connecting raises. Whatever happens later, everything on the machine is switched off.
    """
    started = datetime.now(UTC).isoformat(timespec="seconds")
    error: EdmError | None = None
    with ExitStack() as held:
        bench = held.enter_context(connected(None, setup, seed, say, where, surroundings, wires_known=False))
        bench.begin()
        setup = bench.own_setup or setup
        say(f"first-start: {setup.in_words()}")
        machine = bench.machine
        operator = person(machine)
        if bench.virtual is not None:
            say(
                "first-start: this program acts at the virtual machine and observes it, unless answers say so"
            )
            operator = VirtualHands(bench.virtual, operator)
        checklist = Checklist(machine, setup, operator, show, say)
        try:
            checklist.run()
        except EdmError as ended:
            error = ended
        finally:
            machine.safe_stop()
        identity, items = machine.identity, tuple(checklist.items)
        report = FirstStartReport(
            f"{identity.serial} at {identity.transport}, firmware {identity.firmware}",
            identity.simulated,
            started,
            items,
            complete=error is None and all(item.is_right for item in items),
            absent=tuple(item.key for item in items if item.status is ItemStatus.ABSENT),
            ended=error.message if error else "",
        )
        return report, error


def verdict(report: FirstStartReport) -> EdmError | None:
    """Return the error of a complete checklist with failed or, else, skipped items; None if all is right."""
    endings = {ItemStatus.FAIL: failures.items_failed, ItemStatus.SKIPPED: failures.items_skipped}
    for status, failure in endings.items():
        if titles := [item.title for item in report.items if item.status is status]:
            return failure(count=len(titles), items=len(report.items), titles=", ".join(titles))
    return None


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
