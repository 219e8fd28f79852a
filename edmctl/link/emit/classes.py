"""Source of one message: a frozen dataclass that packs and unpacks itself."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

from edmctl.link.emit.source import INDENT, LINE_LENGTH, call
from edmctl.link.schema import TEXT_TYPE

if TYPE_CHECKING:
    from edmctl.link.schema import Field, Layout, MessageSpec

_MISFIT = """\
        except MISFIT as error:
            raise misfit(self, error) from None
"""


def message_class(message: MessageSpec, layout: Layout, suffix: str, max_payload: int) -> str:
    """Return the class of one direction of a message; `suffix` is "_REPLY" for a reply, else empty."""
    name = message.name + suffix
    class_name = message.class_name + ("Reply" if suffix else "")
    lines = [
        f"\n\n@dataclass(frozen=True, slots=True)\nclass {class_name}:\n",
        _docstring(f"Reply to {message.name}." if suffix else message.note),
        f"\n    ID: ClassVar[int] = 0x{message.id:02X}\n",
        f'    NAME: ClassVar[str] = "{name}"\n',
    ]
    if layout.fields:
        lines.append("\n")
    lines += [_field(f) for f in layout.fields]
    if layout.record:
        lines.append(f"    records: bytes  # n × {layout.record_size} bytes, see RECORD_FIELDS\n")
    lines.append(_pack(name, layout, max_payload))
    lines.append(_unpack(name, layout))
    if message.request is layout:
        reply = f"{message.class_name}Reply"
        lines.append(f"\n    def unpack_reply(self, payload: bytes) -> {reply}:\n")
        lines.append(f"        return {reply}.unpack(payload)\n")
    return "".join(lines)


def _docstring(text: str) -> str:
    if len(text) + 10 <= LINE_LENGTH:
        return f'    """{text}"""\n'
    wrapped = textwrap.fill(f'"""{text}', LINE_LENGTH, initial_indent=INDENT, subsequent_indent=INDENT)
    return f'{wrapped}\n    """\n'


def _python_type(field: Field) -> str:
    if field.type in (TEXT_TYPE, "s12"):
        return "str"
    return "int" if field.divisor == 1 else "float"


def _field(field: Field) -> str:
    size = f" × {field.scale:g}" if field.divisor != 1 else ""
    comment = f"{field.type}{size}{' ' + field.unit if field.unit else ''}"
    if field.note:
        comment += f": {field.note}"
    declaration = f"    {field.name}: {_python_type(field)}"
    line = f"{declaration}  # {comment}\n"
    return line if len(line) <= LINE_LENGTH + 1 else f"    # {comment}\n{declaration}\n"


def _packed(field: Field) -> str:
    if field.type == "s12":
        return f"ascii_bytes(self.{field.name}, {field.size})"
    return f"round(self.{field.name} * {field.divisor})" if field.divisor != 1 else f"self.{field.name}"


def _pack(name: str, layout: Layout, max_payload: int) -> str:
    head = "\n    def pack(self) -> bytes:\n"
    if not layout.fields:
        return head + '        return b""\n'
    room = max_payload - layout.size
    values = [_packed(f) for f in layout.fields if f.type != TEXT_TYPE]
    tail = ")"
    if layout.record:
        tail = f") + checked_records(self.records, self.n, {layout.record_size}, {room})"
    elif layout.fields[-1].type == TEXT_TYPE:
        tail = f") + checked_text(self.{layout.fields[-1].name}, {room})"
    packing = call(INDENT * 3, f"return _{name}.pack(", values, tail)
    return f"{head}        try:\n{packing}" + _MISFIT


def _unpacked(field: Field) -> str:
    if field.type == "s12":
        return f'{field.name}.rstrip(b"\\0").decode("ascii")'
    return f"{field.name} / {field.divisor}" if field.divisor != 1 else field.name


def _length_check(name: str, layout: Layout) -> str:
    size = layout.size
    if layout.record:
        offset = sum(f.size for f in layout.fields[: [f.name for f in layout.fields].index("n")])
        expected = f"{size} + {layout.record_size} * payload[{offset}]"
        return (
            f"        if len(payload) < {size}:\n"
            f'            raise wrong_length("{name}", {size}, len(payload))\n'
            f"        if len(payload) != {expected}:\n"
            f'            raise wrong_length("{name}", {expected}, len(payload))\n'
        )
    comparison = "<" if any(f.type == TEXT_TYPE for f in layout.fields) else "!="
    condition = f"len(payload) {comparison} {size}" if size else "payload"
    return f'        if {condition}:\n            raise wrong_length("{name}", {size}, len(payload))\n'


def _unpack(name: str, layout: Layout) -> str:
    head = "\n    @classmethod\n    def unpack(cls, payload: bytes) -> Self:\n" + _length_check(name, layout)
    if not layout.fields:
        return head + "        return cls()\n"
    fixed = [f for f in layout.fields if f.type != TEXT_TYPE]
    has_tail = bool(layout.record) or len(fixed) < len(layout.fields)
    unpacking = f"_{name}.unpack_from(payload)" if has_tail else f"_{name}.unpack(payload)"
    tail = []
    if layout.record:
        tail = [f"payload[{layout.size}:]"]
    elif has_tail:
        tail = [f'payload[{layout.size}:].decode("utf-8", "replace")']
    if not tail and all(_unpacked(f) == f.name for f in fixed):
        return head + call(INDENT * 2, "return cls(", [f"*{unpacking}"])
    names = [f.name for f in fixed]
    if len(names) == 1:
        targets = f"        ({names[0]},) = {unpacking}\n"
    else:
        targets = f"        {', '.join(names)} = {unpacking}\n"
        if len(targets) > LINE_LENGTH + 1:
            targets = call(INDENT * 2, "(", names, f") = {unpacking}")
    return head + targets + call(INDENT * 2, "return cls(", [*(_unpacked(f) for f in fixed), *tail])
