"""What the checklist of a first start has found: what was done, expected and read, and what is wired wrongly."""

from __future__ import annotations

from enum import StrEnum

from edmctl.dataclasses import dataclass


class ItemStatus(StrEnum):
    """How an item came out."""

    PASS = "pass"
    ANSWERED = "answered"
    """A person has said yes, and nothing was checked."""
    FAIL = "fail"
    SKIPPED = "skipped"
    ABSENT = "absent"
    """The machine has none of it, and may be without: what builds on it is done."""


@dataclass(frozen=True, slots=True)
class Cause:
    """A likely mistake, in plain words, and the nets that it is on."""

    text: str
    nets: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Item:
    """One line of the checklist. `reason` says why it was skipped; `causes` stand beside a failure."""

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
        """Whether what builds on it may be done."""
        return self.status in (ItemStatus.PASS, ItemStatus.ANSWERED, ItemStatus.ABSENT)


@dataclass(frozen=True, slots=True)
class FirstStartReport:
    """The whole checklist.

    `complete`: nothing has failed or was skipped. `absent` has the keys of what the machine does without. `ended`
    says what broke it off.
    """

    machine: str
    simulated: bool
    started: str
    items: tuple[Item, ...]
    complete: bool
    absent: tuple[str, ...]
    ended: str
