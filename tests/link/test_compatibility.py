"""Two schemas that differ: what is said of it, and what of a controller that cannot tell."""

from __future__ import annotations

import copy
import json
import zlib
from typing import Any

import pytest

from edmctl.errors import ProtocolMismatch
from edmctl.link.compatibility import check_hello, differing, fetch_schema, introduction
from edmctl.link.link_errors import CommandRefused
from edmctl.link.messages import (
    PROTO_MAJOR,
    PROTO_MINOR,
    SCHEMA_HASH,
    GetSchema,
    GetSchemaReply,
    Hello,
    Status,
)
from edmctl.link.wire import Request
from tools.generate.schema import load_schema

OURS: dict[str, Any] = json.loads(load_schema().canonical_json())


def changed() -> dict[str, Any]:
    theirs = copy.deepcopy(OURS)
    theirs["messages"][3]["request"] = [["offset", "u32", "", 1]]
    theirs["messages"] = [m for m in theirs["messages"] if m["name"] != "JUMP"]
    theirs["params"].append([99, "extra", "", 1, 0, 0, 1])
    return theirs


class Controller:
    """Answers GET_SCHEMA in pages of 243 bytes."""

    def __init__(self, data: bytes) -> None:
        self.data = data

    def __call__(self, message: Request[Any], /) -> Any:
        assert isinstance(message, GetSchema)
        part = self.data[message.offset : message.offset + 243]
        return GetSchemaReply(len(self.data), len(part), part)


def packed(schema: object) -> bytes:
    return zlib.compress(json.dumps(schema).encode())


def hello(minor: int = PROTO_MINOR, schema_hash: int = 7) -> bytes:
    return Hello(PROTO_MAJOR, minor, 1, schema_hash).pack()


def test_the_same_schema_passes() -> None:
    check_hello(hello(schema_hash=SCHEMA_HASH), "port", Controller(b""))


def test_what_differs_is_named() -> None:
    theirs = changed()
    names = differing(theirs, OURS)
    assert set(names) == {OURS["messages"][3]["name"], "JUMP", "extra"}
    with pytest.raises(ProtocolMismatch, match="the controller is older") as caught:
        check_hello(hello(PROTO_MINOR - 1), "port", Controller(packed(theirs)))
    assert f"They differ in {', '.join(names)}." in caught.value.message
    assert caught.value.hint.startswith("Update the controller's firmware: `edmctl firmware build")


def test_many_differences_are_counted() -> None:
    theirs = {**OURS, "params": []}
    with pytest.raises(ProtocolMismatch, match=r"They differ in (\w+, ){7}\w+ and \d+ more\."):
        check_hello(hello(), "port", Controller(packed(theirs)))


def test_pages_add_up_to_the_schema() -> None:
    assert fetch_schema(Controller(packed(OURS))) == OURS


@pytest.mark.parametrize(
    "data", [b"", b"no zlib", packed([1, 2]), packed({"messages": 5}), packed({"params": [[]]})]
)
def test_a_controller_that_tells_nonsense_is_refused_all_the_same(data: bytes) -> None:
    with pytest.raises(ProtocolMismatch, match="unreleased build"):
        check_hello(hello(), "port", Controller(data))


def test_a_controller_without_a_schema_is_refused_all_the_same() -> None:
    def refuse(message: Request[Any], /) -> Any:
        raise CommandRefused("unknown", status=Status.UNKNOWN_TYPE)

    with pytest.raises(ProtocolMismatch) as refusal:
        check_hello(hello(PROTO_MINOR + 1), "port", refuse)
    assert str(refusal.value).endswith("this program is older.")


def told_by_another_version() -> tuple[dict[str, Any], bytes]:
    """A schema whose reply to HELLO has a field more and other states, and such a reply."""
    theirs = copy.deepcopy(OURS)
    layout = next(m for m in theirs["messages"] if m["name"] == "HELLO")["reply"]
    layout.insert(4, ["branch", "u64", "", 1])
    states = next(e for e in theirs["enums"] if e[0] == "State")[2]
    states[2][0] = "READY"
    values = {
        "proto_major": PROTO_MAJOR,
        "proto_minor": 1,
        "host_nonce": 1,
        "schema_hash": 7,
        "branch": 1 << 63,
    }
    values |= {"fw_major": 3, "fw_minor": 4, "fw_patch": 5, "board": 0x0429, "state": 2, "fault": 1001}
    sizes = {"u8": 1, "u16": 2, "u32": 4, "u64": 8}
    parts = [
        b"NUMBER 7\0\0\0\0" if kind == "s12" else values.get(name, 0).to_bytes(sizes[kind], "little")
        for name, kind, *_ in layout
    ]
    return theirs, b"".join(parts)


def test_a_controller_of_another_version_is_read_by_its_own_schema() -> None:
    theirs, payload = told_by_another_version()
    told = introduction(payload, "port", Controller(packed(theirs)))
    assert (told.protocol, told.schema_hash, told.has_same_schema) == ((PROTO_MAJOR, 1), 7, False)
    assert (told.state, told.fields["serial"], told.fields["fw_patch"]) == ("READY", "NUMBER 7", 5)
    assert (told.fields["board"], told.fields["fault"]) == (0x0429, 1001)
    assert told.differing == ("HELLO", "State")


@pytest.mark.parametrize("data", [b"", b"no zlib", packed([1, 2]), packed({"messages": 5}), packed(OURS)])
def test_a_controller_that_cannot_tell_its_schema_tells_its_version_alone(data: bytes) -> None:
    _, payload = told_by_another_version()
    told = introduction(payload[:20], "port", Controller(data))
    assert (told.protocol, told.schema_hash, told.state, told.fields) == ((PROTO_MAJOR, 1), 7, "", {})


def test_what_does_not_speak_the_protocol_is_told() -> None:
    with pytest.raises(ProtocolMismatch, match="does not speak EDM Link"):
        introduction(bytes(9), "port", Controller(b""))
