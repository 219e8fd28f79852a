"""Tables of docs/protocol.md."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tools.generate.text import table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from edmctl.link.faults import FaultRow
    from tools.generate.schema import Enumeration, Field, Layout, Schema


def tables(schema: Schema, faults: Sequence[FaultRow]) -> dict[str, str]:
    """Return every table by the name of its marker."""
    return {
        "hash": f"Schema hash of version {schema.major}.{schema.minor}: `0x{schema.hash:08X}`.\n",
        "index": _index(schema),
        "commands": _messages(schema, commands=True),
        "unsolicited": _messages(schema, commands=False),
        "enums": "\n".join(_enumeration(e) for e in schema.enums),
        "params": _params(schema),
        "faults": _faults(faults),
    }


def _index(schema: Schema) -> str:
    rows = []
    for m in schema.messages:
        layouts = (m.request or m.unsolicited, m.reply)
        sizes = ["–" if layout is None else _size(layout) for layout in layouts]
        rows.append([f"`{m.id:02X}`", m.name, *sizes])
    return table(["type", "message", "payload, bytes", "reply, bytes"], rows)


def _size(layout: Layout) -> str:
    if layout.record:
        return f"{layout.size} + n × {layout.record_size}"
    return f"{layout.size} + text" if any(f.type == "utf8" for f in layout.fields) else str(layout.size)


def _messages(schema: Schema, *, commands: bool) -> str:
    parts = []
    for m in schema.messages:
        if (m.request is not None) != commands:
            continue
        parts.append(f"\n### `{m.id:02X}` {m.name}\n\n{m.note}\n")
        for title, layout in (("Request", m.request), ("Reply", m.reply), ("Payload", m.unsolicited)):
            if layout is not None:
                parts.append(_layout(title, layout))
    return "".join(parts) + "\n"


def _layout(title: str, layout: Layout) -> str:
    if not layout.fields:
        return f"\n{title}: empty.\n"
    text = f"\n{title}, {_size(layout)} bytes:\n\n{_fields(layout.fields)}"
    if layout.record:
        text += f"\nOne record, {layout.record_size} bytes:\n\n{_fields(layout.record)}"
    return text


def _fields(fields: Sequence[Field]) -> str:
    rows, offset = [], 0
    for field in fields:
        rows.append([offset, field.name, field.type, lsb(field.scale, field.unit), field.note])
        offset += field.size
    return table(["byte", "field", "type", "one count is", "note"], rows)


def lsb(scale: float, unit: str) -> str:
    """Return what one count means: "0.001 um", "1 us", or nothing for a pure number."""
    if scale == 1:
        return f"1 {unit}" if unit else ""
    return f"{scale:f}".rstrip("0") + (f" {unit}" if unit else "")


def _enumeration(enumeration: Enumeration) -> str:
    kind = "bits" if enumeration.is_flags else "values"
    values = ", ".join(f"`{value}` {name}" for name, value in enumeration.values)
    return f"**{enumeration.name}** ({kind}). {enumeration.note}: {values}.\n"


def _params(schema: Schema) -> str:
    rows = [
        [p.id, f"`{p.name}`", lsb(p.scale, p.unit), f"{p.default:g}", f"{p.minimum:g}..{p.maximum:g}", p.note]
        for p in schema.params
    ]
    return table(["id", "parameter", "one count is", "default", "range", "note"], rows)


def _faults(faults: Sequence[FaultRow]) -> str:
    keys = ("code", "name", "who", "detect", "reaction", "pulses_off_s", "message", "hint")
    rows = [[getattr(row, key) for key in keys] for row in faults]
    head = ["code", "name", "who", "detected by", "reaction", "pulses off within, s", "message", "what to do"]
    return table(head, rows)
