"""L9 to L11 and L20 to L22: abort run, watchdog, faults, E-stop."""

from __future__ import annotations

from collections.abc import Callable
from random import Random

import pytest

from tests.conformance import layouts, wire
from tests.conformance.acts import (
    ARMED_STATES,
    EVERY_STATE,
    arm,
    assert_pulses_off,
    clear,
    lead,
    start_sparks,
)
from tests.conformance.peer import EVENT, STATUS, Peer, loses_nothing

HOST_SILENT, ABORT_RUN, ESTOP, GEN_FAULT, MODE_SWITCH = 1001, 1002, 4001, 3004, 3006
ESTOP_BIT = layouts.enum("Interlocks")["ESTOP"]
ABORT_US = 5000
WATCHDOG_S = 0.25


def assert_made_safe(peer: Peer) -> None:
    """Pulses off now, the actuator at 0 V once it has had the time."""
    assert_pulses_off(peer)
    assert peer.wait(lambda: peer.ok("GET_STATUS").actuator_v == 0.0, 3.0), peer.story(
        "the actuator is not back at 0 V", "safe-state-and-watchdog"
    )


def assert_abort_within_limit(peer: Peer, before_us: int) -> None:
    fault = peer.fault(0.5)
    assert fault["code"] == ABORT_RUN, peer.story(f"fault {fault['code']} after an abort run", "abort-run")
    if peer.exact:
        late_us = (fault["t_us"] - before_us) % 2**32
        assert late_us <= ABORT_US, peer.story(f"abort took {late_us} us", "abort-run")


@pytest.mark.parametrize("way", EVERY_STATE)
def test_l9_an_abort_run_stops_every_state(peer: Peer, way: str) -> None:
    lead(peer, way)
    before_us = peer.fresh_beat()["t_dev_us"]
    latched = len(peer.faults)
    peer.write(wire.ABORT)
    if latched:
        peer.pump(0.02)
        assert len(peer.faults) == latched, peer.story("the first fault stays the latched one", "faults")
    else:
        assert_abort_within_limit(peer, before_us)
    assert_made_safe(peer)
    assert peer.state() == "FAULT"


def test_l9_an_abort_run_is_seen_at_any_place_inside_a_frame(peer: Peer) -> None:
    whole = layouts.golden_frame("TOUCH_OFF")
    for cut in range(1, len(whole), 1 if peer.exact else 7):
        before_us = peer.fresh_beat()["t_dev_us"]
        peer.write(whole[:cut] + bytes(wire.ABORT_ZEROS))
        assert_abort_within_limit(peer, before_us)
        peer.write(b"\x07")
        clear(peer)


def test_l9_seven_zeros_are_no_abort_and_a_run_may_come_in_pieces(peer: Peer) -> None:
    for _ in range(5):
        peer.write(b"\x01" + bytes(7) + b"\x01")
    peer.pump(0.02)
    assert peer.state() == "IDLE", peer.story("seven zeros are no abort", "abort-run")
    peer.write(b"\x01")
    for _ in range(8):
        peer.write(b"\0")
    assert peer.fault(0.5)["code"] == ABORT_RUN
    peer.write(bytes(40))  # the same run goes on
    peer.pump(0.02)
    clear(peer)
    peer.write(b"\x01" + bytes(7) + b"\x01")
    peer.pump(0.02)
    assert peer.state() == "IDLE", peer.story("zeros of an old run do not count again", "abort-run")


@pytest.mark.parametrize("way", ARMED_STATES)
def test_l10_silence_trips_the_watchdog_in_every_armed_state(peer: Peer, way: str) -> None:
    lead(peer, way)
    peer.fresh_beat()
    peer.silence(WATCHDOG_S - peer.grain_s)
    peer.fresh_beat()
    peer.pump(0.005)
    assert not peer.faults, peer.story(f"fault within {WATCHDOG_S} s of a frame", "safe-state-and-watchdog")
    at_us = peer.fresh_beat()["t_dev_us"]
    peer.silence(WATCHDOG_S + peer.grain_s)
    fault = peer.fault(0.5)
    assert fault["code"] == HOST_SILENT
    if peer.exact:
        assert 249_000 <= (fault["t_us"] - at_us) % 2**32 <= 251_000
    assert_made_safe(peer)


def test_l10_the_watchdog_does_not_run_while_nothing_is_armed(peer: Peer) -> None:
    peer.silence(0.6)
    peer.fresh_beat()
    assert not peer.faults, peer.story("the watchdog runs in IDLE", "safe-state-and-watchdog")


def test_l10_the_watchdog_time_is_a_parameter(peer: Peer) -> None:
    p = layouts.PARAMETERS["watchdog_s"]
    peer.ok("SET_PARAM", param=p.id, value=p.greatest)
    crc = layouts.profile_crc({p.name: p.greatest})
    peer.ok("COMMIT_PROFILE", crc=crc)
    arm(peer, crc)
    peer.fresh_beat()
    peer.silence(0.9)
    peer.fresh_beat()
    assert not peer.faults
    peer.silence(1.1)
    assert peer.fault(0.5)["code"] == HOST_SILENT


def test_l11_only_valid_frames_of_the_session_feed_the_watchdog(peer: Peer) -> None:
    """A host whose main loop hangs is silent; noise and other hosts must not pass for it."""
    arm(peer)
    peer.fresh_beat()
    peer.beating = False
    noise = Random(11)
    other = peer.session % 255 + 1
    beat = layouts.REQUESTS[layouts.NAMES["HEARTBEAT"]].pack({})
    for number in range(10):
        peer.send_payload(layouts.NAMES["HEARTBEAT"], beat, seq=number, session=other)
        peer.send_payload(layouts.NAMES["TLM"], bytes(26), seq=0)  # its own, by an echoing line
        if number < 5:  # fewer than bad_frames, which would be a fault of its own
            peer.write(b"\0" + noise.randbytes(20).replace(b"\0", b"\1") + b"\0")
        peer.silence(0.03)
    peer.beating = True
    assert peer.fault(0.5)["code"] == HOST_SILENT, peer.story("not the watchdog", "safe-state-and-watchdog")


def test_l11_commands_feed_the_watchdog_as_heartbeats_do(peer: Peer) -> None:
    arm(peer)
    peer.beating = False
    for _ in range(8):
        peer.ok("GET_PARAM", param=1)
        peer.silence(0.1)
    peer.beating = True
    peer.fresh_beat()
    assert not peer.faults, peer.story("a new command feeds the watchdog", "safe-state-and-watchdog")


def beat_at(peer: Peer, t_host_us: int) -> bytes:
    """A HEARTBEAT of the session with any time of the host."""
    number = layouts.NAMES["HEARTBEAT"]
    payload = layouts.REQUESTS[number].pack({"t_host_us": t_host_us, "last_event": peer.last_event})
    return wire.encode(number, 0, peer.session, payload)


def writes_again_and_again(peer: Peer, frame: bytes) -> None:
    """Send one frame as often as heartbeats are due, from a host that sends nothing else, for 0.4 s."""
    peer.beating = False
    for _ in range(8):
        peer.write(frame)
        peer.silence(0.05)
    peer.beating = True


@pytest.mark.parametrize("way", ["armed", "machining"])
def test_l11_a_repeated_heartbeat_is_answered_and_keeps_nothing_alive(peer: Peer, way: str) -> None:
    lead(peer, way)
    newest = peer.fresh_beat()
    at_us = newest["t_dev_us"]
    writes_again_and_again(peer, beat_at(peer, newest["t_host_us"] + 10))
    fault = peer.fault(0.5)
    assert fault["code"] == HOST_SILENT, peer.story("not the watchdog", "safe-state-and-watchdog")
    late_s = 1e-6 * ((fault["t_us"] - at_us) % 2**32)
    assert late_s <= WATCHDOG_S + 2 * peer.grain_s, peer.story(
        f"a repeated HEARTBEAT held the fault off for {late_s:.3f} s", "safe-state-and-watchdog"
    )
    assert peer.beat is not None
    assert peer.beat["t_dev_us"] > at_us, peer.story("a repeated HEARTBEAT was not answered", "delivery")
    assert_made_safe(peer)


def test_l11_heartbeats_that_were_overtaken_keep_nothing_alive(peer: Peer) -> None:
    """The newest came first; those before it trickle in afterwards, each of them once."""
    arm(peer)
    newest_us = peer.fresh_beat()["t_host_us"]
    peer.beating = False
    for number in (9, 8, 7, 6, 5, 4, 3, 2, 1):
        peer.write(beat_at(peer, newest_us + 1000 * number))
        peer.silence(0.05)
    peer.beating = True
    assert peer.fault(0.5)["code"] == HOST_SILENT


def test_l11_a_heartbeat_that_is_newer_by_a_microsecond_counts(peer: Peer) -> None:
    """Copies between them do no harm, and their seq does not matter."""
    arm(peer)
    newest_us = peer.fresh_beat()["t_host_us"] + 2**32
    peer.beating = False
    for number in range(1, 13):
        peer.write(beat_at(peer, newest_us))
        peer.write(beat_at(peer, newest_us + number))
        peer.silence(0.1)
        assert not peer.faults, peer.story("a newer HEARTBEAT feeds the watchdog", "safe-state-and-watchdog")
    peer.beating = True


def test_l11_a_repeated_command_keeps_nothing_alive(peer: Peer) -> None:
    """The kept reply goes out each time. A host that lives sends heartbeats while it repeats."""
    arm(peer)
    number, seq = layouts.NAMES["GET_PARAM"], peer.seq
    peer.seq = (seq + 1) % 256
    frame = wire.encode(number, seq, peer.session, layouts.REQUESTS[number].pack({"param": 1}))
    peer.fresh_beat()
    for _ in range(8):
        peer.write(frame)
        peer.pump(0.05)
    assert not peer.faults, peer.story("repetitions did harm", "delivery")
    peer.fresh_beat()
    peer.frames.clear()
    writes_again_and_again(peer, frame)
    assert peer.fault(0.5)["code"] == HOST_SILENT
    answered = [f for f in peer.frames if (f.type_id, f.seq) == (number | wire.REPLY, seq)]
    assert len(answered) == 8, peer.story("a kept reply was not sent again", "delivery")


def test_l11_a_new_session_begins_with_any_host_time(peer: Peer) -> None:
    """Hosts have clocks of their own: the second one's may be behind the first one's."""
    peer.write(beat_at(peer, 10**15))
    peer.pump(0.02)
    peer.hello()
    arm(peer)
    peer.pump(0.6)
    assert not peer.faults, peer.story("heartbeats of a new session count from its own first", "session")


def a_fifth(seed: int) -> Callable[[str, wire.Frame | None], bool]:
    """A line that loses 20 % of the frames in either direction."""
    chance = Random(seed)
    return lambda direction, frame: chance.random() < 0.2


def test_l20_a_fault_arrives_over_a_line_that_loses_a_fifth(peer: Peer) -> None:
    for seed in range(10 if peer.exact else 2):
        peer.loses = a_fifth(seed)
        peer.forget()
        for _ in range(40):
            peer.write(wire.ABORT)
            if peer.wait(lambda: peer.faults, 1.5):
                break
        peer.loses = loses_nothing
        assert [f["code"] for f in peer.faults] == [ABORT_RUN], peer.story(
            "FAULT did not arrive once", "events"
        )
        clear(peer)


def test_l20_events_are_repeated_until_acknowledged_and_then_no_more(peer: Peer) -> None:
    event_type = layouts.NAMES["EVENT"]
    seen: list[bytes] = []

    def hides(direction: str, frame: wire.Frame | None) -> bool:
        is_event = frame is not None and frame.type_id == event_type
        if frame is not None and is_event:
            seen.append(frame.payload)
        return is_event

    peer.loses = hides
    arm(peer)
    peer.ok("SERVO_STOP")
    peer.pump(0.55)
    assert len(seen) >= 4, peer.story(f"EVENT came {len(seen)} times in 0.55 s", "events")
    assert len(set(seen)) == 1, "a repetition is the same frame"
    peer.loses = loses_nothing
    assert peer.event_of("STOPPED", 0.3)
    peer.pump(0.2)
    seen.clear()
    peer.loses = hides
    peer.pump(0.4)
    assert not seen, peer.story("an acknowledged EVENT was repeated", "events")
    assert [e["code"] for e in peer.events] == [EVENT["STOPPED"]]


@pytest.mark.parametrize("way", ["armed", "ramp", "stage", "touch", "jump"])
def test_l9_a_generator_that_does_not_switch_off_is_found_while_pulses_are_off(
    peer: Peer, inject: Callable[[str], None], way: str
) -> None:
    lead(peer, way)
    peer.pump(0.05)
    assert not peer.faults
    before_us = peer.fresh_beat()["t_dev_us"]
    inject("MODE_SWITCH@0")
    fault = peer.fault(0.5)
    assert fault["code"] == (MODE_SWITCH if way == "touch" else GEN_FAULT), peer.story("gate stuck", "pulses")
    if peer.exact:
        assert fault["t_us"] - before_us <= 5000
    assert_made_safe(peer)


@pytest.mark.parametrize("way", ARMED_STATES)
def test_l21_the_emergency_stop_ends_every_state(peer: Peer, inject: Callable[[str], None], way: str) -> None:
    lead(peer, way)
    inject("ESTOP@0")
    fault = peer.fault(0.5)
    assert fault["code"] == ESTOP
    assert peer.state() == "ESTOP", peer.story("the emergency stop has a state of its own", "states")
    assert_made_safe(peer)


def test_l21_the_emergency_stop_dominates(peer: Peer, inject: Callable[[str], None]) -> None:
    arm(peer)
    inject("ESTOP@0")
    peer.fault(0.5)
    peer.pump(0.6)
    for name, values in (
        ("ARM", {"param_crc": layouts.profile_crc()}),
        ("PIEZO_SET", {"actuator_v": 1.0, "slew_v_s": 10.0}),
        ("PULSE_ENABLE", {"on": 1}),
        ("SERVO_START", {}),
    ):
        peer.refused(name, "BAD_STATE", **values)
    refused = peer.refused("CLEAR_FAULT", "INTERLOCK", fault=ESTOP)
    bits = int.from_bytes(refused.frame.payload, "little")
    assert not refused.frame.payload or bits & ESTOP_BIT
    assert peer.ok("GET_STATUS").interlocks & ESTOP_BIT
    assert peer.state() == "ESTOP"
    peer.line.bench.clear_injections()
    assert peer.state() == "ESTOP", peer.story("a closed input alone clears nothing", "states")
    peer.ok("CLEAR_FAULT", fault=ESTOP)
    assert peer.state() == "IDLE"


def test_l21_nothing_arms_while_the_emergency_stop_is_pressed(
    peer: Peer, inject: Callable[[str], None]
) -> None:
    inject("ESTOP@0")
    peer.pump(0.01)
    if peer.state() == "IDLE":
        refused = peer.refused("ARM", "INTERLOCK", param_crc=layouts.profile_crc())
        bits = int.from_bytes(refused.frame.payload, "little")
        assert not refused.frame.payload or bits & ESTOP_BIT
    else:
        peer.refused("ARM", "BAD_STATE", param_crc=layouts.profile_crc())


def test_l22_only_the_latched_code_clears(peer: Peer) -> None:
    lead(peer, "ramp")
    peer.pump(1.0)
    peer.write(wire.ABORT)
    peer.fault(0.5)
    peer.pump(0.6)  # the retreat
    for wrong in (0, HOST_SILENT, ESTOP, ABORT_RUN + 256, 0xFFFF):
        peer.refused("CLEAR_FAULT", "OUT_OF_RANGE", fault=wrong)
        assert peer.state() == "FAULT"
    for name, values in (("ARM", {"param_crc": layouts.profile_crc()}), ("DISARM", {}), ("SERVO_STOP", {})):
        assert peer.command(name, **values).status == STATUS["BAD_STATE"]
    peer.ok("CLEAR_FAULT", fault=ABORT_RUN)
    assert peer.state() == "IDLE"
    peer.refused("CLEAR_FAULT", "BAD_STATE", fault=ABORT_RUN)


@pytest.mark.parametrize("cause", ["abort", "silence"])
def test_l9_the_pulses_of_a_cut_end_with_the_fault_and_the_tool_retracts(over_work: Peer, cause: str) -> None:
    peer = over_work
    start_sparks(peer)
    peer.ok("TLM_START", period_us=1000, batch=1)
    peer.pump(0.2)
    before = peer.fresh_beat()["t_dev_us"]
    if cause == "abort":
        peer.write(wire.ABORT)
    else:
        peer.silence(0.3)
    fault = peer.fault(0.5)
    peer.pump(0.2)
    rows = [
        (frame["t0_us"], layouts.ANSWERS[layouts.NAMES["TLM"]].read_record(record))
        for frame in peer.telemetry
        for record in frame["records"]
    ]
    on = [t_us for t_us, row in rows if row["flags"] & layouts.enum("TlmFlags")["PULSES_ON"]]
    assert max(on) >= before, peer.story("no pulses before the fault", "telemetry")
    # The sample of the millisecond in which the fault came may still hold its pulses.
    assert max(on) <= fault["t_us"] + 1000, peer.story("pulses after the fault", "safe-state-and-watchdog")
    late = [row for t_us, row in rows if t_us > fault["t_us"] + 1000]
    assert not any(row["n_normal"] + row["n_arc"] + row["n_short"] + row["n_open"] for row in late)
    volts = [row["actuator_v"] for row in late]
    assert volts == sorted(volts, reverse=True), peer.story(
        "the retreat is no ramp", "safe-state-and-watchdog"
    )
    assert volts[-1] == 0.0
