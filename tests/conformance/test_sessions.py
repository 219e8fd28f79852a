"""L12: a new session inherits nothing that sparks or moves, and only a HELLO that is answered OK opens one."""

from __future__ import annotations

import secrets
from collections.abc import Callable

import pytest

from tests.conformance import layouts, wire
from tests.conformance.acts import ARMED_STATES, arm, assert_pulses_off, clear, lead, start_sparks
from tests.conformance.peer import EVENT, STATE_NAMES, STATUS, Peer, loses_nothing
from tests.conformance.test_delivery import PARAM, staged_is

HELLO = layouts.NAMES["HELLO"]
HOST_SILENT = 1001


def test_l12_frames_of_the_session_before_are_ignored_in_a_run(peer: Peer) -> None:
    lead(peer, "machining")
    peer.ok("TLM_START", period_us=10_000, batch=1)
    old, old_seq = peer.session, peer.seq
    peer.hello()
    clear(peer)
    lead(peer, "machining")
    before = peer.fresh_beat()["rx_drop"]
    for number in range(5):
        peer.send("DISARM", seq=(old_seq + number) % 256, session=old)
    after = peer.fresh_beat()["rx_drop"]
    assert (after - before) % 65536 == 5, peer.story("frames of another session are counted", "session")
    assert peer.state() == "MACHINING", peer.story("a frame of the old session was carried out", "session")
    peer.pump(0.1)
    assert not peer.telemetry, peer.story("telemetry of the former host goes on", "session")
    peer.ok("TLM_START", period_us=10_000, batch=1)
    assert peer.wait(lambda: peer.telemetry, 0.3), peer.story("no telemetry after TLM_START", "telemetry")


def test_l12_a_new_session_forgets_kept_replies_and_events(peer: Peer) -> None:
    peer.beating = False  # nothing is acknowledged
    arm(peer)
    stop = peer.ok("SERVO_STOP")
    peer.wait(lambda: peer.events, 0.05)
    assert [e["code"] for e in peer.events] == [EVENT["STOPPED"]]
    peer.seq = (stop.frame.seq - 1) % 256
    peer.beating = True
    peer.hello()
    again = peer.refused("SERVO_STOP", "BAD_STATE")
    assert again.frame.seq == stop.frame.seq, "a reply of another session is not a kept one"
    peer.pump(0.3)
    assert not peer.events, peer.story("events of the old session came again", "session")


@pytest.mark.parametrize("way", ARMED_STATES)
def test_l12_a_new_session_ends_what_the_host_before_left_running(peer: Peer, way: str) -> None:
    lead(peer, way)
    hello = peer.hello()
    told = STATE_NAMES[hello.state], hello.fault
    assert told == ("FAULT", HOST_SILENT), peer.story(f"HELLO tells {told}", "session")
    assert_pulses_off(peer)
    assert peer.fault(0.5)["code"] == HOST_SILENT
    before = peer.ok("GET_STATUS")
    assert peer.wait(lambda: peer.ok("GET_STATUS").actuator_v == 0.0, 3.0), peer.story(
        "the actuator is not back at 0 V", "safe-state-and-watchdog"
    )
    after = peer.ok("GET_STATUS")
    assert (after.x_um, after.y_um) == (before.x_um, before.y_um), peer.story("a stage goes on", "session")
    assert [f["code"] for f in peer.faults] == [HOST_SILENT]


def test_l12_a_new_session_ends_the_sparks_of_the_host_before(over_work: Peer) -> None:
    peer = over_work
    start_sparks(peer)
    peer.pump(0.5)
    peer.hello()
    peer.ok("TLM_START", period_us=1000, batch=1)
    peer.pump(1.0)
    rows = [
        layouts.ANSWERS[layouts.NAMES["TLM"]].read_record(r) for f in peer.telemetry for r in f["records"]
    ]
    assert len(rows) > 500
    sparks = sum(row["n_normal"] + row["n_arc"] + row["n_short"] + row["n_open"] for row in rows)
    assert sparks == 0, peer.story(f"{sparks} pulses after the new session", "session")
    assert rows[-1]["actuator_v"] == 0.0


@pytest.mark.parametrize("way", ["idle", "fault"])
def test_l12_a_new_session_changes_nothing_where_nothing_is_armed(peer: Peer, way: str) -> None:
    lead(peer, way)
    fault = peer.ok("GET_STATUS").fault
    state = peer.state()
    hello = peer.hello()
    assert (STATE_NAMES[hello.state], hello.fault) == (state, fault)
    peer.pump(0.3)
    assert (peer.state(), peer.faults) == (state, []), peer.story("a fault came", "session")


def test_l12_a_retreat_goes_on_in_a_new_session(peer: Peer) -> None:
    arm(peer)
    peer.ok("PIEZO_SET", actuator_v=60.0, slew_v_s=600.0)
    peer.event("MOVE_DONE", 5.0)
    peer.ok("DISARM")
    hello = peer.hello()
    assert (STATE_NAMES[hello.state], hello.fault) == ("MOVING", 0), peer.story(
        "DISARM was broken off", "session"
    )
    assert peer.event_of("MOVE_DONE", 3.0), peer.story("the retreat did not end", "session")
    status = peer.ok("GET_STATUS")
    assert (STATE_NAMES[status.state], status.actuator_v) == ("IDLE", 0.0)


def hello_bytes(**values: int) -> bytes:
    given = {"proto_major": layouts.MAJOR, "proto_minor": layouts.MINOR, "schema_hash": layouts.schema_hash()}
    return layouts.REQUESTS[HELLO].pack(given | {"host_nonce": secrets.randbits(32)} | values)


def values_of(hello: bytes) -> dict[str, int]:
    values = layouts.REQUESTS[HELLO].unpack(hello)
    assert values is not None
    return values


def statuses_of_hello(peer: Peer, send: Callable[[], None]) -> list[int]:
    """Statuses of the replies to HELLO, with whatever session byte, in the time of a reply."""
    seen: list[int] = []

    def looks(direction: str, frame: wire.Frame | None) -> bool:
        if direction == "in" and frame is not None and frame.type_id == HELLO | wire.REPLY:
            seen.append(frame.flags)
        return False

    peer.loses = looks
    send()
    peer.pump(0.03)
    peer.loses = loses_nothing
    return seen


OTHERS: dict[str, tuple[str, Callable[[], bytes]]] = {
    "major": ("VERSION", lambda: hello_bytes(proto_major=layouts.MAJOR + 1)),
    "schema": ("VERSION", lambda: hello_bytes(schema_hash=layouts.schema_hash() ^ 1)),
    "short": ("BAD_LENGTH", lambda: hello_bytes()[:-1]),
    "long": ("BAD_LENGTH", lambda: hello_bytes() + b"\0"),
}


@pytest.mark.parametrize("kind", [*OTHERS, "former", "former_minor", "repeated"])
def test_l12_no_other_hello_opens_feeds_or_stops_anything(peer: Peer, kind: str) -> None:
    """Only a new HELLO that is answered OK does."""
    former, own = hello_bytes(), hello_bytes()
    for payload in (former, own):
        peer.hello(**values_of(payload))
    if kind == "repeated":
        session, wanted = peer.session, [STATUS["OK"]]
    else:
        session = peer.session % 255 + 1
        wanted = [STATUS[OTHERS[kind][0]]] if kind in OTHERS else []
    minor = hello_bytes(**{**values_of(former), "proto_minor": layouts.MINOR + 1})
    known = {"former": former, "former_minor": minor, "repeated": own}

    def send() -> None:
        payload = OTHERS[kind][1]() if kind in OTHERS else known[kind]
        peer.send_payload(HELLO, payload, session=session, seq=0)

    lead(peer, "machining")
    came = statuses_of_hello(peer, send)
    assert came == wanted, peer.story(f"statuses {came} to HELLO", "session")
    assert peer.state() == "MACHINING", peer.story("the cut was stopped", "session")
    assert not peer.faults
    peer.fresh_beat()
    peer.beating = False
    for _ in range(10):
        send()
        peer.silence(0.03)
    peer.beating = True
    assert peer.fault(0.5)["code"] == HOST_SILENT, peer.story("it feeds the watchdog", "session")


def test_l12_the_reply_to_a_repeated_hello_is_the_first_one(peer: Peer) -> None:
    own = hello_bytes()
    before = peer.hello(**values_of(own))
    lead(peer, "armed")
    peer.send_payload(HELLO, own, seq=before.frame.seq)
    assert peer.reply_to(HELLO, before.frame.seq) == before


def test_l12_a_repeated_hello_of_the_same_session_forgets_nothing(peer: Peer) -> None:
    nonce = peer.hello().host_nonce
    first = peer.send("SET_PARAM", param=PARAM.id, value=5000)
    original = peer.reply_to(layouts.NAMES["SET_PARAM"], first)
    again = {"proto_major": layouts.MAJOR, "proto_minor": layouts.MINOR, "schema_hash": layouts.schema_hash()}
    peer.ok("HELLO", host_nonce=nonce, **again)
    peer.ok("SET_PARAM", param=PARAM.id, value=6000)
    peer.send("SET_PARAM", seq=first, param=PARAM.id, value=5000)
    assert peer.reply_to(layouts.NAMES["SET_PARAM"], first) == original
    assert staged_is(peer, 6000)
