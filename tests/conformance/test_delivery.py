"""L6 to L8 and L13: commands carried out once, whatever the line loses; restarts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from tests.conformance import layouts, wire
from tests.conformance.acts import DUTY_V, OFF_US, ON_US, OPEN_V, arm, assert_pulses_off, lead
from tests.conformance.lines import cut_the_power
from tests.conformance.peer import EVENT, STATE_NAMES, STATUS, Peer, Reply

PARAM = layouts.PARAMETERS["open_lost_s"]
REBOOT_MAGIC = 0x0B007EDB
SCRIPT: list[tuple[str, dict[str, Any]]] = [
    ("SET_PARAM", {"param": PARAM.id, "value": 7000}),
    ("COMMIT_PROFILE", {"crc": layouts.profile_crc({PARAM.name: 7000})}),
    (
        "PULSE_CONFIG",
        {"on_time_us": ON_US, "off_time_us": OFF_US, "open_voltage_v": OPEN_V, "peak_current_a": 0.1},
    ),
    ("ARM", {"param_crc": layouts.profile_crc({PARAM.name: 7000})}),
    ("TLM_START", {"period_us": 10_000, "batch": 5}),
    ("PULSE_ENABLE", {"on": 1}),
    ("SERVO_START", {"gap_ref_v": 0.8 * DUTY_V, "z_limit_um": 100.0, "max_time_s": 60.0}),
    ("SERVO_STOP", {}),
    ("TLM_STOP", {}),
    ("DISARM", {}),
]
EVENTS_OF_SCRIPT = ["STOPPED", "MOVE_DONE"]


def staged_is(peer: Peer, value: int) -> bool:
    """Whether committing PARAM at `value` succeeds, which shows what is staged."""
    crc = layouts.profile_crc({PARAM.name: value})
    return peer.command("COMMIT_PROFILE", crc=crc).status == STATUS["OK"]


def test_l6_a_repeated_command_gets_the_kept_reply_and_has_no_second_effect(peer: Peer) -> None:
    type_id = layouts.NAMES["SET_PARAM"]
    first = peer.send("SET_PARAM", param=PARAM.id, value=5000)
    original = peer.reply_to(type_id, first)
    peer.ok("SET_PARAM", param=PARAM.id, value=6000)
    for _ in range(3):
        peer.send("SET_PARAM", seq=first, param=PARAM.id, value=5000)
        copy = peer.reply_to(type_id, first)
        assert copy == original, peer.story(f"{copy} instead of the kept reply {original}", "delivery")
    assert staged_is(peer, 6000), peer.story("the copy of a SET_PARAM was carried out", "delivery")


def test_l6_a_repeated_command_of_eight_ago_is_still_kept(peer: Peer) -> None:
    type_id = layouts.NAMES["SET_PARAM"]
    first = peer.send("SET_PARAM", param=PARAM.id, value=5000)
    original = peer.reply_to(type_id, first)
    for value in range(6001, 6008):
        peer.ok("SET_PARAM", param=PARAM.id, value=value)
    peer.send("SET_PARAM", seq=first, param=PARAM.id, value=5000)
    assert peer.reply_to(type_id, first) == original, peer.story("the last 8 replies are kept", "delivery")
    assert staged_is(peer, 6007)


def test_l6_arming_twice_with_one_number_is_arming_once(peer: Peer) -> None:
    crc = layouts.profile_crc()
    seq = peer.send("ARM", param_crc=crc)
    replies = []
    for _ in range(2):
        replies.append(peer.reply_to(layouts.NAMES["ARM"], seq))
        peer.send("ARM", seq=seq, param_crc=crc)
    assert replies[0] == replies[1]
    assert replies[0] is not None
    assert replies[0].status == STATUS["OK"]
    peer.refused("ARM", "BAD_STATE", param_crc=crc)


def test_l6_replies_come_within_20_ms(peer: Peer) -> None:
    round_trips_s = []
    for _ in range(31):
        start_s = peer.now_s()
        peer.ok("GET_STATUS")
        round_trips_s.append(peer.now_s() - start_s)
    median_s = sorted(round_trips_s)[15]
    assert median_s <= 0.02, peer.story(f"the median reply took {1000 * median_s:.1f} ms", "time")


def persistent(peer: Peer, name: str, values: dict[str, Any]) -> Reply:
    """Send a command as the host does: again with the same seq until a reply comes."""
    seq = peer.seq
    peer.seq = (seq + 1) % 256
    for _ in range(8):
        peer.send(name, seq=seq, **values)
        reply = peer.reply_to(layouts.NAMES[name], seq, 0.05)
        if reply is not None:
            return reply
    raise AssertionError(peer.story(f"{name} was not answered in 8 tries", "delivery"))


def first_of(type_id: int, direction: str) -> Callable[[str, wire.Frame | None], bool]:
    """A line that loses the next frame of a type."""
    lost: list[wire.Frame] = []

    def loses(way: str, frame: wire.Frame | None) -> bool:
        if lost or way != direction or frame is None or frame.type_id != type_id:
            return False
        lost.append(frame)
        return True

    return loses


@pytest.mark.parametrize("direction", ["out", "in"], ids=["command", "reply"])
def test_l7_a_loss_at_any_place_leaves_exactly_one_effect(peer: Peer, direction: str) -> None:
    for place in range(len(SCRIPT)):
        peer.hello()
        for number, (name, values) in enumerate(SCRIPT):
            if number == place:
                type_id = layouts.NAMES[name] | (wire.REPLY if direction == "in" else 0)
                peer.loses = first_of(type_id, direction)
            reply = persistent(peer, name, values)
            lost = f"with {SCRIPT[place][0]} lost, {direction}, {name}"
            assert reply.status == STATUS["OK"], peer.story(f"{lost}: status {reply.status}", "delivery")
        peer.wait(lambda: any(e["code"] == EVENT["MOVE_DONE"] for e in peer.events), 5.0)
        peer.pump(0.02)
        codes = [e["code"] for e in peer.events]
        expected = [EVENT[name] for name in EVENTS_OF_SCRIPT]
        assert codes == expected, peer.story(f"with {SCRIPT[place][0]} lost, {direction}", "delivery")
        assert peer.state() == "IDLE"


def test_l8_the_sequence_number_wraps(peer: Peer) -> None:
    peer.seq = 200
    peer.hello()
    for count in range(330):
        reply = peer.ok("GET_PARAM", param=PARAM.id)
        assert reply.value == PARAM.default, peer.story(f"command {count}", "delivery")
    assert not peer.frames, peer.story("a command was answered twice", "delivery")


@pytest.mark.parametrize("first_seq", [3, 250])
def test_l8_a_late_copy_is_not_carried_out(peer: Peer, first_seq: int) -> None:
    peer.seq = first_seq - 1
    peer.hello()
    type_id = layouts.NAMES["SET_PARAM"]
    late = {"seq": first_seq, "param": PARAM.id, "value": 5000}
    peer.ok("SET_PARAM", param=PARAM.id, value=5000)
    for value in range(6001, 6011):
        peer.ok("SET_PARAM", param=PARAM.id, value=value)
    for _ in range(20):
        peer.ok("GET_PARAM", param=PARAM.id)
    before = peer.fresh_beat()["rx_drop"]
    peer.send("SET_PARAM", **late)
    assert peer.reply_to(type_id, first_seq, 0.06) is None, peer.story("a late copy was answered", "delivery")
    assert (peer.fresh_beat()["rx_drop"] - before) % 65536 == 1, "a late copy is counted in rx_drop"
    assert staged_is(peer, 6010), peer.story("a late copy of a SET_PARAM was carried out", "delivery")


def test_l13_reboot_is_answered_and_told(peer: Peer) -> None:
    hello = peer.hello()
    peer.refused("REBOOT", "OUT_OF_RANGE", magic=REBOOT_MAGIC + 1)
    peer.ok("REBOOT", magic=REBOOT_MAGIC)
    assert peer.wait(lambda: peer.boots, 5.0), peer.story("no BOOT within 5 s of REBOOT", "session")
    boot = peer.boots[0]
    assert boot["reset_cause"] == layouts.enum("ResetCause")["COMMANDED"]
    assert boot["boot_count"] == hello.boot_count + 1
    peer.driven = False
    seq = peer.send("GET_STATUS")
    assert peer.reply_to(layouts.NAMES["GET_STATUS"], seq, 0.1) is None, peer.story(
        "after a reset there is no session", "session"
    )
    again = peer.hello()
    assert (again.boot_count, again.reset_cause) == (boot["boot_count"], boot["reset_cause"])
    assert peer.state() == "IDLE"


def test_l13_commands_behind_a_reboot_are_lost(peer: Peer) -> None:
    """In one piece with it too: no spark comes of them."""
    commands = (
        ("REBOOT", {"magic": REBOOT_MAGIC}),
        ("ARM", {"param_crc": layouts.profile_crc()}),
        ("PULSE_ENABLE", {"on": 1}),
        ("SERVO_START", {"gap_ref_v": 0.8 * DUTY_V, "z_limit_um": 100.0, "max_time_s": 60.0}),
    )
    frames = b""
    for name, values in commands:
        number = layouts.NAMES[name]
        frames += wire.encode(number, peer.seq, peer.session, layouts.REQUESTS[number].pack(values))
        peer.seq = (peer.seq + 1) % 256
    peer.frames.clear()
    peer.write(frames)
    assert peer.wait(lambda: peer.boots, 5.0), peer.story("no BOOT within 5 s of REBOOT", "session")
    asked = {layouts.NAMES[name] | wire.REPLY for name, _ in commands}
    replies = {frame.type_id for frame in peer.frames} & asked
    assert replies == {layouts.NAMES["REBOOT"] | wire.REPLY}, peer.story("a command behind REBOOT", "session")
    assert len(peer.boots) == 1
    peer.hello()
    assert peer.state() == "IDLE"


def test_l13_an_armed_controller_does_not_reboot_on_command(peer: Peer) -> None:
    arm(peer)
    peer.refused("REBOOT", "BAD_STATE", magic=REBOOT_MAGIC)
    assert peer.state() == "ARMED"


def test_l13_a_latched_fault_survives_the_reboot(peer: Peer) -> None:
    lead(peer, "fault")
    code = peer.faults[0]["code"]
    peer.wait(lambda: peer.fresh_beat()["fault"] == code, 1.0)
    peer.pump(0.5)  # the retreat
    peer.ok("REBOOT", magic=REBOOT_MAGIC)
    assert peer.wait(lambda: peer.boots, 5.0)
    again = peer.hello()
    assert again.fault == code, peer.story(f"fault {again.fault} after the reboot, {code} before", "session")
    assert peer.state() == "FAULT"


def test_l13_after_a_loss_of_power_the_actuator_is_at_0_v(over_work: Peer) -> None:
    peer = over_work
    lead(peer, "ramp")
    peer.pump(0.3)
    assert peer.ok("GET_STATUS").actuator_v > 1.0
    cut_the_power(peer.line.bench)
    assert peer.wait(lambda: peer.boots, 3.0), peer.story("no BOOT after a loss of power", "session")
    peer.hello()
    status = peer.ok("GET_STATUS")
    assert (STATE_NAMES[status.state], status.actuator_v) == ("IDLE", 0.0), peer.story(
        "after POWER_ON the actuator is at 0 V at once", "session"
    )


def test_l13_a_reset_in_mid_command_is_told_by_boot(over_work: Peer, inject: Callable[[str], None]) -> None:
    peer = over_work
    lead(peer, "ramp")
    inject("WATCHDOG@0.02")
    peer.wait(lambda: peer.boots, 3.0)
    assert peer.boots, peer.story("no BOOT after a reset", "session")
    hello = peer.hello()
    assert hello.fault == 5001, peer.story("a watchdog reset boots with fault 5001 latched", "faults")
    assert_pulses_off(peer)
