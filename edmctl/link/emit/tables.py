"""Source of the lookup tables in messages.py: messages by id, records, parameters."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.link.emit.source import INDENT, call, quoted

if TYPE_CHECKING:
    from collections.abc import Sequence

    from edmctl.link.schema import ParamSpec, Schema

_PARAM_CRC = '''

def param_crc(values: Mapping[str, float]) -> int:
    """Return the CRC-32 over all parameters (id u16, value i32, ascending id) that the controller checks.

    Parameters missing from `values` count with their defaults. An unknown name or a value out of range raises
    ValueError.
    """
    unknown = sorted(values.keys() - PARAMS.keys())
    if unknown:
        raise ValueError(f"no such parameter: {', '.join(unknown)}")
    crc = 0
    for param in sorted(PARAMS.values(), key=lambda p: p.id):
        crc = crc32(_PARAM.pack(param.id, param.to_wire(values.get(param.name, param.default))), crc)
    return crc
'''

_RECORD_DTYPE = '''

@cache
def record_dtype(name: str) -> np.dtype[np.void]:
    """Return the dtype of one record of a message in RECORD_FIELDS: packed wire integers."""
    import numpy as np

    return np.dtype(list(RECORD_FIELDS[name]))
'''


def registries(schema: Schema) -> str:
    """Return the tables from ids to classes and from fields to enumerations."""
    commands = [m for m in schema.messages if m.request is not None]
    others = [m for m in schema.messages if m.unsolicited is not None]

    def table(name: str, rows: list[tuple[int, str]]) -> str:
        entries = "".join(f"    0x{id_:02X}: {class_name},\n" for id_, class_name in rows)
        return f"\n{name}: dict[int, type[Message]] = {{\n{entries}}}\n"

    return (
        "\n"
        + table("REQUESTS", [(m.id, m.class_name) for m in commands])
        + '"""Commands by id."""\n'
        + table("REPLIES", [(m.id, m.class_name + "Reply") for m in commands])
        + '"""Replies by the id of their command; on the wire the type is id | 0x40."""\n'
        + table("UNSOLICITED", [(m.id, m.class_name) for m in others])
        + '"""What the controller sends by itself, by id."""\n'
        + _field_enums(schema)
    )


def _field_enums(schema: Schema) -> str:
    entries = [
        f'    ("{name}", "{field.name}"): {field.enum},\n'
        for name, layout in schema.layouts()
        for field in layout.fields
        if field.enum
    ]
    body = "".join(entries)
    return (
        f"\nFIELD_ENUMS: dict[tuple[str, str], type[IntEnum | IntFlag]] = {{\n{body}}}\n"
        '"""Enumeration of a field, by message name and field name."""\n'
    )


_NUMPY_CODES = {"u8": "u1", "i8": "i1", "u16": "<u2", "i16": "<i2", "u32": "<u4", "i32": "<i4", "u64": "<u8"}


def record_tables(schema: Schema) -> str:
    """Return the tables of record fields and scales, and record_dtype."""
    fields, scales = [], []
    for name, layout in schema.layouts():
        if layout.record:
            class_name = "".join(word.capitalize() for word in name.split("_"))
            rows = [f'("{f.name}", "{_NUMPY_CODES[f.type]}")' for f in layout.record]
            trailing = "," if len(rows) == 1 else ""
            values = [f'"{f.name}": {f.scale:g}' for f in layout.record]
            fields.append(call(INDENT, f'"{class_name}": (', rows, f"{trailing}),"))
            scales.append(call(INDENT, f'"{class_name}": {{', values, "},"))
    return (
        "\nRECORD_FIELDS: dict[str, tuple[tuple[str, str], ...]] = {\n"
        + "".join(fields)
        + '}\n"""Fields of one record, in wire order, as numpy reads them."""\n'
        + "\nRECORD_SCALES: dict[str, dict[str, float]] = {\n"
        + "".join(scales)
        + '}\n"""Value in the unit of the field\'s name = wire integer × scale."""\n'
        + _RECORD_DTYPE
    )


def parameters(params: Sequence[ParamSpec]) -> str:
    """Return PARAMS and param_crc."""
    lines = ["\n\nPARAMS: dict[str, Param] = {\n"]
    for p in params:
        numbers = [f"{value:g}" for value in (p.default, p.minimum, p.maximum)]
        scale = "1" if p.divisor == 1 else f"{p.scale:g}"
        arguments = [str(p.id), quoted(p.name), quoted(p.unit), scale, *numbers, quoted(p.note)]
        lines.append(call(INDENT, f'"{p.name}": Param(', arguments, "),"))
    return "".join(lines) + "}\n" + _PARAM_CRC
