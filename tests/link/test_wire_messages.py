"""Messages carry physical values through wire integers and refuse what does not fit."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass, replace
from math import inf, nan

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edmctl.link.frame import Frame, FrameDecoder, encode_frame
from edmctl.link.messages import (
    PARAMS,
    REQUESTS,
    GetStatusReply,
    HelloReply,
    Log,
    PiezoSet,
    ServoStart,
    Tlm,
    param_crc,
)
from edmctl.link.wire import Message, saturated
from tests.link.test_golden import TYPES
from tools.generate.schema import Field, Layout, load_schema

SCHEMA = load_schema()


def values(field: Field) -> st.SearchStrategy[object]:
    if field.type == "utf8":
        return st.text(st.characters(exclude_categories=["Cs"]), max_size=60)
    if field.type == "s12":
        return st.text(st.characters(min_codepoint=1, max_codepoint=127), max_size=12)
    bits = int(field.type[1:])
    low, high = (0, 2**bits - 1) if field.type[0] == "u" else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    wire = st.integers(low, high)
    return wire if field.divisor == 1 else wire.map(lambda n: n / field.divisor)


@st.composite
def messages(draw: st.DrawFn) -> tuple[str, dict[str, object]]:
    name, layout = draw(st.sampled_from(SCHEMA.layouts()))
    fields = {f.name: draw(values(f)) for f in layout.fields}
    if layout.record:
        fields["n"] = draw(st.integers(0, most_records(layout)))
        size = layout.record_size * int(str(fields["n"]))
        fields["records"] = draw(st.binary(min_size=size, max_size=size))
    return name, fields


def most_records(layout: Layout) -> int:
    return (SCHEMA.max_payload - layout.size) // layout.record_size


@given(messages(), st.integers(0, 255), st.integers(0, 255))
def test_every_message_comes_back_as_it_went(
    message: tuple[str, dict[str, object]], seq: int, session: int
) -> None:
    name, fields = message
    sent = TYPES[name](**fields)
    (frame,) = FrameDecoder().feed(encode_frame(sent.ID, seq, session, 0, sent.pack()))
    assert frame == Frame(sent.ID, seq, session, 0, sent.pack())
    assert TYPES[name].unpack(frame.payload) == sent


def test_a_class_gets_its_codec_once_whoever_asks_first() -> None:
    @dataclass(slots=True)
    class Probe(Message):
        ID, NAME = 0xBF, "PROBE"
        WIRE = "u16/10"

        gap_v: float

    pack, unpack = Probe(1.5).pack, Probe.unpack
    assert [unpack(pack()), unpack(pack())] == [Probe(1.5), Probe(1.5)]
    made = vars(Probe)["pack"]
    assert (pack(), Probe(1.5).pack()) == (b"\x0f\x00", b"\x0f\x00")
    assert vars(Probe)["pack"] is made


def test_values_go_to_the_nearest_count() -> None:
    assert PiezoSet.unpack(PiezoSet(10.0012, 0.0).pack()).actuator_v == 10.0
    assert PiezoSet.unpack(PiezoSet(10.0013, 0.0).pack()).actuator_v == 10.0025
    assert ServoStart.unpack(ServoStart(0.0, -0.0006, 0.0).pack()).z_limit_um == -0.001


@pytest.mark.parametrize("volts", [-0.01, 163.84, inf, nan])
def test_a_value_beyond_its_wire_type_is_refused_with_its_message(volts: float) -> None:
    with pytest.raises(ValueError, match=r"PiezoSet\(actuator_v=.*does not fit"):
        PiezoSet(volts, 1.0).pack()


def test_the_edges_of_a_wire_type_pass() -> None:
    assert PiezoSet(163.8375, 4294967.295).pack() == b"\xff" * 6
    low = GetStatusReply(0, 0, 0, -2147483.648, 0.0, 0.0, 0.0, 0.0, 0.0, -3276.8, 0.0, -327.68, 0)
    assert GetStatusReply.unpack(low.pack()) == low


def test_what_is_measured_saturates() -> None:
    told = GetStatusReply(3, 7, 1, 1e30, -inf, 12.5, nan, 163.9, -0.1, inf, nan, 3.0, 5)
    wire = GetStatusReply.unpack(saturated(told).pack())
    assert (wire.displacement_um, wire.x_um, wire.y_um) == (2147483.647, -2147483.648, 12.5)
    assert (wire.theta_deg, wire.actuator_v, wire.gap_v) == (-2147483.648, 163.8375, 0.0)
    assert (wire.temperature_c, wire.flow_lpm, wire.monitor_v) == (3276.7, 0.0, 3.0)
    assert (wire.state, wire.fault, wire.interlocks, wire.flags) == (3, 7, 1, 5)


def test_records_must_be_as_many_as_announced_and_fit_a_frame() -> None:
    for n, size in ((1, 15), (2, 16), (15, 240)):
        with pytest.raises(ValueError, match="records"):
            Tlm(0, 0, 1000, n, 0, bytes(size)).pack()
    assert len(Tlm(0, 0, 1000, 14, 0, bytes(224)).pack()) == 234


def test_text_that_does_not_fit_is_refused() -> None:
    with pytest.raises(ValueError, match="245 fit"):
        Log(1, "é" * 123).pack()
    for serial in ("1234567890123", "é", "a\0b"):
        with pytest.raises(ValueError, match="does not fit"):
            replace(HelloReply.unpack(bytes(49)), serial=serial).pack()


def test_text_cut_in_the_middle_of_a_letter_is_still_shown() -> None:
    assert Log.unpack(b"\x01l\xc3").text == "l\ufffd"


def test_records_are_packed_as_tightly_as_on_the_wire() -> None:
    for message in SCHEMA.messages:
        if message.unsolicited is not None and message.unsolicited.record:
            assert TYPES[message.name].record_dtype().itemsize == message.unsolicited.record_size


def test_every_command_knows_its_reply() -> None:
    for request in REQUESTS.values():
        reply = next(layout for name, layout in SCHEMA.layouts() if name == f"{request.NAME}_REPLY")
        zeros = bytes(reply.size)
        command = request.unpack(bytes(next(x.size for n, x in SCHEMA.layouts() if n == request.NAME)))
        assert command.unpack_reply(zeros) == TYPES[f"{request.NAME}_REPLY"].unpack(zeros)


@given(st.sampled_from(sorted(PARAMS)), st.data())
def test_parameters_survive_the_wire_within_half_a_count(name: str, data: st.DataObject) -> None:
    param = PARAMS[name]
    value = data.draw(st.floats(param.minimum, param.maximum))
    assert param.from_wire(param.to_wire(value)) == pytest.approx(value, abs=0.5001 * param.scale)


def test_parameters_out_of_range_or_unknown_are_refused() -> None:
    with pytest.raises(ValueError, match=r"piezo_max_v = 151 V is outside 0\.\.150"):
        PARAMS["piezo_max_v"].to_wire(151)
    with pytest.raises(ValueError, match="outside"):
        param_crc({"watchdog_s": nan})
    with pytest.raises(ValueError, match="no such parameter: piezo_max"):
        param_crc({"piezo_max": 1.0})


def test_messages_load_without_numpy() -> None:
    code = "import sys, edmctl.link.session; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
