"""One recorded frame per message and direction: what a firmware author must produce, byte for byte."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TypedDict

import pytest

from edmctl.link.frame import Frame, FrameDecoder, encode_frame
from edmctl.link.messages import REQUESTS, UNSOLICITED, param_crc
from edmctl.link.wire import Message

TYPES: dict[str, type[Message]] = {
    kind.NAME: kind for kind in (*REQUESTS.values(), *UNSOLICITED.values())
} | {f"{request.NAME}_REPLY": request.REPLY for request in REQUESTS.values()}
"""Every message by name."""
GOLDEN = Path(__file__).with_name("golden")
NAMES = sorted(TYPES)
DEFAULT_PARAM_CRC = 0x7B4AA305


class Golden(TypedDict):
    type: str
    seq: int
    session: str
    flags: int
    fields: dict[str, object]
    records: list[dict[str, float]]
    frame: str


def golden(name: str) -> Golden:
    loaded: Golden = json.loads((GOLDEN / f"{name}.json").read_text(encoding="utf-8"))
    return loaded


def wire(name: str) -> bytes:
    return bytes.fromhex(golden(name)["frame"])


def decoded(name: str) -> Frame:
    (frame,) = FrameDecoder().feed(wire(name))
    return frame


def test_every_message_has_a_recorded_frame() -> None:
    assert sorted(path.stem for path in GOLDEN.glob("*.json")) == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_the_recorded_frame_reads_as_its_fields(name: str) -> None:
    expected, frame = golden(name), decoded(name)
    message = TYPES[name].unpack(frame.payload)
    assert frame[:4] == (int(expected["type"], 16), expected["seq"], int(expected["session"], 16), 0)
    assert {key: getattr(message, key) for key in expected["fields"]} == expected["fields"]


@pytest.mark.parametrize("name", NAMES)
def test_the_fields_pack_to_the_recorded_frame(name: str) -> None:
    expected, frame = golden(name), decoded(name)
    fields = dict(expected["fields"])
    if "records" in expected:
        size = len(expected["records"]) * TYPES[name].record_dtype().itemsize
        fields["records"] = frame.payload[-size:]
    payload = TYPES[name](**fields).pack()
    assert encode_frame(*frame[:4], payload) == wire(name)


@pytest.mark.parametrize("name", [n for n in NAMES if TYPES[n].RECORD])
def test_the_recorded_records_read_as_their_values(name: str) -> None:
    import numpy as np

    expected, frame = golden(name), decoded(name)
    dtype, scales = TYPES[name].record_dtype(), TYPES[name].record_scales()
    records = np.frombuffer(getattr(TYPES[name].unpack(frame.payload), "records"), dtype)  # noqa: B009
    assert list(scales) == list(dtype.names or ())
    for record, row in zip(records, expected["records"], strict=True):
        assert {key: record[key] * scale for key, scale in scales.items()} == pytest.approx(row)


@pytest.mark.parametrize("name", [n for n in NAMES if n != "LOG"])
def test_a_payload_of_the_wrong_length_is_refused(name: str) -> None:
    payload = decoded(name).payload
    for wrong in (payload + b"\0", payload[:-1]) if payload else (b"\0",):
        with pytest.raises(ValueError, match=f"{TYPES[name].NAME}: payload of {len(wrong)} bytes, expected"):
            TYPES[name].unpack(wrong)


def test_the_check_of_the_default_parameters_is_the_recorded_one() -> None:
    assert param_crc({}) == DEFAULT_PARAM_CRC
    assert param_crc({"piezo_max_v": 120.0}) == DEFAULT_PARAM_CRC
    assert param_crc({"piezo_max_v": 119.999}) != DEFAULT_PARAM_CRC


def test_the_worked_example_of_the_page_is_a_recorded_frame() -> None:
    page = (Path(__file__).parents[2] / "docs" / "protocol.md").read_text(encoding="utf-8")
    assert wire("PIEZO_SET").hex(" ") in page
    assert "PIEZO_SET seq=137 session=5a actuator_v=150.0 slew_v_s=337.25" in page
    assert f"`{param_crc({}):08X}`" in page
