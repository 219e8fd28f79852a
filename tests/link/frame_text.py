"""One line of text per frame, `NAME key=value …`."""

from __future__ import annotations

import json
from dataclasses import fields
from typing import TYPE_CHECKING

from edmctl.link import messages as m
from edmctl.link.messages import REPLIES, REQUESTS, UNSOLICITED, Status
from edmctl.link.schema import load_schema

if TYPE_CHECKING:
    from enum import IntEnum, IntFlag

    from edmctl.link.frame import Frame
    from edmctl.link.wire import Message

_REPLY = 0x40
_ENUMS = {
    (name, field.name): getattr(m, field.enum)
    for name, layout in load_schema().layouts()
    for field in layout.fields
    if field.enum
}


def render(frame: Frame) -> str:
    """Return a frame as text; a payload that cannot be read as its message is shown as hex."""
    kind = _message_type(frame.type_id)
    words = ["UNKNOWN", f"type={frame.type_id:02x}"] if kind is None else [kind.NAME]
    words += [f"seq={frame.seq}", f"session={frame.session:02x}"]
    if kind is not None and kind.NAME.endswith("_REPLY"):
        words.append(f"status={_named(Status, frame.flags)}")
    elif frame.flags:
        words.append(f"flags={frame.flags:02x}")
    return " ".join([*words, *_payload(kind, frame.payload)])


def _message_type(type_id: int) -> type[Message] | None:
    if type_id in UNSOLICITED or type_id in REQUESTS:
        return UNSOLICITED.get(type_id) or REQUESTS[type_id]
    return REPLIES.get(type_id & ~_REPLY) if type_id & _REPLY else None


def _payload(kind: type[Message] | None, payload: bytes) -> list[str]:
    if kind is not None:
        try:
            return _fields(kind.unpack(payload))
        except ValueError:
            pass
    return [f"payload={payload.hex()}"] if payload else []


def _fields(message: Message) -> list[str]:
    words = []
    for field in fields(message):
        value = getattr(message, field.name)
        enumeration = _ENUMS.get((message.NAME, field.name))
        if enumeration is not None:
            value = _named(enumeration, value)
        elif isinstance(value, bytes):
            value = value.hex()
        elif isinstance(value, str):
            value = json.dumps(value, ensure_ascii=False)
        words.append(f"{field.name}={value}")
    return words


def _named(enumeration: type[IntEnum | IntFlag], value: int) -> str:
    try:
        return enumeration(value).name or str(value)
    except ValueError:
        return str(value)
