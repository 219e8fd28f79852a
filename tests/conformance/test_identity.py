"""L14, L16, L18 and L19: versions, schema, parameters, rates, clock."""

from __future__ import annotations

import json
import zlib
from collections.abc import Iterator
from typing import Any

import pytest

from tests.conformance import layouts
from tests.conformance.acts import OFF_US, ON_US, OPEN_V, arm
from tests.conformance.peer import STATUS, STATUS_NAMES, Peer

PULSE_LOG, PULSE_MODE = layouts.enum("PulseLog"), layouts.enum("PulseMode")
PULSES = {"on_time_us": ON_US, "off_time_us": OFF_US, "open_voltage_v": OPEN_V, "peak_current_a": 0.1}
TLM_HEAD, TLM_ROW, BLOCK_HEAD, BLOCK_ROW, PULSE_HEAD, PULSE_ROW = 10, 16, 16, 12, 15, 6
BLOCKS_PER_FRAME, PULSES_PER_FRAME = 19, 38
FRAME_COST = 11  # header, check, stuffing, two zeros
RESERVE = 1.25
ASSUMED_BAUD = 115_200


@pytest.mark.parametrize(
    "other",
    [
        {"proto_major": layouts.MAJOR + 1},
        {"proto_minor": layouts.MINOR + 1},
        {"proto_minor": 0},
        {"schema_hash": layouts.schema_hash() ^ 1},
        {"proto_major": 255, "proto_minor": 255, "schema_hash": 0},
    ],
    ids=["major", "newer", "older", "schema", "all"],
)
def test_l14_a_host_of_another_version_learns_the_controllers(peer: Peer, other: dict[str, int]) -> None:
    reply = peer.hello(**other)
    status = STATUS_NAMES[reply.status]
    served = {"proto_major", "schema_hash"}.isdisjoint(other)
    assert status == ("OK" if served else "VERSION"), peer.story(f"status {status} to HELLO", "versions")
    assert (reply.proto_major, reply.proto_minor) == (layouts.MAJOR, layouts.MINOR)
    assert reply.schema_hash == layouts.schema_hash()


def schema_pages(peer: Peer) -> bytes:
    """The schema as the controller tells it, still compressed."""
    data, total = b"", 1
    while len(data) < total:
        page = peer.ok("GET_SCHEMA", offset=len(data))
        total = page.total
        assert page.n, peer.story(f"an empty page at {len(data)} of {total}", "versions")
        data += b"".join(page.records)
    return data


def test_l14_the_schema_of_the_controller_is_that_of_its_hash(peer: Peer) -> None:
    hello = peer.hello()
    text = zlib.decompress(schema_pages(peer))
    assert zlib.crc32(text) == hello.schema_hash, peer.story("schema and hash disagree", "versions")
    schema = json.loads(text)
    assert (schema["major"], schema["minor"]) == (hello.proto_major, hello.proto_minor)
    assert {m["name"]: m["id"] for m in schema["messages"]} == layouts.COMMANDS | layouts.UNASKED


def test_l14_a_host_without_a_session_learns_the_schema_and_nothing_else(peer: Peer) -> None:
    whole = schema_pages(peer)
    peer.hello(schema_hash=layouts.schema_hash() ^ 1)
    assert schema_pages(peer) == whole, peer.story("the schema of a refused HELLO", "versions")
    for name in ("GET_STATUS", "GET_PARAM", "TLM_START"):
        seq = peer.send(name)
        assert peer.reply_to(layouts.NAMES[name], seq, 0.06) is None, peer.story(
            f"{name} answered", "versions"
        )


def test_l14_asking_for_the_schema_without_a_session_feeds_nothing(peer: Peer) -> None:
    arm(peer)
    peer.fresh_beat()
    type_id = layouts.NAMES["GET_SCHEMA"]
    peer.beating = False
    for number in range(10):
        payload = layouts.REQUESTS[type_id].pack({"offset": 0})
        peer.send_payload(type_id, payload, session=peer.session % 255 + 1, seq=number)
        peer.silence(0.03)
    peer.beating = True
    assert peer.fault(0.5)["code"] == 1001, peer.story("GET_SCHEMA feeds the watchdog", "versions")


def test_l14_pages_behind_the_end_of_the_schema_are_empty(peer: Peer) -> None:
    total = peer.ok("GET_SCHEMA", offset=0).total
    for offset in (total, total + 1, 65535):
        page = peer.ok("GET_SCHEMA", offset=offset)
        assert (page.total, page.n) == (total, 0)
    assert peer.ok("GET_SCHEMA", offset=total - 1).n == 1


def test_l14_hello_tells_what_the_host_plans_with(peer: Peer) -> None:
    hello = peer.hello()
    assert hello.servo_hz >= 1
    assert hello.tlm_max_hz >= 100
    assert hello.rx_window >= 1
    assert hello.serial
    assert hello.serial.isprintable()
    assert hello.reset_cause in layouts.enum("ResetCause").values()
    assert hello.state == layouts.enum("State")["IDLE"]
    assert hello.fault == 0


@pytest.mark.parametrize("name", layouts.PARAMETERS)
def test_l16_a_parameter_takes_its_range_and_nothing_beyond(peer: Peer, name: str) -> None:
    p = layouts.PARAMETERS[name]
    assert peer.ok("GET_PARAM", param=p.id).value == p.default
    coarse = name == "servo_period_us"  # a controller may decide on a grid of its own
    for value in (p.least, p.greatest):
        reply = peer.command("SET_PARAM", param=p.id, value=value)
        if coarse and reply.status == STATUS["OUT_OF_RANGE"]:
            continue
        assert reply.status == STATUS["OK"], peer.story(f"{name} = {value}: {reply.status}", "parameters")
        assert peer.ok("GET_PARAM", param=p.id).value == p.default, "staged is not current"
        peer.ok("COMMIT_PROFILE", crc=layouts.profile_crc({name: value}))
        assert peer.ok("GET_PARAM", param=p.id).value == value
        peer.ok("SET_PARAM", param=p.id, value=p.default)
        peer.ok("COMMIT_PROFILE", crc=layouts.profile_crc())
    for value in (p.least - 1, p.greatest + 1, -(2**31), 2**31 - 1):
        reply = peer.refused("SET_PARAM", "OUT_OF_RANGE", param=p.id, value=value)
        assert len(reply.frame.payload) in (0, 17), peer.story("OUT_OF_RANGE", "status-of-a-reply")
    assert peer.ok("COMMIT_PROFILE", crc=layouts.profile_crc()), "a refused value was staged"


@pytest.mark.parametrize("unknown", [0, 7, 9, 58, 255, 65535])
def test_l16_unknown_parameters_are_out_of_range(peer: Peer, unknown: int) -> None:
    peer.refused("SET_PARAM", "OUT_OF_RANGE", param=unknown, value=0)
    peer.refused("GET_PARAM", "OUT_OF_RANGE", param=unknown)


def test_l16_parameters_are_current_only_with_the_right_check(peer: Peer) -> None:
    p = layouts.PARAMETERS["arc_run"]
    peer.ok("SET_PARAM", param=p.id, value=p.default + 1)
    peer.refused("COMMIT_PROFILE", "PROFILE_MISMATCH", crc=layouts.profile_crc())
    assert peer.ok("GET_PARAM", param=p.id).value == p.default
    peer.refused("ARM", "PROFILE_MISMATCH", param_crc=layouts.profile_crc({p.name: p.default + 1}))
    arm(peer)
    peer.refused("SET_PARAM", "BAD_STATE", param=p.id, value=p.default)
    peer.refused("COMMIT_PROFILE", "BAD_STATE", crc=layouts.profile_crc())


@pytest.mark.parametrize(
    ("name", "values", "state"),
    [
        ("PIEZO_SET", {"actuator_v": 120.0025, "slew_v_s": 10.0}, "ARMED"),
        ("PIEZO_SET", {"actuator_v": 10.0, "slew_v_s": 0.0}, "ARMED"),
        ("STAGE_MOVE", {"axis": 3, "speed": 1000}, "ARMED"),
        ("STAGE_MOVE", {"axis": 0, "speed": 0}, "ARMED"),
        ("JUMP", {"height_um": 5.0, "speed_um_s": 0.0}, "ARMED"),
        ("TOUCH_OFF", {"touches": 0, "speed_um_s": 1.0, "fast_um_s": 1.0}, "ARMED"),
        ("TOUCH_OFF", {"touches": 1, "speed_um_s": 0.0, "fast_um_s": 1.0}, "ARMED"),
        ("APPROACH", {"speed_um_s": 0.0, "max_travel_um": 10.0}, "ARMED"),
        ("PULSE_CONFIG", {"on_time_us": 0.0, "off_time_us": 100.0, "open_voltage_v": 40.0}, "IDLE"),
        ("PULSE_CONFIG", {"on_time_us": 100.0, "off_time_us": 100.0, "peak_current_a": 0.1}, "IDLE"),
        ("PULSE_CONFIG", PULSES | {"on_time_us": 6.0, "off_time_us": 13.999}, "IDLE"),
        ("PULSE_CONFIG", PULSES | {"on_time_us": 5.0, "off_time_us": 5.0}, "IDLE"),
        ("PULSE_CONFIG", PULSES | {"on_time_us": 100.0, "off_time_us": 999_900.001}, "IDLE"),
        ("PULSE_CONFIG", PULSES | {"mode": 2}, "IDLE"),
        ("PULSE_CONFIG", PULSES | {"mode": PULSE_MODE["ISOPULSE"]}, "IDLE"),
        ("TLM_START", {"period_us": 10_000, "batch": 5, "pulse_log": 3}, "IDLE"),
        ("TLM_START", {"period_us": 10_000, "batch": 0}, "IDLE"),
        ("TLM_START", {"period_us": 10_000, "batch": 15}, "IDLE"),
    ],
)
def test_l16_values_that_make_no_sense_are_out_of_range(
    peer: Peer, name: str, values: dict[str, Any], state: str
) -> None:
    if state == "ARMED":
        arm(peer)
        peer.ok("PULSE_ENABLE", on=1)
    peer.refused(name, "OUT_OF_RANGE", **values)
    assert peer.state() == state


@pytest.mark.parametrize(
    ("on_us", "off_us"), [(6.667, 13.333), (0.001, 19.999), (10.0, 10.0), (100.0, 999_900.0)]
)
def test_l16_pulse_periods_from_20_us_to_1_s_are_taken(peer: Peer, on_us: float, off_us: float) -> None:
    """The least period is the protocol's, so that a host can check its job before it has a controller."""
    status = peer.command("PULSE_CONFIG", **PULSES | {"on_time_us": on_us, "off_time_us": off_us}).status
    taken = (
        {STATUS["OK"]} if peer.line.bench else {STATUS["OK"], STATUS["OUT_OF_RANGE"]}
    )  # a generator may do less
    assert status in taken, peer.story(f"status {STATUS_NAMES[status]}", "pulses")


def test_l16_isopulse_is_taken_with_a_discharge_time(peer: Peer) -> None:
    peer.ok("PULSE_CONFIG", **PULSES | {"mode": PULSE_MODE["ISOPULSE"], "discharge_us": 50.0})


def bytes_per_s(period_us: int, batch: int, log: str, pulse_period_us: float, block: int) -> float:
    """What TLM_START would send, by docs/protocol.md."""
    rate = 1e6 / period_us * (TLM_ROW + (TLM_HEAD + FRAME_COST) / batch)
    pulses = 1e6 / pulse_period_us
    if log == "BLOCKS":
        rate += pulses / block * (BLOCK_ROW + (BLOCK_HEAD + FRAME_COST) / BLOCKS_PER_FRAME)
    elif log == "FULL":
        rate += pulses * (PULSE_ROW + (PULSE_HEAD + FRAME_COST) / PULSES_PER_FRAME)
    return rate


@pytest.fixture
def slow_line(peer: Peer) -> Iterator[Peer]:
    """A host on a line with a baud that limits telemetry; a line in memory gets one for the time of the test."""
    if peer.line.bench is None:
        yield peer
        return
    controller = peer.line.bench.controller
    before, controller.baud = controller.baud, ASSUMED_BAUD
    yield peer
    controller.baud = before


@pytest.mark.parametrize("log", PULSE_LOG)
@pytest.mark.parametrize(
    ("period_us", "batch"), [(1000, 14), (1000, 1), (2000, 14), (2000, 1), (10_000, 14), (10_000, 1)]
)
def test_l18_a_rate_that_the_line_cannot_carry_is_refused(
    slow_line: Peer, log: str, period_us: int, batch: int
) -> None:
    peer = slow_line
    baud = peer.hello().baud
    block = layouts.PARAMETERS["block_pulses"].default
    share = bytes_per_s(period_us, batch, log, ON_US + OFF_US, block) * RESERVE / max(1, baud / 10)
    status = STATUS_NAMES[
        peer.command("TLM_START", period_us=period_us, batch=batch, pulse_log=PULSE_LOG[log]).status
    ]
    if baud and not 0.97 < share < 1.03:
        expected = "RATE_TOO_HIGH" if share > 1.0 else "OK"
        assert status == expected, peer.story(f"{status} at {share:.0%} of {baud} Bd", "telemetry")


def test_l18_a_rate_above_that_of_hello_is_refused(peer: Peer) -> None:
    period_us = 1e6 / peer.hello().tlm_max_hz
    peer.refused("TLM_START", "RATE_TOO_HIGH", period_us=int(period_us / 2), batch=14)


def test_l18_a_sample_holds_at_most_255_pulses(peer: Peer) -> None:
    values = {"open_voltage_v": OPEN_V, "peak_current_a": 0.1}
    peer.ok("PULSE_CONFIG", on_time_us=10.0, off_time_us=25.0, **values)
    peer.refused("TLM_START", "OUT_OF_RANGE", period_us=10_000, batch=14)


def test_l19_controller_time_is_true_and_only_goes_forward(peer: Peer) -> None:
    start_s, first_us = peer.now_s(), peer.fresh_beat()["t_dev_us"]
    last_us = first_us
    for _ in range(12):
        peer.pump(0.037 if peer.exact else 0.02)
        beat = peer.fresh_beat()
        assert beat["t_dev_us"] >= last_us, peer.story("controller time went back", "time")
        last_us = beat["t_dev_us"]
        passed_s = peer.now_s() - start_s
        if peer.exact:
            assert abs((last_us - first_us) * 1e-6 - passed_s) <= 0.0025, peer.story("clock is off", "time")
    if not peer.exact and peer.line.bench is None:
        assert abs((last_us - first_us) * 1e-6 - passed_s) < 0.05, peer.story("clock is off", "time")


def test_l19_a_heartbeat_comes_back_with_its_time(peer: Peer) -> None:
    peer.send_beat()
    sent_us = int(peer.now_s() * 1e6)
    peer.beat = None
    assert peer.wait(lambda: peer.beat, 0.5)
    assert peer.beat is not None
    assert abs(peer.beat["t_host_us"] - sent_us) < 100_000
