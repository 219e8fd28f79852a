"""A line whose controller lies: frames of one kind come changed, with the right check."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from random import Random

from cobs import cobs

from edmctl.link.frame import Frame, encode_frame
from edmctl.link.messages import Event
from edmctl.link.transport import Transport
from edmctl.machine.interface import EventCode
from tools.generate.schema import load_schema

CHECK_BYTES = 4
HEADER = ("type", "seq", "session", "status")
WHOLE = ("random payload", "short payload", "long payload", "twice", "late", "lost")
"""What can happen to a frame as a whole; `late` comes after the next of its kind."""
VALUES = ("least", "greatest", "zero", "one more", "one less", "a bit", "random")
ALL = 1 << 30


@dataclass(frozen=True, slots=True)
class Place:
    """A field of a frame: its bytes, from the begin of the payload or of each record."""

    name: str
    offset: int
    size: int
    signed: bool
    header: int
    record: int


@dataclass(frozen=True, slots=True)
class Lie:
    """From frame number `first` of type `type_id` on, `frames` of them have `field` changed to `value`."""

    type_id: int
    field: str
    value: str
    first: int
    frames: int = 1

    def __str__(self) -> str:
        often = "always" if self.frames >= ALL else f"{self.frames} times"
        return f"{name_of(self.type_id)}.{self.field}: {self.value}, {often} from {self.first} on"


@lru_cache
def places(type_id: int) -> dict[str, Place]:
    """Every field of the payload of one type of frame, by name."""
    spec = next(m for m in load_schema().messages if m.id == type_id & 0xBF or m.id == type_id)
    layout = spec.unsolicited if type_id & 0x80 else spec.reply
    assert layout is not None
    found = {}
    for fields, in_record in ((layout.fields, False), (layout.record, True)):
        offset = 0
        for field in fields:
            name = f"record {field.name}" if in_record else field.name
            record = layout.record_size if in_record else 0
            found[name] = Place(name, offset, field.size, field.type[0] == "i", layout.size, record)
            offset += field.size
    return found


def name_of(type_id: int) -> str:
    """The message's name, with what a reply answers."""
    specs = {m.id: m.name for m in load_schema().messages}
    return specs.get(type_id) or f"{specs.get(type_id & 0xBF, type_id)} reply"


def fields_of(type_id: int) -> tuple[str, ...]:
    """Everything about a frame of this type that can be changed."""
    return (*places(type_id), *HEADER, *WHOLE)


class LyingLine:
    """Wraps a line of virtual time. `counts` are the frames that came, by type; `told` those that were changed."""

    def __init__(self, line: Transport, lie: Lie | None, random: Random) -> None:
        self.name, self.live = line.name, line.live
        self._line, self._lie, self._random = line, lie, random
        self._late: list[bytes] = []
        self.counts: Counter[int] = Counter()
        self.told = 0
        self.told_s: float | None = None

    def now_s(self) -> float:
        return self._line.now_s()

    def write(self, data: bytes) -> None:
        self._line.write(data)

    def close(self) -> None:
        self._line.close()

    def read(self, timeout_s: float) -> bytes:
        data = self._line.read(timeout_s)
        if not data:
            return data
        return b"".join(self._passed(part) for part in data.split(b"\0") if part)

    def _passed(self, part: bytes) -> bytes:
        whole = b"\0" + part + b"\0"
        body = cobs.decode(part)[:-CHECK_BYTES]
        type_id, lie = body[0], self._lie
        number = self.counts[type_id]
        self.counts[type_id] += 1
        if lie is None or type_id != lie.type_id or not lie.first <= number < lie.first + lie.frames:
            late, self._late = self._late, [] if lie is None or type_id == lie.type_id else self._late
            return whole + (b"".join(late) if not self._late else b"")
        frame = Frame(body[0], body[1], body[2], body[3], bytes(body[4:]))
        changed = self._changed(frame, whole, lie)
        if changed != whole:
            self.told += 1
            if self.told_s is None:
                self.told_s = self.now_s()
        return changed

    def _changed(self, frame: Frame, whole: bytes, lie: Lie) -> bytes:
        payload, random = frame.payload, self._random
        if lie.field == "twice":
            return whole + whole
        if lie.field == "lost":
            return b""
        if lie.field == "late":
            self._late.append(whole)
            return b""
        if lie.field in HEADER:
            head = list(frame[:4])
            at = HEADER.index(lie.field)
            head[at] = self._value(head[at], 0, 255, lie.value)
            return encode_frame(head[0], head[1], head[2], head[3], payload)
        if lie.field in WHOLE:
            size = len(payload)
            if lie.field == "short payload":
                size = random.randrange(size) if size else 0
            if lie.field == "long payload":
                size = random.randint(size, 246)
            return encode_frame(*frame[:4], random.randbytes(size))
        return encode_frame(*frame[:4], self._lied(payload, places(frame.type_id)[lie.field], lie.value))

    def _lied(self, payload: bytes, place: Place, value: str) -> bytes:
        offset, size = place.offset, place.size or max(1, len(payload) - place.offset)
        if place.record:
            records = (len(payload) - place.header) // place.record
            if records == 0:
                return payload
            offset += place.header + place.record * self._random.randrange(records)
        part = payload[offset : offset + size]
        if size > 8 or place.size == 0:
            new = self._random.randbytes(len(part))
        else:
            low, high = (
                (-(1 << (8 * size - 1)), (1 << (8 * size - 1)) - 1)
                if place.signed
                else (0, (1 << 8 * size) - 1)
            )
            number = self._value(int.from_bytes(part, "little", signed=place.signed), low, high, value)
            new = number.to_bytes(size, "little", signed=place.signed)
        return payload[:offset] + new + payload[offset + size :]

    def _value(self, value: int, low: int, high: int, kind: str) -> int:
        span = high - low + 1
        changed = {
            "least": low,
            "greatest": high,
            "zero": 0,
            "one more": value + 1,
            "one less": value - 1,
            "a bit": value ^ (1 << self._random.randrange(span.bit_length() - 1)),
            "random": self._random.randint(low, high),
        }[kind]
        return (changed - low) % span + low


class LyingTouches(LyingLine):
    """A line on which every touch is told to be somewhere else, µm."""

    def __init__(self, line: Transport, lie: Callable[[float], float]) -> None:
        super().__init__(line, Lie(Event.ID, "displacement_um", "", 0, ALL), Random(1))
        self._spoilt = lie

    def _lied(self, payload: bytes, place: Place, value: str) -> bytes:
        event = Event.unpack(payload)
        if event.code != EventCode.TOUCH:
            return payload
        told = min(round(1000.0 * self._spoilt(event.displacement_um)), (1 << 31) - 1)
        at = len(payload) - 6
        return payload[:at] + told.to_bytes(4, "little", signed=True) + payload[at + 4 :]
