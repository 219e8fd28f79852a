"""Whether host and controller speak the same protocol, and which of them to update if not."""

from __future__ import annotations

import json
import struct
import zlib
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from edmctl.errors import EdmError, ProtocolMismatch
from edmctl.link.messages import PROTO_MAJOR, PROTO_MINOR, SCHEMA_HASH, GetSchema

if TYPE_CHECKING:
    from edmctl.link.wire import Request

# The first ten bytes of a HELLO reply mean the same in every version.
_FIXED_PART = struct.Struct("<BBII")
_MOST_NAMED = 8
_MOST_BYTES = 1 << 20
"""Of a compressed schema; this program's own has some thousand."""

ReplyT = TypeVar("ReplyT")


class Ask(Protocol):
    """Sends a command and returns its reply."""

    def __call__(self, message: Request[ReplyT], /) -> ReplyT:
        """Raise EdmError where there is none."""
        ...


def check_hello(payload: bytes, name: str, ask: Ask) -> None:
    """Raise ProtocolMismatch where the reply to HELLO tells of another major version or another schema.

    Of another schema the error names what differs, as far as the controller tells when it is asked.
    """
    if len(payload) < _FIXED_PART.size:
        raise ProtocolMismatch(
            f"What answers at {name} does not speak EDM Link.",
            hint="Check that this is the controller's port.",
        )
    major, minor, _, schema_hash = _FIXED_PART.unpack_from(payload)
    if major == PROTO_MAJOR and schema_hash == SCHEMA_HASH:
        return
    verdict, hint = _verdict((major, minor))
    raise ProtocolMismatch(
        f"The controller at {name} speaks EDM Link {major}.{minor} (schema {schema_hash:08X}), "
        f"this program {PROTO_MAJOR}.{PROTO_MINOR} (schema {SCHEMA_HASH:08X}): {verdict}.{_difference(ask)}",
        hint=hint,
    )


def fetch_schema(ask: Ask) -> dict[str, Any]:
    """Return the schema that the controller keeps, as the mapping of its canonical JSON.

    Raises EdmError where it has none, ValueError where what came is not one.
    """
    data = b""
    while True:
        reply = ask(GetSchema(len(data)))
        if not reply.n:
            break
        data += reply.records
        if len(data) >= min(reply.total, _MOST_BYTES):
            break
    try:
        schema = json.loads(zlib.decompress(data))
    except zlib.error as error:
        raise ValueError(str(error)) from error
    if not isinstance(schema, dict):
        raise ValueError("the schema is not a table")
    return schema


def differing(theirs: dict[str, Any], ours: dict[str, Any]) -> list[str]:
    """Return the names of the messages, enumerations and parameters that are not the same in both schemas."""
    names = []
    for key, name_at in (("messages", "name"), ("enums", 0), ("params", 1)):
        a, b = ({entry[name_at]: entry for entry in schema.get(key, ())} for schema in (theirs, ours))
        names += sorted(str(name) for name in a.keys() | b.keys() if a.get(name) != b.get(name))
    return names


def _difference(ask: Ask) -> str:
    from edmctl.link.schema import load_schema

    try:
        names = differing(fetch_schema(ask), json.loads(load_schema().canonical_json()))
    except (EdmError, ValueError, TypeError, KeyError, IndexError):
        return ""
    if not names:
        return ""
    more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
    return f" They differ in {', '.join(names[:_MOST_NAMED])}{more}."


def _verdict(controller: tuple[int, int]) -> tuple[str, str]:
    host = (PROTO_MAJOR, PROTO_MINOR)
    if controller < host:
        return "the controller is older", "Update the controller's firmware."
    if controller > host:
        return "this program is older", "Update edmctl."
    return (
        "both claim the same version but their messages differ, so one is an unreleased build",
        "Install a released edmctl and the firmware released with it.",
    )
