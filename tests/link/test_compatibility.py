"""Two schemas that differ: what is said of it, and what of a controller that cannot tell."""

from __future__ import annotations

import copy
import json
import zlib
from typing import TYPE_CHECKING, Any

import pytest

from edmctl.errors import ProtocolMismatch
from edmctl.link.compatibility import check_hello, differing, fetch_schema
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
from edmctl.link.schema import load_schema

if TYPE_CHECKING:
    from edmctl.link.wire import Request

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
