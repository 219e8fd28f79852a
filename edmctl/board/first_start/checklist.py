"""The checklist: items with their dependencies, and how a reading or an error becomes a result."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from enum import StrEnum
from statistics import fmean
from typing import TYPE_CHECKING, Any

from edmctl.board.first_start.person import PROMPTS, Prompt
from edmctl.dataclasses import dataclass, field
from edmctl.errors import EdmError, Interrupted, LinkLost, MachineFault, UsageError
from edmctl.link.faults import FaultCode
from edmctl.machine.faults import FaultLatched
from edmctl.machine.interface import MachineStatus

if TYPE_CHECKING:
    from edmctl.machine.controller import LinkMachine
    from edmctl.profile.setup import Setup

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


def cause(text: str, *nets: str) -> Cause:
    return Cause(text, nets)


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

    def titles(self, status: ItemStatus) -> list[str]:
        return [item.title for item in self.items if item.status is status]


@dataclass(frozen=True, slots=True)
class Finding:
    """What was read, and the likely mistakes; none if all is right. `answered`: an answer, not a reading."""

    read: str
    causes: tuple[Cause, ...] = ()
    answered: bool = False


def wrong(read: str, text: str, *nets: str) -> Finding:
    """Return a reading with one likely mistake and the nets that it is on."""
    return Finding(read, (Cause(text, nets),))


class Skip(Exception):
    """An item is left out for a reason; `absent` if the machine is without the part."""

    def __init__(self, reason: str, *, absent: bool = False) -> None:
        super().__init__(reason)
        self.reason, self.absent = reason, absent


@dataclass(frozen=True, slots=True)
class Check:
    """A declared item: `look` does it, once the items with the keys `needs` are right."""

    key: str
    title: str
    done: str
    expected: str | Callable[[Setup], str]
    needs: tuple[str, ...]
    look: Callable[[Checklist], Finding]


@dataclass(slots=True)
class Part:
    """Checks under one heading, in their order."""

    title: str
    checks: list[Check] = field(default_factory=list)

    def check(
        self, key: str, title: str, done: str, expected: str | Callable[[Setup], str], needs: str = ""
    ) -> Callable[[Callable[[Checklist], Finding]], Check]:
        """Declare a check by a decorator of its function; `needs` are keys of items, separated by spaces."""

        def declare(look: Callable[[Checklist], Finding]) -> Check:
            self.checks.append(Check(key, title, done, expected, tuple(needs.split()), look))
            return self.checks[-1]

        return declare


@dataclass(slots=True)
class Checklist:
    """One machine, the results so far, and what checks keep for later ones in `kept`.

    ask_person : returns the answer to a prompt. show : called with every item. say : called with other readings.
    causes_of : likely mistakes behind an error.
    """

    machine: LinkMachine
    setup: Setup
    ask_person: Callable[[Prompt], str]
    show: Callable[[Item], None]
    say: Callable[[str], None]
    causes_of: Callable[[EdmError], tuple[Cause, ...]]
    items: list[Item] = field(default_factory=list)
    kept: dict[str, Any] = field(default_factory=dict)

    def run_all(self, parts: Sequence[Part]) -> None:
        """Do every item; nothing if the machine is not ready for the first."""
        for part in parts:
            for check in part.checks:
                if not self.run(part, check) and check.key == "ready":
                    return

    def run(self, part: Part, check: Check) -> bool:
        """Do an item unless one that it needs is not right; return whether it is right.

        Any other error is a result: the machine is made safe and the fault cleared that the item has provoked.

        Raises LinkLost, Interrupted, UsageError if no answers come any more, MachineFault for an emergency stop that
        was not requested.
        """
        expected = check.expected if isinstance(check.expected, str) else check.expected(self.setup)

        def add(status: ItemStatus, read: str = "", reason: str = "", causes: tuple[Cause, ...] = ()) -> bool:
            item = Item(
                check.key, part.title, check.title, check.done, expected, read, status, reason, causes
            )
            self.items.append(item)
            self.show(item)
            return item.is_right

        lacking = [item.title for item in self.items if item.key in check.needs and not item.is_right]
        if lacking:
            return add(ItemStatus.SKIPPED, reason=f"needs: {', '.join(lacking)}")
        try:
            finding = check.look(self)
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
            add(ItemStatus.FAIL, error.message, causes=self.causes_of(error))
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
        prompt = PROMPTS[key]
        answer = self.ask_person(prompt)
        if not answer or (prompt.options and answer not in prompt.options):
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
