"""Sources in firmware/gen: the wire, the parameters, the schema and the faults, as the core knows them."""

from __future__ import annotations

import zlib
from typing import TYPE_CHECKING

from edmctl.link.frame import MAX_PAYLOAD
from tools.generate.schema import TEXT_TYPE

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from edmctl.link.faults import FaultRow
    from tools.generate.schema import Enumeration, Field, Layout, MessageSpec, ParamSpec, Schema

_MADE = "/* Made from edmlink1.toml and faults.toml by `python -m tools.generate`; edit those files. */"
_HEAD = """\
{made}
/* EDM Link {major}.{minor}: every payload that a controller reads or writes. Scaled fields are `real`, in the
 * unit of their name; the comment says what one count of the wire is. */
#ifndef EDM_GEN_EDMLINK_H
#define EDM_GEN_EDMLINK_H

#include "../core/wire.h"

#define PROTO_MAJOR {major}
#define PROTO_MINOR {minor}
#define SCHEMA_HASH 0x{hash:08X}u
#define MAX_PAYLOAD {max_payload}
#define REPLY_BIT 0x40
"""
_TABLES = """
/* One parameter of the table: value in its unit = wire integer / divisor. */
struct edm_param {{
    uint16_t id;
    int32_t divisor;
    int32_t default_wire;
    int32_t least;
    int32_t most;
}};

/* Rows of the table, in ascending order of id. */
enum {{
{names}    PARAMS,
}};

extern const struct edm_param edm_params[PARAMS];

/* The canonical schema, compressed by zlib, as GET_SCHEMA hands it out. */
#define SCHEMA_BYTES {schema_bytes}
extern const uint8_t edm_schema[SCHEMA_BYTES];

/* Payload bytes of a command; -1 for a type that is none. */
int edm_request_size(uint8_t type);

#endif
"""
_C_TYPES = {
    "u8": "uint8_t",
    "i8": "int8_t",
    "u16": "uint16_t",
    "i16": "int16_t",
    "u32": "uint32_t",
    "i32": "int32_t",
    "u64": "uint64_t",
}
_BYTES_A_LINE = 20


def header(schema: Schema, faults: Sequence[FaultRow]) -> str:
    """Return edmlink.h."""
    parts = [
        _HEAD.format(
            made=_MADE,
            major=schema.major,
            minor=schema.minor,
            hash=schema.hash,
            max_payload=schema.max_payload,
        ),
        *(_enumeration(e) for e in schema.enums),
        _fault_codes(faults),
        _message_ids(schema.messages),
    ]
    for message in schema.messages:
        name = message.name
        if message.request is not None and message.request.fields:
            parts.append(_structure(name, message.request, message.note) + _reader(name, message.request))
        if message.reply is not None and message.reply.fields:
            parts.append(_written(f"{name}_REPLY", message.reply, f"Reply to {name}."))
        if message.unsolicited is not None and not _has_text(message.unsolicited):
            parts.append(_written(name, message.unsolicited, message.note))
            if name == "TLM":  # a host in the same process takes samples out of their frames
                parts.append(_reader(name, message.unsolicited))
    params = sorted(schema.params, key=lambda p: p.id)
    names = "".join(f"    PARAM_{p.name.upper()},  /* {_param_note(p)} */\n" for p in params)
    parts.append(_TABLES.format(names=names, schema_bytes=len(_compressed(schema))))
    return "".join(parts)


def tables(schema: Schema) -> str:
    """Return edmlink.c."""
    params = sorted(schema.params, key=lambda p: p.id)
    rows = "".join(f"    {{{_param_row(p)}}},  /* {p.name} */\n" for p in params)
    cases = "".join(
        f"    case MSG_{m.name}:\n        return {m.request.size};\n"
        for m in schema.messages
        if m.request is not None
    )
    return (
        f'{_MADE}\n#include "edmlink.h"\n\n'
        f"const struct edm_param edm_params[PARAMS] = {{\n{rows}}};\n\n"
        f"const uint8_t edm_schema[SCHEMA_BYTES] = {{\n{_hex(_compressed(schema))}}};\n\n"
        f"int edm_request_size(uint8_t type) {{\n    switch (type) {{\n{cases}"
        "    default:\n        return -1;\n    }\n}\n"
    )


def _compressed(schema: Schema) -> bytes:
    return zlib.compress(schema.canonical_json().encode(), 9)


def _hex(data: bytes) -> str:
    lines = (data[at : at + _BYTES_A_LINE] for at in range(0, len(data), _BYTES_A_LINE))
    return "".join("    " + " ".join(f"0x{byte:02x}," for byte in line) + "\n" for line in lines)


def _enumeration(enumeration: Enumeration) -> str:
    prefix = _upper(enumeration.name)
    values = "".join(f"    {prefix}_{name} = {value},\n" for name, value in enumeration.values)
    return f"\n/* {enumeration.note}. */\nenum {{\n{values}}};\n"


def _upper(name: str) -> str:
    """PulseClass -> PULSE_CLASS."""
    return "".join(
        f"_{letter}" if letter.isupper() and at else letter for at, letter in enumerate(name)
    ).upper()


def _fault_codes(faults: Iterable[FaultRow]) -> str:
    rows = "".join(
        f"    FAULT_{row.name} = {row.code},  /* {row.detect} */\n" for row in faults if row.who != "host"
    )
    return f"\n/* Faults that a controller detects. */\nenum {{\n{rows}}};\n"


def _message_ids(messages: Iterable[MessageSpec]) -> str:
    rows = "".join(f"    MSG_{m.name} = 0x{m.id:02X},\n" for m in messages)
    return f"\n/* Types of frames; that of a reply is its command's with REPLY_BIT. */\nenum {{\n{rows}}};\n"


def _has_text(layout: Layout) -> bool:
    return any(field.type == TEXT_TYPE for field in layout.fields)


def _written(name: str, layout: Layout, note: str) -> str:
    text = _structure(name, layout, note) + _writer(name, layout)
    if layout.record and not (len(layout.record) == 1 and layout.record_size == 1):
        record = f"{name}_RECORD"
        text += _structure(record, _as_layout(layout), f"One record of {name}.", wire=True)
        text += _writer(record, _as_layout(layout), wire=True)
    return text


def _as_layout(layout: Layout) -> Layout:
    return type(layout)(layout.record)


def _structure(name: str, layout: Layout, note: str, *, wire: bool = False) -> str:
    lines = "".join(_member(field, wire=wire) for field in layout.fields)
    size = f"\n#define {name}_SIZE {layout.size}\n"
    if layout.record:
        size += f"#define {name}_RECORD_SIZE {layout.record_size}\n"
        size += f"#define {name}_MOST {(MAX_PAYLOAD - layout.size) // layout.record_size}\n"
    return f"\n/* {_wrapped(note)} */{size}struct {name.lower()} {{\n{lines}}};\n"


def _wrapped(note: str) -> str:
    words, lines, line = note.split(), [], ""
    for word in words:
        if len(line) + len(word) > 108:
            lines.append(line)
            line = ""
        line += (" " if line else "") + word
    return "\n * ".join([*lines, line])


def _member(field: Field, *, wire: bool) -> str:
    is_text = field.type == "s12"
    kind = f"    char {field.name}[12];" if is_text else f"    {_kind(field, wire=wire)} {field.name};"
    count = f"{field.type} x {field.scale:g}" if field.divisor != 1 else field.type
    unit = f" {field.unit}" if field.unit else ""
    note = f": {field.note}" if field.note else ""
    return f"{kind}  /* {count}{unit}{note} */\n"


def _kind(field: Field, *, wire: bool) -> str:
    return _C_TYPES[field.type] if wire or field.divisor == 1 else "real"


def _reader(name: str, layout: Layout) -> str:
    lines, at = [], 0
    for field in layout.fields:
        value = f"get_{field.type}(p + {at})"
        if field.divisor != 1:
            value = f"(real){value} / {field.divisor}"
        lines.append(f"    m->{field.name} = {value};\n")
        at += field.size
    low = name.lower()
    text = f"static inline void {low}_read(struct {low} *m, const uint8_t *p) {{\n{''.join(lines)}}}\n"
    return text + _assert(name, at)


def _writer(name: str, layout: Layout, *, wire: bool = False) -> str:
    lines, at = [], 0
    for field in layout.fields:
        value = f"m->{field.name}"
        if field.divisor != 1 and not wire:
            value = f"counts_{field.type}(m->{field.name} * {field.divisor})"
        lines.append(f"    put_{field.type}(p + {at}, {value});\n")
        at += field.size
    low = name.lower()
    text = f"static inline void {low}_write(uint8_t *p, const struct {low} *m) {{\n{''.join(lines)}}}\n"
    return text + _assert(name, at)


def _assert(name: str, size: int) -> str:
    return f'_Static_assert({name}_SIZE == {size} && {size} <= MAX_PAYLOAD, "{name}");\n'


def _param_row(p: ParamSpec) -> str:
    wires = (round(value * p.divisor) for value in (p.default, p.minimum, p.maximum))
    return f"{p.id}, {p.divisor}, {', '.join(map(str, wires))}"


def _param_note(p: ParamSpec) -> str:
    return ", ".join(part for part in (p.unit, p.note) if part) or "0 or 1"
