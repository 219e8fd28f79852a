"""What every generated message shares: its interface, and the errors of values that do not fit."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import ClassVar, Protocol, Self, TypeVar

MISFIT = (struct.error, OverflowError, ValueError)
"""What packing raises for a value that its wire type cannot hold."""

ReplyT_co = TypeVar("ReplyT_co", covariant=True)


class Message(Protocol):
    """Any message of either direction."""

    ID: ClassVar[int]
    NAME: ClassVar[str]

    def pack(self) -> bytes:
        """Return the payload; ValueError where a value does not fit its wire type."""
        ...

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        """Return the message; ValueError on a payload of the wrong length."""
        ...


class Request(Protocol[ReplyT_co]):
    """A command, which knows how its reply reads."""

    ID: ClassVar[int]
    NAME: ClassVar[str]

    def pack(self) -> bytes:
        """Return the payload."""
        ...

    def unpack_reply(self, payload: bytes) -> ReplyT_co:
        """Return the reply to this command; ValueError on a payload of the wrong length."""
        ...


@dataclass(frozen=True, slots=True)
class Param:
    """One controller parameter: value in `unit` = wire integer × `scale`."""

    id: int
    name: str
    unit: str
    scale: float
    default: float
    minimum: float
    maximum: float
    note: str

    def to_wire(self, value: float) -> int:
        """Return the integer that SET_PARAM carries; ValueError outside minimum..maximum."""
        if not self.minimum <= value <= self.maximum:
            raise ValueError(
                f"{self.name} = {value:g} {self.unit} is outside {self.minimum:g}..{self.maximum:g}"
            )
        return round(value * round(1 / self.scale))

    def from_wire(self, wire: int) -> float:
        """Return the value in `unit` of the integer that GET_PARAM answers."""
        return wire / round(1 / self.scale)


def wrong_length(name: str, expected: int, actual: int) -> ValueError:
    """Return the error of a payload that does not have its message's length."""
    return ValueError(f"{name}: payload of {actual} bytes, expected {expected}")


def misfit(message: Message, error: Exception) -> ValueError:
    """Return the error of a message whose value exceeds its wire type."""
    return ValueError(f"{message} does not fit the wire: {error}")


def ascii_bytes(text: str, size: int) -> bytes:
    """Encode a fixed-size ASCII field; ValueError where it is too long or holds a NUL."""
    data = text.encode("ascii")
    if len(data) > size or b"\0" in data:
        raise ValueError(f"{text!r} is not ASCII text of at most {size} characters")
    return data


def checked_records(records: bytes, n: int, record_size: int, room: int) -> bytes:
    """Return `records`; ValueError unless they are n whole records that fit into `room` bytes."""
    if len(records) != n * record_size or len(records) > room:
        raise ValueError(
            f"{len(records)} bytes are not {n} records of {record_size} bytes within {room} bytes"
        )
    return records


def checked_text(text: str, room: int) -> bytes:
    """Encode text that runs to the end of the payload; ValueError where it exceeds `room` bytes."""
    data = text.encode("utf-8")
    if len(data) > room:
        raise ValueError(f"text of {len(data)} bytes, {room} fit")
    return data
