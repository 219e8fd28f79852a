"""One line of text per frame, `NAME key=value …`."""

from __future__ import annotations

import json
from dataclasses import fields
from typing import TYPE_CHECKING

from edmctl.link import messages as m
from edmctl.link.messages import REQUESTS, UNSOLICITED, Status
from tools.generate.schema import load_schema

if TYPE_CHECKING:
    from enum import IntEnum, IntFlag

    from edmctl.link.frame import Frame
    from edmctl.link.wire import Message

TYPES: dict[str, type[Message]] = {
    kind.NAME: kind for kind in (*REQUESTS.values(), *UNSOLICITED.values())
} | {f"{request.NAME}_REPLY": request.REPLY for request in REQUESTS.values()}
"""Every message by name; commands that answer nothing share one reply."""
_REPLY = 0x40
_ENUMS = {
    (name, field.name): getattr(m, field.enum)
    for name, layout in load_schema().layouts()
    for field in layout.fields
    if field.enum
}


def render(frame: Frame) -> str:
    """Return a frame as text; a payload that cannot be read as its message is shown as hex."""
    name = _name(frame.type_id)
    words = [name] if name else ["UNKNOWN", f"type={frame.type_id:02x}"]
    words += [f"seq={frame.seq}", f"session={frame.session:02x}"]
    if name.endswith("_REPLY"):
        words.append(f"status={_named(Status, frame.flags)}")
    elif frame.flags:
        words.append(f"flags={frame.flags:02x}")
    return " ".join([*words, *_payload(name, frame.payload)])


def _name(type_id: int) -> str:
    if type_id in UNSOLICITED or type_id in REQUESTS:
        return (UNSOLICITED.get(type_id) or REQUESTS[type_id]).NAME
    request = REQUESTS.get(type_id & ~_REPLY) if type_id & _REPLY else None
    return f"{request.NAME}_REPLY" if request is not None else ""


def _payload(name: str, payload: bytes) -> list[str]:
    if name:
        try:
            return _fields(TYPES[name].unpack(payload))
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
