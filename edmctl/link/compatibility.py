"""Whether host and controller speak the same protocol, and which of them to update if not."""

from __future__ import annotations

import json
import struct
import zlib
from pathlib import Path
from typing import Any, Protocol, TypeVar

from edmctl import failures
from edmctl.dataclasses import dataclass
from edmctl.errors import EdmError
from edmctl.link.messages import PROTO_MAJOR, PROTO_MINOR, SCHEMA_HASH, GetSchema, Hello
from edmctl.link.wire import Request

# The first ten bytes of a HELLO reply mean the same in every version.
_FIXED_PART = struct.Struct("<BBII")
_MOST_NAMED = 8
_MOST_BYTES = 1 << 20
"""Of a compressed schema; this program's own has some thousand."""

_CODES = {"u8": "B", "i8": "b", "u16": "H", "i16": "h", "u32": "I", "i32": "i", "u64": "Q", "i64": "q"}

_BUILD_AND_FLASH = "`edmctl firmware build --board stm32f4`, `edmctl firmware flash edmctl-stm32f4.bin`"
UPDATE = (
    f"Update the controller's firmware: {_BUILD_AND_FLASH}. A virtual controller is served by this edmctl."
)

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
    major, minor, schema_hash = _fixed_part(payload, name)
    if major == PROTO_MAJOR and schema_hash == SCHEMA_HASH:
        return
    verdict, hint = _verdict((major, minor))
    raise failures.protocol_differs(
        name=name,
        major=major,
        minor=minor,
        its_hash=schema_hash,
        proto_major=PROTO_MAJOR,
        proto_minor=PROTO_MINOR,
        own_hash=SCHEMA_HASH,
        verdict=verdict,
        ask=_difference(ask),
        remedy=hint,
    )


def _fixed_part(payload: bytes, name: str) -> tuple[int, int, int]:
    if len(payload) < _FIXED_PART.size:
        raise failures.not_edm_link(name=name)
    major, minor, _, schema_hash = _FIXED_PART.unpack_from(payload)
    return major, minor, schema_hash


@dataclass(frozen=True, slots=True)
class Introduction:
    """What a controller says of itself, of whatever version.

    fields : of its reply to HELLO, by name; none where its schema is another one and cannot be had.
    state : its name, "" where that is not known. differing : names that its schema and this program's do not share.
    """

    protocol: tuple[int, int]
    schema_hash: int
    fields: dict[str, Any]
    state: str
    differing: tuple[str, ...]

    @property
    def has_same_schema(self) -> bool:
        """Whether it speaks what this program speaks."""
        return self.protocol[0] == PROTO_MAJOR and self.schema_hash == SCHEMA_HASH


def introduction(payload: bytes, name: str, ask: Ask) -> Introduction:
    """Read the reply to HELLO of any version, with the controller's own schema where that is another one.

    Raises ProtocolMismatch for what does not speak EDM Link.
    """
    major, minor, schema_hash = _fixed_part(payload, name)
    ours = own_schema()
    theirs, names = ours, []
    if (major, schema_hash) != (PROTO_MAJOR, SCHEMA_HASH):
        try:
            theirs = fetch_schema(ask)
            names = differing(theirs, ours)
        except (EdmError, ValueError, TypeError, KeyError, IndexError):
            theirs = {}
    try:
        fields = _hello_fields(payload, theirs)
        states = {
            number: state for enum in theirs["enums"] if enum[0] == "State" for state, number in enum[2]
        }
        state = states.get(fields["state"], f"state {fields['state']}")
    except (ValueError, TypeError, KeyError, IndexError, struct.error):
        fields, state = {}, ""
    return Introduction((major, minor), schema_hash, fields, state, tuple(names))


def _hello_fields(payload: bytes, schema: dict[str, Any]) -> dict[str, Any]:
    """The fields of a reply to HELLO by a schema; numbers and padded text are all that it may hold."""
    layout = next(message["reply"] for message in schema["messages"] if message["name"] == Hello.NAME)
    codes = [f"{kind[1:]}s" if kind[0] == "s" else _CODES[kind] for _, kind, *_ in layout]
    values = struct.unpack_from("<" + "".join(codes), payload)
    texts = (v.rstrip(b"\0").decode("ascii", "replace") if isinstance(v, bytes) else v for v in values)
    return dict(zip((name for name, *_ in layout), texts, strict=True))


def own_schema() -> dict[str, Any]:
    """Return this program's schema, as the mapping of its canonical JSON."""
    path = Path(__file__).with_name("edmlink1.json")
    return json.loads(path.read_text(encoding="ascii"))  # type: ignore[no-any-return]


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
    try:
        names = differing(fetch_schema(ask), own_schema())
    except (EdmError, ValueError, TypeError, KeyError, IndexError):
        return ""
    if not names:
        return ""
    more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
    return f" They differ in {', '.join(names[:_MOST_NAMED])}{more}."


def _verdict(controller: tuple[int, int]) -> tuple[str, str]:
    host = (PROTO_MAJOR, PROTO_MINOR)
    if controller < host:
        return "the controller is older", UPDATE
    if controller > host:
        return "this program is older", "Update edmctl."
    return (
        "both claim the same version but their messages differ, so one is an unreleased build",
        f"Install a released edmctl and the firmware released with it, or bring both to one: {_BUILD_AND_FLASH}.",
    )
