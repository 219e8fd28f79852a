"""Facts about images and boards, and the checklist of a first start with its likely mistakes."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import Any

from edmctl.dataclasses import dataclass
from edmctl.wording import dotted


@dataclass(frozen=True, slots=True)
class Section:
    """A section of an image that takes memory: flash, RAM or CCM, and two of them for initial values."""

    name: str
    address: int
    size_bytes: int
    memories: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class ImageFacts:
    """What the record in an image says, and what its file holds.

    sections : of an ELF; other files have none. has_same_schema : as this program. settings : of the machine's
    owner, by their names in the sources, where they are other ones than there.
    """

    path: str
    kind: str
    board: int
    board_name: str
    protocol: tuple[int, int]
    firmware: tuple[int, int, int]
    schema_hash: int
    size_bytes: int
    crc32: int
    sections: tuple[Section, ...]
    has_same_schema: bool
    settings: dict[str, float]

    def used_bytes(self) -> dict[str, int]:
        """Bytes of each memory that sections take."""
        used: dict[str, int] = {}
        for section in self.sections:
            for memory in section.memories:
                used[memory] = used.get(memory, 0) + section.size_bytes
        return used

    def as_mapping(self) -> dict[str, Any]:
        """All of it as plain values."""
        return {
            "file": self.path,
            "kind": self.kind,
            "board": self.board,
            "board_name": self.board_name,
            "protocol": dotted(self.protocol),
            "firmware": dotted(self.firmware),
            "schema": hexadecimal(self.schema_hash),
            "has_same_schema": self.has_same_schema,
            "size_bytes": self.size_bytes,
            "crc32": hexadecimal(self.crc32),
            "settings": self.settings,
            "used_bytes": self.used_bytes(),
            "sections": [
                {
                    "name": s.name,
                    "address": hexadecimal(s.address),
                    "size_bytes": s.size_bytes,
                    "memories": list(s.memories),
                }
                for s in self.sections
            ],
        }


@dataclass(frozen=True, slots=True)
class BoardFacts:
    """What a controller says of itself without a session.

    firmware, board, serial, state, fault, boot_count : None where it speaks another schema and does not tell that.
    differing : names that its schema and this program's do not share, as far as they are known.
    """

    port: str
    protocol: tuple[int, int]
    schema_hash: int
    has_same_schema: bool
    firmware: tuple[int, int, int] | None = None
    board: int | None = None
    board_name: str = ""
    serial: str | None = None
    state: str | None = None
    fault: int | None = None
    boot_count: int | None = None
    baud: int | None = None
    differing: tuple[str, ...] = ()

    def as_mapping(self) -> dict[str, Any]:
        """All of it as plain values."""
        return {
            "port": self.port,
            "serial": self.serial,
            "board": self.board,
            "board_name": self.board_name,
            "protocol": dotted(self.protocol),
            "firmware": dotted(self.firmware) if self.firmware else None,
            "schema": hexadecimal(self.schema_hash),
            "has_same_schema": self.has_same_schema,
            "state": self.state,
            "fault": self.fault,
            "boot_count": self.boot_count,
            "baud": self.baud,
            "differing": list(self.differing),
        }


def settings_text(settings: Mapping[str, float]) -> str:
    """Say what was `--set` in an image."""
    return ", ".join(f"{name} {value:.9g}" for name, value in settings.items()) or "as in the sources"


def hexadecimal(number: int) -> str:
    """Return a hash or an address of 32 bits as people write it."""
    return f"0x{number:08X}"


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
