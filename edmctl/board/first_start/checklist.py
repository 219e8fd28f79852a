"""The checklist: items as checklist.toml declares them, and how a reading or an error becomes a result."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from contextlib import suppress
from enum import StrEnum
from importlib.resources import files
from statistics import fmean
from typing import TYPE_CHECKING, Any, Protocol

from edmctl.dataclasses import dataclass, field
from edmctl.errors import EdmError, Interrupted, LinkLost, MachineFault, UsageError
from edmctl.link.faults import FaultCode
from edmctl.machine.faults import FaultLatched
from edmctl.machine.interface import MachineStatus

if TYPE_CHECKING:
    from edmctl.machine.controller import LinkMachine
    from edmctl.profile.setup import Setup

DECLARED: dict[str, Any] = tomllib.loads(
    files("edmctl.board.first_start").joinpath("checklist.toml").read_text(encoding="utf-8")
)
NETS: dict[str, str] = DECLARED["nets"]

SETTLE_S = 0.3
"""Filters and switches settle within this after an operator action."""
READINGS, READING_S = 10, 0.02
"""A reading is the mean of 10 samples, 20 ms apart."""
NOT_FITTED = "no sensor is fitted by the setup"


class ItemStatus(StrEnum):
    """Result of an item. ANSWERED: only an answer, no reading. ABSENT: the machine may be, and is, without it."""

    PASS = "pass"
    ANSWERED = "answered"
    FAIL = "fail"
    SKIPPED = "skipped"
    ABSENT = "absent"


@dataclass(frozen=True, slots=True)
class Cause:
    """A likely wiring mistake and the nets that it is on."""

    text: str
    nets: tuple[str, ...]


def mistake(name: str, *nets: str, **values: object) -> Cause:
    """Return a declared mistake, or that of a fault, with its values; `nets` come before its own."""
    row = DECLARED["mistakes"].get(name) or DECLARED["faults"][name]
    declared = (NETS[net] for net in row.get("nets", "").split())
    return Cause(row["text"].format(**values), (*nets, *declared))


@dataclass(frozen=True, slots=True)
class Item:
    """One line of the report. `reason` says why it was skipped; `causes` are those of a failure."""

    key: str
    part: str
    title: str
    done: str
    expected: str
    read: str
    status: ItemStatus
    reason: str = ""
    causes: tuple[Cause, ...] = ()

    @property
    def is_right(self) -> bool:
        """Whether items that depend on it may be done."""
        return self.status in (ItemStatus.PASS, ItemStatus.ANSWERED, ItemStatus.ABSENT)


@dataclass(frozen=True, slots=True)
class FirstStartReport:
    """The whole checklist.

    `complete`: no item failed or was skipped. `absent`: keys of what the machine is without. `ended`: the message of
    the error that ended it early.
    """

    machine: str
    simulated: bool
    started: str
    items: tuple[Item, ...]
    complete: bool
    absent: tuple[str, ...]
    ended: str


@dataclass(frozen=True, slots=True)
class Finding:
    """What was read, and the likely mistakes; none if all is right. `answered`: an answer, not a reading."""

    read: str
    causes: tuple[Cause, ...] = ()
    answered: bool = False


def wrong(read: str, name: str, *nets: str, **values: object) -> Finding:
    """Return a reading with one declared mistake."""
    return Finding(read, (mistake(name, *nets, **values),))


@dataclass(frozen=True, slots=True)
class Prompt:
    """An action (option `done`) or a question; no options: a number.

    danger : the step energises something. changes : of an action, the injections on a virtual machine.
    """

    key: str
    text: str
    options: list[str]
    danger: bool = False
    changes: str = ""


YES_NO = ["yes", "no"]
ACTS = {key: Prompt(key, **{"options": ["done"], **row}) for key, row in DECLARED["acts"].items()}
QUESTIONS = {key: Prompt(key, **{"options": YES_NO, **row}) for key, row in DECLARED["questions"].items()}
PROMPTS = ACTS | QUESTIONS


class Person(Protocol):
    """Acts and answers."""

    def ask(self, key: str) -> str:
        """Return one of the options, or a number; empty for skipped."""

    def has_answered(self, key: str) -> bool:
        """Whether the answer is known beforehand and replaces the hands and eyes of a virtual machine."""


class Skip(Exception):
    """An item is left out for a reason; `absent` if the machine is without the part."""

    def __init__(self, reason: str, *, absent: bool = False) -> None:
        super().__init__(reason)
        self.reason, self.absent = reason, absent


Look = Callable[["Checklist"], Finding]
_LOOKS: dict[str, tuple[Look, dict[str, object]]] = {}


def check(key: str, **values: object) -> Callable[[Look], Look]:
    """Declare the function of an item, with the values of its texts."""

    def declare(look: Look) -> Look:
        _LOOKS[key] = look, values
        return look

    return declare


@dataclass(slots=True)
class Checklist:
    """One machine, the results so far, and what checks keep for later ones in `kept`.

    show : called with every item. say : called with other readings.
    """

    machine: LinkMachine
    setup: Setup
    person: Person
    show: Callable[[Item], None]
    say: Callable[[str], None]
    items: list[Item] = field(default_factory=list)
    kept: dict[str, Any] = field(default_factory=dict)

    def run(self) -> None:
        """Do every item; nothing more if the machine is not ready for the first. Raises as `run_item`."""
        for part, rows in DECLARED["items"].items():
            for key, row in rows.items():
                if not self.run_item(part, key, row) and key == "ready":
                    return

    def run_item(self, part: str, key: str, row: dict[str, str]) -> bool:
        """Do an item unless one that it needs is not right; return whether it is right.

        Any other error is a result: the machine is made safe and the fault cleared that the item has provoked.

        Raises LinkLost, Interrupted, UsageError if no answers come any more, MachineFault for an emergency stop that
        was not requested.
        """
        look, values = _LOOKS[key]
        done, expected = (row[name].format(**values, setup=self.setup) for name in ("done", "expected"))

        def add(status: ItemStatus, read: str = "", reason: str = "", causes: tuple[Cause, ...] = ()) -> bool:
            item = Item(key, part, row["title"], done, expected, read, status, reason, causes)
            self.items.append(item)
            self.show(item)
            return item.is_right

        needs = row.get("needs", "").split()
        if lacking := [item.title for item in self.items if item.key in needs and not item.is_right]:
            return add(ItemStatus.SKIPPED, reason=f"needs: {', '.join(lacking)}")
        try:
            finding = look(self)
        except Skip as skip:
            self.machine.safe_stop()
            return add(ItemStatus.ABSENT if skip.absent else ItemStatus.SKIPPED, reason=skip.reason)
        except (Interrupted, UsageError) as stopped:
            add(ItemStatus.SKIPPED, reason=stopped.message)
            raise
        except FaultLatched as latched:
            self.machine.safe_stop()
            return add(ItemStatus.SKIPPED, reason=latched.message)
        except EdmError as error:
            self.machine.safe_stop()
            add(ItemStatus.FAIL, error.message, causes=(likely_cause(error),))
            if isinstance(error, LinkLost):
                raise
            if isinstance(error, MachineFault):
                if error.fault == FaultCode.ESTOP:
                    raise
                with suppress(EdmError):
                    self.machine.clear_fault(error.fault)
            return False
        right = ItemStatus.ANSWERED if finding.answered else ItemStatus.PASS
        return add(ItemStatus.FAIL if finding.causes else right, finding.read, causes=finding.causes)

    def status_of(self, key: str) -> ItemStatus:
        return next(item.status for item in self.items if item.key == key)

    def ask(self, key: str) -> str:
        """Return an answer. Raises Skip if there is none, or if the machine is without the part."""
        answer, options = self.person.ask(key), PROMPTS[key].options
        if not answer or (options and answer not in options):
            raise Skip(f"{key}: skipped")
        if answer == "absent":
            raise Skip("the machine has none, according to the operator", absent=True)
        return answer

    def act(self, key: str) -> None:
        """Request an operator action and let it settle. Raises Skip."""
        self.ask(key)
        self.machine.pass_time(SETTLE_S)

    def allow(self, key: str) -> Finding:
        """Ask for permission. Raises Skip unless the answer is yes."""
        if self.ask(key) != "yes":
            raise Skip(f"{key}: not allowed")
        return Finding("yes", answered=True)

    def read(self) -> list[MachineStatus]:
        readings = []
        for _ in range(READINGS):
            self.machine.pass_time(READING_S)
            readings.append(self.machine.readings())
        return readings

    def mean(self, name: str) -> float:
        """Return the mean reading of one value of the status."""
        return fmean(getattr(status, name) for status in self.read())

    def resting_um(self) -> float:
        """Return the displacement now; 0 without a sensor."""
        return self.mean("displacement_um") if self.setup.sensor.fitted else 0.0


def likely_cause(error: EdmError) -> Cause:
    """Return the likely mistake behind an error of machine or host during an item."""
    if isinstance(error, LinkLost):
        return mistake("line_lost")
    if isinstance(error, MachineFault):
        name = next((code.name for code in FaultCode if code == error.fault), "")
        if name in DECLARED["faults"]:
            return mistake(name)
    return mistake("unusual", hint=error.hint or error.message)
