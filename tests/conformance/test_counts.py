"""L28, L29: how many events wait, what becomes of those without a session, and counters that start over."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import pytest

from tests.conformance import layouts, wire
from tests.conformance.acts import arm, clear, servo_start
from tests.conformance.lines import BEFORE_WRAP, BEFORE_WRAP_US, WRAP_16, WRAP_32, count_to_the_wrap
from tests.conformance.peer import EVENT, STATE_NAMES, Peer, loses_nothing
from tests.conformance.test_delivery import REBOOT_MAGIC
from tests.conformance.test_telemetry import black_box

EVENTS_WAIT = 30
"""So many EVENTs may wait; two more places are for FAULTs."""
HOST_SILENT, ABORT_RUN, ESTOP = 1001, 1002, 4001
TOLD = {layouts.NAMES["EVENT"], layouts.NAMES["FAULT"]}
FULL = layouts.enum("PulseLog")["FULL"]


def hides_events(direction: str, frame: wire.Frame | None) -> bool:
    """A line that loses every EVENT and FAULT, so that none is acknowledged."""
    return direction == "in" and frame is not None and frame.type_id in TOLD


def fill_the_queue(peer: Peer) -> None:
    """As many events as may wait, none of them acknowledged, in ARMED."""
    arm(peer)
    peer.fresh_beat()
    peer.loses = hides_events
    for number in range(EVENTS_WAIT):
        peer.ok("SERVO_STOP")
        assert peer.state() == "ARMED", peer.story(f"no room for event {number + 1}", "events")


def assert_all_came(peer: Peer, faults: list[int]) -> None:
    """Let the line carry events again; everything that waits comes, in order and once."""
    peer.loses = loses_nothing
    peer.wait(lambda: len(peer.faults) == len(faults), 3.0)
    codes = [event["code"] for event in peer.events]
    assert codes == [EVENT["STOPPED"]] * EVENTS_WAIT, peer.story(f"{len(codes)} events came", "events")
    assert [fault["code"] for fault in peer.faults] == faults, peer.story("a FAULT got lost", "events")


def test_l28_a_host_that_lets_events_wait_stops_the_machine_and_no_fault_is_lost(peer: Peer) -> None:
    fill_the_queue(peer)
    peer.ok("SERVO_STOP")
    peer.pump(0.05)
    assert peer.state() == "FAULT", peer.story("an event was lost in silence", "events")
    peer.refused("CLEAR_FAULT", "BUSY", fault=HOST_SILENT)
    assert_all_came(peer, [HOST_SILENT])
    assert peer.faults[0]["detail"] == EVENT["STOPPED"], peer.story("which event got lost", "events")
    peer.fresh_beat()
    peer.ok("CLEAR_FAULT", fault=HOST_SILENT)


def test_l28_the_end_of_a_cut_that_cannot_be_told_leaves_no_pulses(peer: Peer) -> None:
    fill_the_queue(peer)
    peer.ok("PULSE_ENABLE", on=1)
    servo_start(peer, max_time_s=0.05)
    peer.pump(0.1)
    status = peer.ok("GET_STATUS")
    told = STATE_NAMES[status.state], status.fault, status.flags & layouts.enum("TlmFlags")["PULSES_ON"]
    assert told == ("FAULT", HOST_SILENT, 0), peer.story(f"told: {told}", "events")
    assert_all_came(peer, [HOST_SILENT])
    assert peer.faults[0]["detail"] == EVENT["TIME_UP"]


def test_l28_an_emergency_stop_has_a_place_even_then(peer: Peer, inject: Callable[[str], None]) -> None:
    fill_the_queue(peer)
    peer.write(wire.ABORT)
    peer.pump(0.02)
    inject("ESTOP@0")
    peer.pump(0.02)
    assert peer.state() == "ESTOP"
    assert_all_came(peer, [ABORT_RUN, ESTOP])


def test_l28_events_that_are_acknowledged_make_room(peer: Peer) -> None:
    arm(peer)
    for _ in range(EVENTS_WAIT + 10):
        peer.ok("SERVO_STOP")
        peer.wait(lambda: peer.ended("STOPPED"), 0.5)
        peer.fresh_beat()
    assert peer.state() == "ARMED", peer.story("acknowledged events still wait", "events")
    assert len(peer.events) == EVENTS_WAIT + 10


def test_l28_a_fault_without_a_session_is_sent_with_session_0_and_told_by_hello(peer: Peer) -> None:
    peer.ok("REBOOT", magic=REBOOT_MAGIC)
    assert peer.wait(lambda: peer.boots, 5.0)
    seen: list[wire.Frame] = []

    def looks(direction: str, frame: wire.Frame | None) -> bool:
        if direction == "in" and frame is not None and frame.type_id in TOLD:
            seen.append(frame)
        return False

    peer.loses, peer.beating = looks, False
    peer.pump(0.02)
    peer.write(wire.ABORT)
    peer.pump(0.45)
    fault = layouts.ANSWERS[layouts.NAMES["FAULT"]]
    assert len(seen) >= 3, peer.story(f"FAULT came {len(seen)} times without a session", "events")
    assert {frame.session for frame in seen} == {0}, peer.story("session of a FAULT without one", "events")
    assert len(set(seen)) == 1, "a repetition is the same frame"
    told = fault.unpack(seen[0].payload)
    assert told is not None
    assert told["code"] == ABORT_RUN
    seen.clear()
    peer.beating = True
    hello = peer.hello()
    assert (STATE_NAMES[hello.state], hello.fault) == ("FAULT", ABORT_RUN)
    peer.pump(0.3)
    assert not seen, peer.story("a FAULT of before the session came again", "events")
    clear(peer)


@pytest.fixture
def before_the_wrap(peer: Peer) -> Peer:
    """A host in a new session with a controller whose counters are about to start over."""
    if peer.line.bench is None:
        pytest.skip("counters of a board cannot be set")
    count_to_the_wrap(peer.line.bench)
    peer.hello()
    return peer


def assert_goes_on(
    peer: Peer, frames: list[layouts.Fields], field: str, wrap: int, step: Callable[..., int]
) -> None:
    """Fail unless a field of frames goes on through the end of its range."""
    values = [frame[field] for frame in frames]
    for before, after in pairwise(frames):
        due = (before[field] + step(before)) % wrap
        assert after[field] == due, peer.story(f"{field}: {after[field]} instead of {due}", "counters")
    assert values[-1] < values[0], peer.story(f"{field} did not start over", "counters")


def test_l29_what_counts_goes_on_where_it_starts_over(before_the_wrap: Peer) -> None:
    peer = before_the_wrap
    arm(peer)
    peer.ok("PULSE_ENABLE", on=1)
    peer.ok("TLM_START", period_us=1000, batch=7, pulse_log=FULL)
    for _ in range(4):
        peer.ok("SERVO_STOP")
    servo_start(peer, max_time_s=0.5)
    peer.event("TIME_UP", 2.0)
    numbers = [event["event_no"] for event in peer.events]
    assert numbers == [WRAP_16 - 2, WRAP_16 - 1, 1, 2, 3], peer.story(f"events {numbers}", "counters")
    assert_goes_on(peer, peer.telemetry, "counter", WRAP_16, lambda _: 1)
    assert_goes_on(peer, peer.telemetry, "t0_us", WRAP_32, lambda frame: 1000 * frame["n"])
    assert_goes_on(peer, peer.pulses, "counter", WRAP_16, lambda _: 1)
    assert_goes_on(peer, peer.pulses, "pulse_no", WRAP_32, lambda frame: frame["n"])
    first_us, end_us = peer.events[0]["t_us"], peer.events[-1]["t_us"]
    assert WRAP_32 - first_us <= BEFORE_WRAP_US + 1000, peer.story(
        "time of an event before the wrap", "counters"
    )
    assert end_us < first_us
    newest = peer.telemetry[-1]
    assert (newest["t0_us"] + 1000 * (newest["n"] - 1)) % WRAP_32 == end_us
    beat = peer.fresh_beat()
    assert beat["t_dev_us"] > WRAP_32, peer.story("t_dev_us has 64 bits", "counters")
    assert (beat["t_dev_us"] - end_us) % WRAP_32 < 100_000
    peer.write(wire.ABORT)
    fault = peer.fault(0.5)
    _, kept = black_box(peer)
    ages_us = sorted((fault["t_us"] - t_us) % WRAP_32 for t_us in kept)
    assert ages_us == list(range(ages_us[0], ages_us[0] + 1000 * len(kept), 1000)), peer.story(
        "times of the black box", "counters"
    )
    assert ages_us[0] <= 1000


def test_l29_frames_that_are_of_no_use_are_counted_modulo_65536(before_the_wrap: Peer) -> None:
    peer = before_the_wrap
    before = peer.fresh_beat()
    assert before["rx_drop"] == WRAP_16 - BEFORE_WRAP
    for number in range(BEFORE_WRAP + 2):
        peer.send("GET_STATUS", seq=number, session=peer.session % 255 + 1)
        peer.write(b"\0\x03\0\0")
    after = peer.fresh_beat()
    assert (after["rx_drop"], after["rx_bad"]) == (2, 2), peer.story("rx_drop, rx_bad", "counters")


def test_l29_the_watchdog_and_the_repetition_of_events_know_no_wrap(before_the_wrap: Peer) -> None:
    peer = before_the_wrap
    arm(peer)
    peer.pump(0.15)
    at_us = peer.fresh_beat()["t_dev_us"]
    peer.silence(0.25 - peer.grain_s)
    peer.fresh_beat()
    assert not peer.faults, peer.story("the watchdog tripped at the wrap", "counters")
    at_us = peer.fresh_beat()["t_dev_us"]
    assert at_us > WRAP_32
    peer.silence(0.25 + peer.grain_s)
    fault = peer.fault(0.5)
    assert fault["code"] == HOST_SILENT
    assert 249_000 <= (fault["t_us"] - at_us) % WRAP_32 <= 251_000


def test_l29_boots_start_over_with_0(before_the_wrap: Peer) -> None:
    peer = before_the_wrap
    peer.ok("REBOOT", magic=REBOOT_MAGIC)
    assert peer.wait(lambda: peer.boots, 5.0)
    assert peer.boots[0]["boot_count"] == 0, peer.story("boot_count", "counters")
    assert peer.hello().boot_count == 0
