"""Source of messages.py."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.link.emit.classes import message_class
from edmctl.link.emit.tables import parameters, record_tables, registries
from edmctl.link.schema import TEXT_TYPE

if TYPE_CHECKING:
    from collections.abc import Iterable

    from edmctl.link.schema import Enumeration, Field, Schema

_STRUCT_CODES = {
    "u8": "B",
    "i8": "b",
    "u16": "H",
    "i16": "h",
    "u32": "I",
    "i32": "i",
    "u64": "Q",
    "s12": "12s",
}

_MESSAGES_HEAD = '''\
"""Messages of EDM Link {major}.{minor}.

Made from edmlink1.toml by `python -m edmctl.link.generate`; edit that file, not this one.
Fields carry physical values; the comment beside each says type and size of one count on the wire.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum, IntFlag
from functools import cache
from struct import Struct
from typing import TYPE_CHECKING, ClassVar, Self
from zlib import crc32

from edmctl.link.wire import (
    MISFIT,
    Message,
    ascii_bytes,
    checked_records,
    checked_text,
    misfit,
    wrong_length,
)
from edmctl.link.wire import Param as Param

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy as np

PROTO_MAJOR = {major}
PROTO_MINOR = {minor}
SCHEMA_HASH = 0x{hash:08X}
'''


def messages_source(schema: Schema) -> str:
    """Return the source of messages.py."""
    head = _MESSAGES_HEAD.format(major=schema.major, minor=schema.minor, hash=schema.hash)
    parts = [head, _structs(schema)]
    parts += [_enumeration(e) for e in schema.enums]
    for message in schema.messages:
        if message.unsolicited is not None:
            parts.append(message_class(message, message.unsolicited, "", schema.max_payload))
        if message.request is not None and message.reply is not None:
            parts.append(message_class(message, message.request, "", schema.max_payload))
            parts.append(message_class(message, message.reply, "_REPLY", schema.max_payload))
    parts += [registries(schema), record_tables(schema), parameters(schema.params)]
    return "".join(parts)


def _format(fields: Iterable[Field]) -> str:
    return "<" + "".join(_STRUCT_CODES[f.type] for f in fields if f.type != TEXT_TYPE)


def _structs(schema: Schema) -> str:
    lines = [
        f'_{name} = Struct("{_format(layout.fields)}")\n'
        for name, layout in schema.layouts()
        if layout.fields
    ]
    return "\n" + "".join(lines) + '_PARAM = Struct("<Hi")\n'


def _enumeration(enumeration: Enumeration) -> str:
    base = "IntFlag" if enumeration.is_flags else "IntEnum"
    values = "".join(f"    {name} = {value}\n" for name, value in enumeration.values)
    return f'\n\nclass {enumeration.name}({base}):\n    """{enumeration.note}."""\n\n{values}'
