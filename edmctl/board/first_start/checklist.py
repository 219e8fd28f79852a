"""The checklist as it goes: items in order, what builds on what, and how an error becomes a finding."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING

from edmctl.board.first_start.person import ACTS, QUESTIONS, Done, Person
from edmctl.board.results import Cause, Item, ItemStatus
from edmctl.dataclasses import dataclass, field
from edmctl.errors import EdmError, Interrupted, LinkLost, MachineFault, UsageError
from edmctl.link.faults import FaultCode
from edmctl.machine.faults import FaultLatched
from edmctl.machine.interface import MachineStatus

if TYPE_CHECKING:
    from edmctl.machine.controller import LinkMachine
    from edmctl.profile.setup import Setup

SETTLE_S = 0.3
"""After an act by hand: filters and switches have settled."""
READINGS, READING_S = 10, 0.02
"""A reading is the mean of so many, so far apart."""
NONE_OF_IT = "the machine has none, by the person"


class Skip(Exception):
    """An item that is left out, and why; `absent` where the machine has none of it."""

    def __init__(self, reason: str, *, absent: bool = False) -> None:
        super().__init__(reason)
        self.reason, self.absent = reason, absent


@dataclass(frozen=True, slots=True)
class Spec:
    """What an item is: what is done, what is expected, and which items it builds on."""

    key: str
    title: str
    done: str
    expected: str
    needs: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Found:
    """What was read, and what is likely to be wrong; nothing where all is right. `is_word`: nothing was read."""

    read: str
    causes: tuple[Cause, ...] = ()
    is_word: bool = False


def wrong(read: str, text: str, *nets: str) -> Found:
    """Return what was read with one likely mistake, and the nets that it is on."""
    return Found(read, (Cause(text, nets),))


@dataclass(slots=True)
class Checklist:
    """One machine, one person, and what was found so far.

    `told` hears of every item, `say` of readings in between. `cause_of` names the likely
    mistakes behind a fault of the controller. `battery_v` is what the gap sensor has read of a battery.
    """

    machine: LinkMachine
    setup: Setup
    person: Person
    told: Callable[[Item], None]
    say: Callable[[str], None]
    cause_of: Callable[[EdmError], tuple[Cause, ...]]
    part: str = ""
    items: list[Item] = field(default_factory=list)
    battery_v: float = 0.0

    def item(self, spec: Spec, look: Callable[[], Found]) -> bool:
        """Do an item unless it builds on one that is not right; whether it is right.

        Raises LinkLost, Interrupted, UsageError where nobody answers any more, MachineFault where somebody has
        pressed the emergency stop unasked. Whatever else goes wrong is a finding, with the machine safe and the
        fault cleared that the item has brought about.
        """
        lacking = [item.title for item in self.items if item.key in spec.needs and not item.is_right]
        if lacking:
            return self._add(spec, "", ItemStatus.SKIPPED, f"needs: {', '.join(lacking)}")
        try:
            found = look()
        except Skip as left_out:
            self.machine.safe_stop()
            status = ItemStatus.ABSENT if left_out.absent else ItemStatus.SKIPPED
            return self._add(spec, "", status, left_out.reason)
        except (Interrupted, UsageError) as stopped:
            self._add(spec, "", ItemStatus.SKIPPED, stopped.message)
            raise
        except LinkLost as error:
            self._add(spec, error.message, ItemStatus.FAIL, "", self.cause_of(error))
            raise
        except FaultLatched as latched:
            self.machine.safe_stop()
            return self._add(spec, "", ItemStatus.SKIPPED, latched.message)
        except EdmError as error:
            self.machine.safe_stop()
            is_right = self._add(spec, error.message, ItemStatus.FAIL, "", self.cause_of(error))
            if isinstance(error, MachineFault):
                if error.fault == FaultCode.ESTOP:
                    raise  # somebody wants it to end
                with suppress(EdmError):
                    self.machine.clear_fault(error.fault)
            return is_right
        return self.judge(spec, found)

    def judge(self, spec: Spec, found: Found) -> bool:
        """Add an item of what was read before; whether it is right."""
        right = ItemStatus.ANSWERED if found.is_word else ItemStatus.PASS
        status = ItemStatus.FAIL if found.causes else right
        return self._add(spec, found.read, status, "", found.causes)

    def skip(self, spec: Spec, reason: str, *, absent: bool = False) -> None:
        """Add an item that is left out."""
        self._add(spec, "", ItemStatus.ABSENT if absent else ItemStatus.SKIPPED, reason)

    def _add(
        self, spec: Spec, read: str, status: ItemStatus, reason: str, causes: tuple[Cause, ...] = ()
    ) -> bool:
        item = Item(spec.key, self.part, spec.title, spec.done, spec.expected, read, status, reason, causes)
        self.items.append(item)
        self.told(item)
        return item.is_right

    def is_right(self, *keys: str) -> bool:
        """Whether every item of these is right."""
        right = {item.key for item in self.items if item.is_right}
        return right.issuperset(keys)

    def has_failed(self, key: str) -> bool:
        """Whether an item has failed."""
        return any(item.key == key and item.status is ItemStatus.FAIL for item in self.items)

    def act(self, key: str) -> None:
        """Have something done by hand, and let it settle. Raises Skip."""
        act = ACTS[key]
        done = self.person.act(act)
        if done is Done.ABSENT and act.may_be_absent:
            raise Skip(NONE_OF_IT, absent=True)
        if done is not Done.DONE:
            raise Skip(f"{key}: {done}")
        self.machine.pass_time(SETTLE_S)

    def answer(self, key: str) -> str:
        """Ask. Raises Skip where there is no answer, or none of the options."""
        question = QUESTIONS[key]
        answer = self.person.answer(question)
        if not answer or (question.options and answer not in question.options):
            raise Skip(f"{key}: no answer")
        if answer == "absent":
            raise Skip(NONE_OF_IT, absent=True)
        return answer

    def allow(self, key: str) -> Found:
        """Ask whether a step may be done. Raises Skip unless the answer is yes."""
        if self.answer(key) != "yes":
            raise Skip(f"{key}: not allowed")
        return Found("yes", is_word=True)

    def read(self) -> list[MachineStatus]:
        """Readings one behind the other, unbelieved."""
        found = []
        for _ in range(READINGS):
            self.machine.pass_time(READING_S)
            found.append(self.machine.readings())
        return found


def mean(values: list[float]) -> float:
    """The mean of some numbers."""
    return sum(values) / len(values)
