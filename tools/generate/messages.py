"""Source of edmctl/link/messages.py."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

from tools.generate.schema import TEXT_TYPE
from tools.generate.text import LINE_LENGTH, quoted

if TYPE_CHECKING:
    from collections.abc import Sequence

    from edmctl.link.faults import FaultRow
    from tools.generate.schema import Enumeration, Field, Layout, MessageSpec, ParamSpec, Schema

_INDENT = "    "
_HEAD = '''\
"""Messages of EDM Link {major}.{minor}.

Made from tools/generate/edmlink1.toml and faults.toml by `python -m tools.generate`; edit those files.
Fields carry physical values; the comment beside each says type and size of one count on the wire.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum, IntFlag
from struct import pack
from zlib import crc32

from edmctl.dataclasses import dataclass
from edmctl.link.wire import Ack, Message, Param, Request

PROTO_MAJOR = {major}
PROTO_MINOR = {minor}
SCHEMA_HASH = 0x{hash:08X}
'''
_FAULT_CODE = '''class FaultCode(IntEnum):
    """Code of a fault; those from 7000 on are the host's own."""

'''
_REGISTRIES = '''
REQUESTS: dict[int, type[Request[Message]]] = {{kind.ID: kind for kind in ({commands})}}
"""Commands by id; on the wire the type of a reply is that id | 0x40."""

UNSOLICITED: dict[int, type[Message]] = {{kind.ID: kind for kind in ({others})}}
"""What the controller sends by itself, by id."""

PARAMS = {{param.name: param for param in (
{params})}}
"""Parameters of the controller by name."""


def param_crc(values: Mapping[str, float]) -> int:
    """Return the CRC-32 over all parameters (id u16, value i32, ascending id) that the controller checks.

    Parameters missing from `values` count with their defaults. An unknown name or a value out of range raises
    ValueError.
    """
    unknown = sorted(values.keys() - PARAMS.keys())
    if unknown:
        raise ValueError(f"no such parameter: {{', '.join(unknown)}}")
    crc = 0
    for param in sorted(PARAMS.values(), key=lambda p: p.id):
        crc = crc32(pack("<Hi", param.id, param.to_wire(values.get(param.name, param.default))), crc)
    return crc
'''


def messages_source(schema: Schema, faults: Sequence[FaultRow]) -> str:
    """Return the source of messages.py."""
    parts = [_HEAD.format(major=schema.major, minor=schema.minor, hash=schema.hash)]
    parts += [_enumeration(e) for e in schema.enums]
    codes = "".join(f"    {row.name} = {row.code}\n" for row in faults)
    parts.append(
        f'class FaultCode(IntEnum):\n    """Code of a fault; those from 7000 on are the host\'s own."""\n\n{codes}'
    )
    for message in schema.messages:
        for layout, suffix in (
            (message.reply, "Reply"),
            (message.request, ""),
            (message.unsolicited, ""),
        ):
            if layout is not None and (layout.fields or not suffix):
                parts.append(_class(message, layout, suffix))
    parts.append(
        _REGISTRIES.format(
            commands=", ".join(m.class_name for m in schema.messages if m.request is not None),
            others=", ".join(m.class_name for m in schema.messages if m.unsolicited is not None),
            params="".join(_parameter(p) for p in schema.params),
        )
    )
    return "\n\n".join(parts)


def _enumeration(enumeration: Enumeration) -> str:
    base = "IntFlag" if enumeration.is_flags else "IntEnum"
    values = "".join(f"    {name} = {value}\n" for name, value in enumeration.values)
    return f'class {enumeration.name}({base}):\n    """{enumeration.note}."""\n\n{values}'


def _class(message: MessageSpec, layout: Layout, suffix: str) -> str:
    """Return the class of one direction of a message; `suffix` is "Reply" for a reply, else empty."""
    is_request = layout is message.request
    reply = f"{message.class_name}Reply" if message.reply is not None and message.reply.fields else "Ack"
    base = f"Request[{reply}]" if is_request else "Message"
    name = message.name + suffix.upper().replace("REPLY", "_REPLY")
    lines = [
        "@dataclass(slots=True)\n" if layout.fields else "",
        f"class {message.class_name}{suffix}({base}):\n",
        "" if suffix else f"{_docstring(message.note)}\n",
        f'    ID, NAME = 0x{message.id:02X}, "{name}"\n',
        f"    REPLY = {reply}\n" if is_request and reply != "Ack" else "",
    ]
    if layout.fields:
        wire = [_wire(f) for f in layout.fields] + (["records"] if layout.record else [])
        lines.append(f'    WIRE = "{" ".join(wire)}"\n')
    if layout.record:
        lines.append(f"    RECORD = ({_columns(layout.record)})\n")
    lines += [_field(f) for f in layout.fields]
    if layout.record:
        lines.append(f"    records: bytes  # n × {layout.record_size} bytes, see RECORD\n")
    return "".join(lines)


def _docstring(text: str) -> str:
    if len(text) + 10 <= LINE_LENGTH:
        return f'    """{text}"""\n'
    wrapped = textwrap.fill(f'"""{text}', LINE_LENGTH, initial_indent=_INDENT, subsequent_indent=_INDENT)
    return f'{wrapped}\n    """\n'


def _wire(field: Field) -> str:
    return field.type if field.divisor == 1 else f"{field.type}/{field.divisor}"


def _columns(record: Sequence[Field]) -> str:
    return "".join(f'("{f.name}", "{f.type}", {f.scale:g}), ' for f in record)


def _field(field: Field) -> str:
    kind = "str" if field.type in (TEXT_TYPE, "s12") else "int" if field.divisor == 1 else "float"
    size = f" × {field.scale:g}" if field.divisor != 1 else ""
    comment = f"{field.type}{size}{' ' + field.unit if field.unit else ''}"
    if field.note:
        comment += f": {field.note}"
    line = f"    {field.name}: {kind}  # {comment}\n"
    return line if len(line) <= LINE_LENGTH + 1 else f"    # {comment}\n    {field.name}: {kind}\n"


def _parameter(p: ParamSpec) -> str:
    scale = "1" if p.divisor == 1 else f"{p.scale:g}"
    numbers = ", ".join(f"{value:g}" for value in (p.default, p.minimum, p.maximum))
    return f"    Param({p.id}, {quoted(p.name)}, {quoted(p.unit)}, {scale}, {numbers}),\n"
