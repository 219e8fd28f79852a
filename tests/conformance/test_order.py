"""L30, L31: how long a permission for pulses lasts, and what comes first of what happens at one time."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tests.conformance import layouts, wire
from tests.conformance.acts import (
    DUTY_V,
    arm,
    assert_pulses_off,
    clear,
    disarm,
    lead,
    line_to,
    scan_start,
    servo_start,
)
from tests.conformance.lines import cut_the_power, press_reset
from tests.conformance.peer import EVENT, STATE, STATE_NAMES, Peer, loses_nothing
from tests.conformance.test_delivery import REBOOT_MAGIC

TLM = layouts.ANSWERS[layouts.NAMES["TLM"]]


def _time_up(peer: Peer) -> None:
    servo_start(peer, max_time_s=0.05)
    peer.event("TIME_UP", 1.0)


def _cut_done(peer: Peer) -> None:
    servo_start(peer, z_limit_um=-100.0)
    peer.event("CUT_DONE", 1.0)


def _path_done(peer: Peer) -> None:
    scan_start(peer)
    status = peer.ok("GET_STATUS")
    peer.ok("PATH_MOVE", **line_to(status.x_um, status.y_um, last=1))
    peer.event("PATH_DONE", 1.0)


def _approach_done(peer: Peer) -> None:
    peer.ok("APPROACH", speed_um_s=1.0, max_travel_um=100.0, gap_ref_v=DUTY_V + 1.0)
    peer.event("APPROACH_DONE", 1.0)


def _test_done(peer: Peer) -> None:
    if peer.line.bench is None:
        pytest.skip("a self-test needs the high voltage, which is off on a board")
    peer.ok("SELF_TEST")
    peer.event("TEST_DONE", 2.0)


def _stopped(peer: Peer) -> None:
    servo_start(peer)
    peer.ok("SERVO_STOP")
    peer.event("STOPPED", 1.0)


def _moved(peer: Peer) -> None:
    peer.ok("PIEZO_SET", actuator_v=1.0, slew_v_s=300.0)
    peer.event("MOVE_DONE", 1.0)


KEEP_IT: dict[str, Callable[[Peer], None]] = {
    "TIME_UP": _time_up,
    "CUT_DONE": _cut_done,
    "PATH_DONE": _path_done,
    "APPROACH_DONE": _approach_done,
    "TEST_DONE": _test_done,
    "SERVO_STOP": _stopped,
    "MOVE_DONE": _moved,
}


@pytest.mark.parametrize("end", KEEP_IT)
def test_l30_the_end_of_a_cut_ends_its_pulses_and_not_the_permission(peer: Peer, end: str) -> None:
    arm(peer)
    peer.ok("PULSE_ENABLE", on=1)
    KEEP_IT[end](peer)
    assert peer.state() == "ARMED"
    assert_pulses_off(peer)
    servo_start(peer)
    assert peer.state() == "MACHINING", peer.story(f"the permission ended with {end}", "permission")


def _forbidden(peer: Peer) -> None:
    peer.ok("PULSE_ENABLE", on=0)


def _forbidden_in_a_cut(peer: Peer) -> None:
    servo_start(peer)
    peer.ok("PULSE_ENABLE", on=0)
    peer.event("STOPPED", 1.0)


def _disarmed(peer: Peer) -> None:
    disarm(peer)
    arm(peer)


def _after_a_fault(peer: Peer) -> None:
    peer.write(wire.ABORT)
    peer.fault(0.5)
    peer.pump(0.02)
    clear(peer)
    arm(peer)


def _after_a_new_session(peer: Peer) -> None:
    peer.hello()
    clear(peer)
    arm(peer)


def _after_a_reset(peer: Peer) -> None:
    if peer.line.bench is None:
        disarm(peer)
        peer.ok("REBOOT", magic=REBOOT_MAGIC)
    else:
        cut_the_power(peer.line.bench)
    assert peer.wait(lambda: peer.boots, 5.0)
    peer.hello()
    arm(peer)


END_IT: dict[str, Callable[[Peer], None]] = {
    "PULSE_ENABLE": _forbidden,
    "PULSE_ENABLE in a cut": _forbidden_in_a_cut,
    "DISARM": _disarmed,
    "fault": _after_a_fault,
    "session": _after_a_new_session,
    "reset": _after_a_reset,
}


@pytest.mark.parametrize("end", END_IT)
def test_l30_what_ends_the_permission(peer: Peer, end: str) -> None:
    arm(peer)
    peer.ok("PULSE_ENABLE", on=1)
    END_IT[end](peer)
    values = {"gap_ref_v": 0.8 * DUTY_V, "z_limit_um": 5.0, "max_time_s": 1.0}
    for name in ("SERVO_START", "SCAN_START"):
        peer.refused(name, "BAD_STATE", **values)
    peer.refused("APPROACH", "BAD_STATE", speed_um_s=1.0, max_travel_um=10.0, gap_ref_v=0.9 * DUTY_V)
    assert peer.state() == "ARMED"


@pytest.mark.parametrize("way", ["idle", "ramp", "machining", "fault"])
def test_l30_pulses_are_permitted_in_armed_alone(peer: Peer, way: str) -> None:
    lead(peer, way)
    peer.refused("PULSE_ENABLE", "BAD_STATE", on=1)


def order_of(peer: Peer, act: Callable[[], object]) -> list[int]:
    """Types of the frames of the session that come while `act` runs, in their order."""
    seen: list[int] = []

    def looks(direction: str, frame: wire.Frame | None) -> bool:
        if direction == "in" and frame is not None and frame.session == peer.session:
            seen.append(frame.type_id)
        return False

    peer.loses = looks
    act()
    peer.pump(0.02)
    peer.loses = loses_nothing
    return seen


def test_l31_what_a_command_brings_about_is_told_before_its_reply(peer: Peer) -> None:
    arm(peer)
    peer.ok("TLM_START", period_us=1000, batch=14)
    peer.pump(0.005)
    seen = order_of(peer, lambda: peer.ok("SERVO_STOP"))
    wanted = [layouts.NAMES["TLM"], layouts.NAMES["EVENT"], layouts.NAMES["SERVO_STOP"] | wire.REPLY]
    kinds = [kind for kind in seen if kind in wanted]
    while not peer.exact and kinds[:2] == 2 * wanted[:1]:
        del kinds[0]  # full before the command came: this line has a clock of its own
    assert kinds[:3] == wanted, peer.story(f"came: {seen}", "events")


def test_l31_the_fault_of_a_new_session_is_told_before_the_reply_to_hello(peer: Peer) -> None:
    lead(peer, "machining")
    seen = order_of(peer, peer.hello)
    wanted = [layouts.NAMES["FAULT"], layouts.NAMES["HELLO"] | wire.REPLY]
    assert [kind for kind in seen if kind in wanted] == wanted, peer.story(f"came: {seen}", "events")


def test_l31_boot_comes_after_the_reply_to_reboot(peer: Peer) -> None:
    seen: list[int] = []

    def looks(direction: str, frame: wire.Frame | None) -> bool:
        if direction == "in" and frame is not None:
            seen.append(frame.type_id)
        return False

    peer.loses = looks
    peer.ok("REBOOT", magic=REBOOT_MAGIC)
    assert peer.wait(lambda: peer.boots, 5.0)
    peer.loses = loses_nothing
    wanted = [layouts.NAMES["REBOOT"] | wire.REPLY, layouts.NAMES["BOOT"]]
    assert [kind for kind in seen if kind in wanted] == wanted, peer.story(f"came: {seen}", "session")


def test_l31_a_ramp_begins_with_the_next_millisecond_and_its_event_is_of_the_last_one(peer: Peer) -> None:
    if not peer.exact:
        pytest.skip("asked to the millisecond")
    arm(peer)
    peer.ok("TLM_START", period_us=1000, batch=1)
    peer.pump(0.01)
    start_us = peer.ok_at("PIEZO_SET", actuator_v=1.25, slew_v_s=125.0)
    end = peer.event("MOVE_DONE", 1.0)
    peer.pump(0.005)
    rows = {
        (frame["t0_us"] - start_us) % 2**32 // 1000: TLM.read_record(frame["records"][0])
        for frame in peer.telemetry
    }
    volts = [rows[ms]["actuator_v"] for ms in range(1, 13)]
    assert volts == pytest.approx([0.125 * min(ms, 10) for ms in range(1, 13)], abs=0.0013), peer.story(
        f"a ramp of {volts}", "the-millisecond"
    )
    assert (end["t_us"] - start_us) % 2**32 == 10_000, peer.story(
        "the end has another time", "the-millisecond"
    )
    states = [STATE_NAMES[rows[ms]["state"]] for ms in range(1, 12)]
    assert states == ["MOVING"] * 10 + ["ARMED"], peer.story(f"states {states}", "the-millisecond")


def test_l31_a_ramp_to_where_the_actuator_is_takes_a_millisecond(peer: Peer) -> None:
    arm(peer)
    start_us = peer.ok_at("PIEZO_SET", actuator_v=0.0, slew_v_s=100.0)
    end = peer.event("MOVE_DONE", 1.0)
    if peer.exact:
        assert (end["t_us"] - start_us) % 2**32 == 1000


def test_l31_the_last_sample_of_a_cut_has_its_state_and_no_pulses_on(over_work: Peer) -> None:
    peer = over_work
    arm(peer)
    peer.ok("PULSE_ENABLE", on=1)
    peer.ok("TLM_START", period_us=1000, batch=1)
    start_us = peer.ok_at("SERVO_START", gap_ref_v=0.8 * DUTY_V, z_limit_um=100.0, max_time_s=0.05)
    end = peer.event("TIME_UP", 1.0)
    peer.pump(0.005)
    rows = {frame["t0_us"]: TLM.read_record(frame["records"][0]) for frame in peer.telemetry}
    pulses_on = layouts.enum("TlmFlags")["PULSES_ON"]
    last, after = rows[end["t_us"]], rows[(end["t_us"] + 1000) % 2**32]
    assert (end["t_us"] - start_us) % 2**32 == pytest.approx(50_000, abs=0 if peer.exact else 10_000)
    assert (last["state"], last["flags"] & pulses_on) == (STATE["MACHINING"], 0)
    assert last["n_open"] > 0, peer.story("no pulses in the last millisecond", "the-millisecond")
    assert (after["state"], after["n_open"]) == (STATE["ARMED"], 0)


def test_l31_a_controller_whose_tool_is_out_boots_and_takes_no_orders(over_work: Peer) -> None:
    peer = over_work
    arm(peer)
    peer.ok("PIEZO_SET", actuator_v=60.0, slew_v_s=600.0)
    peer.event("MOVE_DONE", 5.0)
    press_reset(peer.line.bench)
    assert peer.wait(lambda: peer.boots, 1.0), peer.story("no BOOT", "session")
    hello = peer.hello()
    status = peer.ok("GET_STATUS")
    told = STATE_NAMES[hello.state], STATE_NAMES[status.state], status.fault
    assert told == ("BOOT", "BOOT", 0), peer.story(f"told: {told}", "states")
    assert 0.0 < status.actuator_v <= 60.0
    for name in ("ARM", "SET_PARAM", "COMMIT_PROFILE", "PULSE_CONFIG", "DISARM", "PIEZO_SET", "CLEAR_FAULT"):
        peer.refused(name, "BAD_STATE")
    peer.refused("PULSE_ENABLE", "BAD_STATE", on=1)
    assert peer.wait(lambda: peer.state() == "IDLE", 1.0), peer.story("BOOT does not end", "states")
    peer.pump(0.02)
    assert peer.ok("GET_STATUS").actuator_v == 0.0
    assert not peer.events, peer.story("the end of BOOT is no event", "states")
    assert EVENT["MOVE_DONE"] not in [event["code"] for event in peer.events]
