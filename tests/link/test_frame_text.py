"""The text of a frame tells name, addressing and every field."""

from __future__ import annotations

import pytest

from edmctl.link.frame import Frame
from edmctl.link.messages import (
    Event,
    EventCode,
    GetStatusReply,
    Log,
    PiezoSet,
    PulseConfig,
    State,
    Status,
    Tlm,
)
from tests.link.frame_text import render


@pytest.mark.parametrize(
    ("frame", "text"),
    [
        (
            Frame(PiezoSet.ID, 7, 0x5A, 0, PiezoSet(60.0, 337.0).pack()),
            "PIEZO_SET seq=7 session=5a actuator_v=60.0 slew_v_s=337.0",
        ),
        (Frame(0x50, 7, 0x5A, Status.BAD_STATE, b""), "PIEZO_SET_REPLY seq=7 session=5a status=BAD_STATE"),
        (Frame(0x50, 7, 0x5A, 77, b"\x01"), "PIEZO_SET_REPLY seq=7 session=5a status=77 payload=01"),
        (
            Frame(0x81, 0, 1, 0, Event(3, 99, EventCode.TOUCH, 2, -1.5, 10.0).pack()),
            "EVENT seq=0 session=01 event_no=3 t_us=99 code=TOUCH arg=2 displacement_um=-1.5 actuator_v=10.0",
        ),
        (Frame(0x83, 0, 1, 0, Log(1, 'a "b"\nc').pack()), r'LOG seq=0 session=01 level=1 text="a \"b\"\nc"'),
        (
            Frame(0x80, 0, 1, 0, Tlm(1, 2, 1000, 1, 0, bytes(range(16))).pack()),
            "TLM seq=0 session=01 counter=1 t0_us=2 period_us=1000 n=1 dropped=0 "
            "records=000102030405060708090a0b0c0d0e0f",
        ),
        (Frame(0x80, 0, 1, 2, b"xx"), "TLM seq=0 session=01 flags=02 payload=7878"),
        (Frame(0xBF, 0, 1, 0, b"\xff"), "UNKNOWN type=bf seq=0 session=01 payload=ff"),
        (Frame(0x3E, 0, 1, 0, b""), "UNKNOWN type=3e seq=0 session=01"),
        (Frame(0x7E, 0, 1, 0, b""), "UNKNOWN type=7e seq=0 session=01"),
    ],
)
def test_a_frame_reads_as_name_and_values(frame: Frame, text: str) -> None:
    assert render(frame) == text


def test_enumerations_and_flags_are_named_and_strange_values_kept() -> None:
    status = GetStatusReply(State.MACHINING, 0, 6, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0)
    text = render(Frame(0x44, 0, 1, 0, status.pack()))
    assert "state=MACHINING fault=0 interlocks=DOOR|DIELECTRIC_LEVEL" in text
    pulses = PulseConfig(1.0, 1.0, 40.0, 1.0, 9, 0.0)
    assert "mode=9 " in render(Frame(PulseConfig.ID, 0, 1, 0, pulses.pack()))
