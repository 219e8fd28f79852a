"""The description of the wire, read from edmlink1.toml: what messages.py, the C code and the pages are made from.

The schema hash covers everything that changes the bytes or their meaning (names, types, units, scales, order,
enums, parameters) and nothing that does not (notes, formatting of the file).
"""

from __future__ import annotations

import json
import tomllib
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import cast

from edmctl.dataclasses import dataclass

SCHEMA_PATH = Path(__file__).with_name("edmlink1.toml")
TEXT_TYPE = "utf8"
SIZES = {"u8": 1, "i8": 1, "u16": 2, "i16": 2, "u32": 4, "i32": 4, "u64": 8, "s12": 12, TEXT_TYPE: 0}
COMMAND_IDS = range(0x01, 0x40)
UNSOLICITED_IDS = range(0x80, 0xC0)


class SchemaError(ValueError):
    """The schema file contradicts itself."""


@dataclass(frozen=True, slots=True)
class Field:
    """One field: value in `unit` = wire integer / `divisor`."""

    name: str
    type: str
    unit: str
    scale: float
    note: str
    enum: str

    @property
    def divisor(self) -> int:
        """1 / scale; exact decimal values come from dividing, not from multiplying by an inexact 0.001."""
        return round(1 / self.scale)

    @property
    def size(self) -> int:
        """Bytes on the wire; 0 for text that runs to the end of the payload."""
        return SIZES[self.type]


@dataclass(frozen=True, slots=True)
class Enumeration:
    """Named values of a field; flags are bits that combine."""

    name: str
    note: str
    values: tuple[tuple[str, int], ...]
    is_flags: bool


@dataclass(frozen=True, slots=True)
class Layout:
    """The payload of one direction of a message: a header, then n records where `record` is not empty."""

    fields: tuple[Field, ...]
    record: tuple[Field, ...] = ()

    @property
    def size(self) -> int:
        """Bytes of the header."""
        return sum(f.size for f in self.fields)

    @property
    def record_size(self) -> int:
        """Bytes of one record, 0 without records."""
        return sum(f.size for f in self.record)


@dataclass(frozen=True, slots=True)
class MessageSpec:
    """One message: a command with its reply, or one the controller sends by itself."""

    id: int
    name: str
    note: str
    request: Layout | None
    reply: Layout | None
    unsolicited: Layout | None

    @property
    def class_name(self) -> str:
        """PIEZO_SET -> PiezoSet."""
        return "".join(word.capitalize() for word in self.name.split("_"))


@dataclass(frozen=True, slots=True)
class ParamSpec:
    """One controller parameter; default, minimum and maximum are in `unit`."""

    id: int
    name: str
    unit: str
    scale: float
    default: float
    minimum: float
    maximum: float
    note: str
    group: str

    @property
    def divisor(self) -> int:
        """1 / scale."""
        return round(1 / self.scale)


@dataclass(frozen=True, slots=True)
class Schema:
    """The whole protocol."""

    name: str
    major: int
    minor: int
    max_payload: int
    enums: tuple[Enumeration, ...]
    messages: tuple[MessageSpec, ...]
    params: tuple[ParamSpec, ...]

    def layouts(self) -> list[tuple[str, Layout]]:
        """Return every payload with its name: that of the message, with _REPLY after it for replies."""
        named = []
        for message in self.messages:
            for layout, suffix in (
                (message.request, ""),
                (message.reply, "_REPLY"),
                (message.unsolicited, ""),
            ):
                if layout is not None:
                    named.append((message.name + suffix, layout))
        return named

    def canonical_json(self) -> str:
        """Return what the hash is taken over: compact ASCII JSON, keys sorted, lists in wire order."""
        return json.dumps(_canonical(self), sort_keys=True, separators=(",", ":"), ensure_ascii=True)

    @property
    def hash(self) -> int:
        """CRC-32 of the canonical JSON."""
        return zlib.crc32(self.canonical_json().encode("ascii"))


def load_schema(path: Path = SCHEMA_PATH) -> Schema:
    """Read and check a schema file.

    Raises
    ------
    SchemaError
        Duplicate ids or names, unknown types, scales that are not 1/integer, payloads that do not fit.
    """
    table = tomllib.loads(path.read_text(encoding="utf-8"))
    enums = tuple(_enums(table))
    names = {e.name for e in enums}
    protocol = table["protocol"]
    schema = Schema(
        name=protocol["name"],
        major=protocol["major"],
        minor=protocol["minor"],
        max_payload=protocol["max_payload"],
        enums=enums,
        messages=tuple(_message(row, names) for row in table["message"]),
        params=tuple(_param(row, group["group"]) for group in table["param"] for row in group["rows"]),
    )
    _check(schema)
    return schema


def _enums(table: Mapping[str, Mapping[str, Mapping[str, object]]]) -> list[Enumeration]:
    return [
        Enumeration(
            name, str(row["note"]), tuple(cast("dict[str, int]", row["values"]).items()), kind == "flags"
        )
        for kind in ("enum", "flags")
        for name, row in table.get(kind, {}).items()
    ]


def _message(row: Mapping[str, object], enums: set[str]) -> MessageSpec:
    def layout(key: str) -> Layout | None:
        if key not in row:
            return None
        record = row.get("record", ()) if key != "request" else ()
        return Layout(_fields(row[key], enums), _fields(record, enums))

    return MessageSpec(
        cast("int", row["id"]),
        str(row["name"]),
        str(row["note"]),
        layout("request"),
        layout("reply"),
        layout("unsolicited"),
    )


def _fields(rows: object, enums: set[str]) -> tuple[Field, ...]:
    fields = []
    for name, type_, unit, scale, note in cast("Sequence[tuple[str, str, str, float, str]]", rows):
        first_word = note.split(" ", 1)[0]
        fields.append(Field(name, type_, unit, scale, note, first_word if first_word in enums else ""))
    return tuple(fields)


def _param(row: Sequence[object], group: str) -> ParamSpec:
    id_, name, unit, scale, default, low, high, note = cast(
        "tuple[int, str, str, float, float, float, float, str]", tuple(row)
    )
    return ParamSpec(id_, name, unit, scale, default, low, high, note, group)


def _check(schema: Schema) -> None:
    _check_unique("message id", [m.id for m in schema.messages])
    _check_unique("message name", [m.name for m in schema.messages])
    _check_unique("parameter id", [p.id for p in schema.params])
    _check_unique("parameter name", [p.name for p in schema.params])
    for message in schema.messages:
        _check_message(message, schema.max_payload)
    for param in schema.params:
        _check_scale(param.name, param.scale)
        wire = [value * param.divisor for value in (param.minimum, param.default, param.maximum)]
        if wire != sorted(wire) or not -(2**31) <= wire[0] <= wire[-1] < 2**31:
            raise SchemaError(f"{param.name}: minimum, default, maximum out of order or beyond 32 bits")


def _check_unique(what: str, values: Sequence[object]) -> None:
    twice = sorted({str(v) for v in values if values.count(v) > 1})
    if twice:
        raise SchemaError(f"{what} used twice: {', '.join(twice)}")


def _check_message(message: MessageSpec, max_payload: int) -> None:
    is_command = message.request is not None and message.reply is not None
    ids = COMMAND_IDS if is_command else UNSOLICITED_IDS
    if message.id not in ids or is_command == (message.unsolicited is not None):
        raise SchemaError(f"{message.name}: id {message.id:#04x} does not suit its kind")
    for layout in (message.request, message.reply, message.unsolicited):
        if layout is not None:
            _check_layout(message.name, layout, max_payload)


def _check_layout(name: str, layout: Layout, max_payload: int) -> None:
    for field in (*layout.fields, *layout.record):
        if field.type not in SIZES:
            raise SchemaError(f"{name}.{field.name}: unknown type {field.type}")
        _check_scale(f"{name}.{field.name}", field.scale)
    for fields in (layout.fields, layout.record):
        _check_unique(f"{name} field", [f.name for f in fields])
    if any(f.type == TEXT_TYPE for f in (*layout.fields[:-1], *layout.record)):
        raise SchemaError(f"{name}: text must be the last field")
    if layout.size + layout.record_size > max_payload:
        raise SchemaError(f"{name}: payload exceeds {max_payload} bytes")
    has_count = ("n", "u8") in [(f.name, f.type) for f in layout.fields]
    if layout.record and (layout.fields[-1].type == TEXT_TYPE or not has_count):
        raise SchemaError(f"{name}: records need a header field n of type u8")


def _check_scale(name: str, scale: float) -> None:
    if scale <= 0 or abs(round(1 / scale) * scale - 1) > 1e-9:
        raise SchemaError(f"{name}: scale {scale} is not 1/integer")


def _canonical(schema: Schema) -> dict[str, object]:
    def fields(layout: tuple[Field, ...]) -> list[list[object]]:
        return [[f.name, f.type, f.unit, f.divisor] for f in layout]

    def message(spec: MessageSpec) -> dict[str, object]:
        parts: dict[str, object] = {"id": spec.id, "name": spec.name}
        for key in ("request", "reply", "unsolicited"):
            layout: Layout | None = getattr(spec, key)
            if layout is not None:
                parts[key] = fields(layout.fields)
                if layout.record:
                    parts["record"] = fields(layout.record)
        return parts

    return {
        "name": schema.name,
        "major": schema.major,
        "minor": schema.minor,
        "max_payload": schema.max_payload,
        "enums": [[e.name, e.is_flags, [list(v) for v in e.values]] for e in schema.enums],
        "messages": [message(m) for m in schema.messages],
        "params": [
            [
                p.id,
                p.name,
                p.unit,
                p.divisor,
                *(round(v * p.divisor) for v in (p.default, p.minimum, p.maximum)),
            ]
            for p in schema.params
        ],
    }
