"""What every message shares: packing and unpacking by a table of wire types; and parameters of the controller."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import fields as dataclass_fields
from functools import cache
from typing import TYPE_CHECKING, ClassVar, Generic, Self, TypeVar, cast

from edmctl.dataclasses import dataclass, replace
from edmctl.link.frame import MAX_PAYLOAD

if TYPE_CHECKING:
    import numpy as np

STRUCT_CODES = {
    "u8": "B",
    "i8": "b",
    "u16": "H",
    "i16": "h",
    "u32": "I",
    "i32": "i",
    "u64": "Q",
    "s12": "12s",
}
"""Format character of each wire type of fixed size; all are little-endian."""
NUMPY_CODES = {"u8": "u1", "i8": "i1", "u16": "<u2", "i16": "<i2", "u32": "<u4", "i32": "<i4", "u64": "<u8"}

_MISFIT = (struct.error, OverflowError, ValueError)
"""What packing raises for a value that its wire type cannot hold."""

ReplyT_co = TypeVar("ReplyT_co", covariant=True)
MessageT = TypeVar("MessageT", bound="Message")


@dataclass(slots=True)
class Message:
    """Any message of either direction, with its fields in wire order.

    WIRE : type of each field, separated by blanks. "u32" is an integer as it stands; "u32/1000" carries 1000
        counts per unit of the field; "s12" is ASCII text of fixed size. The last may be "utf8", text that runs to
        the end of the payload, or "records", of which the field `n` says how many there are.
    RECORD : name, wire type and value of one count for each column of a record.
    """

    ID: ClassVar[int]
    NAME: ClassVar[str]
    WIRE: ClassVar[str] = ""
    RECORD: ClassVar[tuple[tuple[str, str, float], ...]] = ()

    def pack(self) -> bytes:
        """Return the payload; ValueError where a value does not fit its wire type."""
        _compile(type(self))
        return self.pack()

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        """Return the message; ValueError on a payload of the wrong length."""
        _compile(cls)
        return cls.unpack(payload)

    @classmethod
    @cache
    def record_dtype(cls) -> np.dtype[np.void]:
        """Return the dtype of one record: packed wire integers; the same one every time."""
        import numpy as np

        return np.dtype([(name, NUMPY_CODES[type_]) for name, type_, _ in cls.RECORD])

    @classmethod
    def record_scales(cls) -> dict[str, float]:
        """Return the value of one count for each column of a record, in the unit of its name."""
        return {name: scale for name, _, scale in cls.RECORD}


class Ack(Message):
    """The reply to a command that has only its status to answer."""

    ID, NAME = 0x00, "ACK"


class Request(Message, Generic[ReplyT_co]):
    """A command, which knows how its reply reads."""

    __slots__ = ()

    REPLY: ClassVar[type[Message]] = Ack

    def unpack_reply(self, payload: bytes) -> ReplyT_co:
        """Return the reply to this command; ValueError on a payload of the wrong length."""
        return cast("ReplyT_co", self.REPLY.unpack(payload))


_CODEC = """
def pack(self):
    try:
        return pack_fields({values}){tail}
    except misfits as error:
        raise ValueError(f"{{self}} does not fit the wire: {{error}}") from None

def unpack(cls, payload):
    if len(payload) != ({length}):
        raise ValueError(f"{{cls.NAME}}: payload of {{len(payload)}} bytes, expected {{{length}}}")
    {names} = unpack_fields(payload)
    return cls({arguments})
"""


def _compile(kind: type[Message]) -> None:
    """Give a class its own `pack` and `unpack`, made from WIRE when the first message of its kind comes or goes.

    They are compiled, as a dataclass compiles its `__init__`: loops over the fields take three times as long.
    """
    if "pack" in vars(kind):
        return  # by another thread, or the caller has bound the method before
    fields = dict(zip((field.name for field in dataclass_fields(kind)), kind.WIRE.split(), strict=True))
    rest = fields.popitem() if kind.WIRE.endswith(("utf8", "records")) else None
    layout = struct.Struct("<" + "".join(STRUCT_CODES[type_.partition("/")[0]] for type_ in fields.values()))
    size = layout.size
    values = [_packed(name, type_) for name, type_ in fields.items()]
    arguments = [_unpacked(name, type_) for name, type_ in fields.items()]
    length, tail, room = str(size), "", MAX_PAYLOAD - size
    if rest is not None and rest[1] == "utf8":
        length, tail = f"max({size}, len(payload))", f" + checked_text(self.{rest[0]}, {room})"
        arguments.append(f"payload[{size}:].decode('utf-8', 'replace')")
    elif rest is not None:
        record = sum(struct.calcsize(STRUCT_CODES[type_]) for _, type_, _ in kind.RECORD)
        before_n = list(fields.values())[: list(fields).index("n")]
        at = struct.calcsize("<" + "".join(STRUCT_CODES[type_] for type_ in before_n))
        length = f"{size} + {record} * payload[{at}] if len(payload) >= {size} else {size}"
        tail = f" + checked_records(self.records, self.n, {record}, {room})"
        arguments.append(f"payload[{size}:]")
    source = _CODEC.format(
        values=", ".join(values),
        tail=tail,
        length=length,
        names=f"({''.join(f'{name}, ' for name in fields)})",
        arguments=", ".join(arguments),
    )
    made: dict[str, Callable[..., object]] = {}
    names = {
        "pack_fields": layout.pack,
        "unpack_fields": layout.unpack_from,
        "misfits": _MISFIT,
        "ascii_bytes": _ascii_bytes,
        "checked_text": _checked_text,
        "checked_records": _checked_records,
    }
    exec(source, names, made)
    # `pack` comes last, for another thread takes it as the sign that both are there.
    kind.unpack = classmethod(made["unpack"])  # type: ignore[assignment, method-assign]
    kind.pack = made["pack"]  # type: ignore[assignment, method-assign]


def saturated(message: MessageT) -> MessageT:
    """Return a message as a controller sends it.

    A measured value beyond its type is the limit of that, and what is no number the lower one.
    """
    values = {}
    for field, type_ in zip(dataclass_fields(message), message.WIRE.split(), strict=True):
        code, _, counts = type_.partition("/")
        if counts:
            bits = 8 * struct.calcsize(STRUCT_CODES[code])
            least = -(1 << bits - 1) if code.startswith("i") else 0
            value = getattr(message, field.name) * int(counts)
            most = least + (1 << bits) - 1
            values[field.name] = (most if value > most else value if value >= least else least) / int(counts)
    return replace(message, **values)


def _packed(name: str, type_: str) -> str:
    code, _, counts = type_.partition("/")
    if code == "s12":
        return f"ascii_bytes(self.{name}, 12)"
    return f"round(self.{name} * {counts})" if counts else f"self.{name}"


def _unpacked(name: str, type_: str) -> str:
    code, _, counts = type_.partition("/")
    if code == "s12":
        return f"{name}.rstrip(b'\\0').decode('ascii')"
    return f"{name} / {counts}" if counts else name


def _ascii_bytes(text: str, size: int) -> bytes:
    """Encode a fixed-size ASCII field; ValueError where it is too long or holds a NUL."""
    data = text.encode("ascii")
    if len(data) > size or b"\0" in data:
        raise ValueError(f"{text!r} is not ASCII text of at most {size} characters")
    return data


def _checked_records(records: bytes, n: int, record_size: int, room: int) -> bytes:
    """Return `records`; ValueError unless they are n whole records that fit into `room` bytes."""
    if len(records) != n * record_size or len(records) > room:
        raise ValueError(
            f"{len(records)} bytes are not {n} records of {record_size} bytes within {room} bytes"
        )
    return records


def _checked_text(text: str, room: int) -> bytes:
    """Encode text that runs to the end of the payload; ValueError where it exceeds `room` bytes."""
    data = text.encode("utf-8")
    if len(data) > room:
        raise ValueError(f"text of {len(data)} bytes, {room} fit")
    return data


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
