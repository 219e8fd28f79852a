"""L1 (what the controller sends), L17 and L23: telemetry, pulses and the black box in a running cut."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from random import Random
from typing import Any

import pytest

from tests.conformance import layouts, wire
from tests.conformance.acts import WORK_X_UM, arm, clear, move_x, start_pulses, start_sparks
from tests.conformance.layouts import Fields
from tests.conformance.lines import cut_the_power, press_reset
from tests.conformance.peer import EVENT, STATE, Peer, loses_nothing

PULSE_LOG = layouts.enum("PulseLog")
PULSES_ON = layouts.enum("TlmFlags")["PULSES_ON"]
CONTACT = layouts.enum("TlmFlags")["CONTACT"]
LEAST_BOX, MOST_BOX = 500, 2048
TLM = layouts.ANSWERS[layouts.NAMES["TLM"]]


def samples(frames: list[Fields]) -> dict[int, bytes]:
    """Telemetry records by their time."""
    return {
        (frame["t0_us"] + number * frame["period_us"]) % 2**32: record
        for frame in frames
        for number, record in enumerate(frame["records"])
    }


@pytest.mark.parametrize("period_us", [1000, 2000])
def test_l17_no_sample_is_unaccounted_for(peer: Peer, period_us: int) -> None:
    peer.ok("TLM_START", period_us=period_us, batch=5)
    peer.pump(0.4)
    peer.ok("TLM_STOP")
    peer.pump(0.02)
    frames = peer.telemetry
    assert len(frames) > (20 if peer.exact else 3), peer.story("telemetry is slow", "telemetry")
    for before, after in pairwise(frames):
        assert after["counter"] == (before["counter"] + 1) % 65536, peer.story(
            "a frame is missing", "telemetry"
        )
        lost = after["dropped"] * period_us
        expected = (before["t0_us"] + before["n"] * period_us + lost) % 2**32
        assert after["t0_us"] == expected, peer.story(f"{before['t0_us']} -> {after['t0_us']}", "telemetry")
        assert after["period_us"] == period_us
    assert all(1 <= frame["n"] <= 5 for frame in frames)


def test_l17_the_counter_tells_exactly_what_a_line_lost(peer: Peer) -> None:
    chance, lost = Random(17), [0]
    tlm = layouts.NAMES["TLM"]

    def drops(direction: str, frame: wire.Frame | None) -> bool:
        lose = (
            frame is not None and frame.type_id == tlm and len(peer.telemetry) > 0 and chance.random() < 0.1
        )
        lost[0] += lose
        return lose

    peer.loses = drops
    peer.ok("TLM_START", period_us=1000, batch=1)
    peer.pump(1.0)
    peer.loses = loses_nothing
    peer.pump(0.05)
    peer.ok("TLM_STOP")
    counters = [frame["counter"] for frame in peer.telemetry]
    missing = sum((b - a - 1) % 65536 for a, b in pairwise(counters))
    assert missing == lost[0], peer.story(f"{missing} missing by the counter, {lost[0]} dropped", "telemetry")
    assert lost[0] > 20


@pytest.mark.parametrize(("log", "name"), [("FULL", "PULSES"), ("BLOCKS", "PULSE_BLOCKS")])
def test_l1_every_pulse_of_a_cut_is_told(over_work: Peer, log: str, name: str) -> None:
    peer = over_work
    bad: list[Any] = []
    size = {"PULSES": 1, "PULSE_BLOCKS": layouts.PARAMETERS["block_pulses"].default}[name]
    start_sparks(peer, max_time_s=1.0)
    peer.ok("TLM_START", period_us=10_000, batch=5, pulse_log=PULSE_LOG[log])
    peer.event("TIME_UP", 5.0)
    frames = peer.pulses
    assert len(frames) > 4, peer.story(f"only {len(frames)} {name}", "telemetry")
    for before, after in pairwise(frames):
        if after["counter"] != (before["counter"] + 1) % 65536:
            bad.append(after["counter"])
        if after["pulse_no"] != (before["pulse_no"] + before["n"] * size) % 2**32:
            bad.append((before["pulse_no"], after["pulse_no"]))
    assert not bad, peer.story(f"{name} with gaps: {bad[:3]}", "telemetry")


def test_l1_telemetry_before_an_event_is_sent_before_it(over_work: Peer) -> None:
    peer = over_work
    start_sparks(peer, max_time_s=0.333)
    peer.ok("TLM_START", period_us=1000, batch=14)
    end = peer.event("TIME_UP", 5.0)
    last = peer.telemetry[-1] if peer.telemetry else None
    assert last is not None
    newest_us = max(samples(peer.telemetry))
    assert end["t_us"] - newest_us <= 1000, peer.story("samples are missing before TIME_UP", "events")


def black_box(peer: Peer) -> tuple[int, dict[int, bytes]]:
    """Every sample that the black box holds, by its time, and their number."""
    found: dict[int, bytes] = {}
    offset, total = 0, 1
    while offset < total:
        page = peer.ok("BLACKBOX_READ", offset=offset)
        total = page.total
        if not total:
            break
        assert page.n, peer.story(f"an empty page at {offset} of {total}", "black-box")
        for number, record in enumerate(page.records):
            found[(page.t0_us + 1000 * number) % 2**32] = record
        offset += page.n
    assert len(found) == total, peer.story("pages of the black box overlap", "black-box")
    return total, found


def test_l23_the_black_box_holds_what_telemetry_sent(over_work: Peer) -> None:
    peer = over_work
    start_sparks(peer)
    peer.ok("TLM_START", period_us=1000, batch=14)
    peer.pump(0.7)
    peer.write(wire.ABORT)
    fault = peer.fault(0.5)
    sent = samples(peer.telemetry)
    total, kept = black_box(peer)
    assert LEAST_BOX <= total <= MOST_BOX
    times = sorted(kept)
    assert times == list(range(times[0], times[0] + 1000 * total, 1000)), "one sample each millisecond"
    assert 0 <= fault["t_us"] - times[-1] <= 1000, peer.story(
        "the black box does not end at the fault", "black-box"
    )
    both = kept.keys() & sent.keys()
    assert len(both) > 500
    different = sorted(t for t in both if kept[t] != sent[t])
    assert not different, peer.story(
        f"{len(different)} of {len(both)} samples differ, first at {different[0]} us: "
        f"{TLM.read_record(kept[different[0]])} is not {TLM.read_record(sent[different[0]])}",
        "black-box",
    )
    peer.pump(0.3)
    assert black_box(peer)[1] == kept, peer.story("a fault freezes the black box", "black-box")
    assert any(TLM.read_record(r)["flags"] & PULSES_ON for r in kept.values())


def test_l23_without_a_fault_the_black_box_goes_on(peer: Peer) -> None:
    peer.pump(0.1)
    first = black_box(peer)[1]
    peer.pump(0.1)
    second = black_box(peer)[1]
    assert max(second) > max(first)
    assert {TLM.read_record(r)["state"] for r in second.values()} <= set(STATE.values())
    total = peer.ok("BLACKBOX_READ", offset=0).total
    page = peer.ok("BLACKBOX_READ", offset=65535)
    assert page.n == 0
    assert 0 < total <= MOST_BOX


def test_l23_a_full_black_box_forgets_its_oldest_sample_alone(peer: Peer) -> None:
    """Its size is what a controller holds at last; a host need not know it before."""
    peer.pump(1e-3 * MOST_BOX)
    size = peer.ok("BLACKBOX_READ", offset=0).total
    assert LEAST_BOX <= size <= MOST_BOX, peer.story(f"it holds {size} samples", "black-box")
    now_us = peer.ok_at("BLACKBOX_READ", offset=0)
    before = peer.ok("BLACKBOX_READ", offset=0)
    newest = peer.ok("BLACKBOX_READ", offset=size - 1)
    passed_us = (peer.fresh_beat()["t_dev_us"] - now_us) % 2**32
    peer.pump(0.1)
    after = peer.ok("BLACKBOX_READ", offset=0)
    assert (before.total, after.total) == (size, size), peer.story(
        "a full black box has another size", "black-box"
    )
    gone_us = (after.t0_us - before.t0_us) % 2**32
    assert gone_us >= 90_000, peer.story("a full black box does not go on", "black-box")
    assert newest.n == 1
    if peer.exact:
        assert (newest.t0_us - now_us) % 2**32 <= passed_us, peer.story(
            "the newest sample is not of now", "black-box"
        )
        assert 0 <= (newest.t0_us - before.t0_us) % 2**32 - 1000 * (size - 1) <= passed_us
    for offset in (size, 65535):
        assert peer.ok("BLACKBOX_READ", offset=offset).n == 0


def test_l23_a_cleared_fault_begins_the_black_box_anew(peer: Peer) -> None:
    peer.pump(0.2)
    peer.write(wire.ABORT)
    peer.fault(0.5)
    peer.pump(0.2)
    cleared_us = peer.fresh_beat()["t_dev_us"]
    clear(peer)
    peer.pump(0.05)
    _, kept = black_box(peer)
    oldest_us = (min(kept) - cleared_us + 2**31) % 2**32 - 2**31
    assert oldest_us >= 0, peer.story("the black box holds samples from before CLEAR_FAULT", "black-box")
    assert len(kept) > 30


@pytest.mark.parametrize("reset", [press_reset, cut_the_power])
def test_l23_a_latched_fault_holds_its_samples_or_none_through_a_reset(
    over_work: Peer, reset: Callable[[Any], None]
) -> None:
    """What comes after it is never told as what was before it."""
    peer = over_work
    peer.pump(0.2)
    peer.write(wire.ABORT)
    peer.fault(0.5)
    _, before = black_box(peer)
    for _ in range(2):
        peer.pump(0.2)
        peer.boots.clear()
        reset(peer.line.bench)
        assert peer.wait(lambda: peer.boots, 3.0), peer.story("no BOOT", "session")
        peer.hello()
        peer.pump(0.2)
        _, kept = black_box(peer)
        assert kept in ({}, before), peer.story(f"{len(kept)} samples, not those of the fault", "black-box")
    clear(peer)
    peer.pump(0.1)
    assert 50 <= black_box(peer)[0] <= 200 or not peer.exact


def test_l17_the_first_sample_is_the_next_multiple_of_the_period(peer: Peer) -> None:
    period_us = 7000
    for _ in range(3):
        peer.pump(0.003)
        peer.telemetry.clear()
        now_us = peer.ok_at("TLM_START", period_us=period_us, batch=3)
        peer.pump(0.1)
        # A line may bring samples of before after the reply.
        first_us = next(f["t0_us"] for f in peer.telemetry if (f["t0_us"] - now_us) % 2**32 < 2**31)
        if peer.exact:
            due_us = (now_us // period_us + 1) * period_us
            assert first_us == due_us % 2**32, peer.story(
                f"{first_us} us instead of {due_us} us", "telemetry"
            )


def test_l17_the_sample_with_the_first_contact_of_a_touch_shows_it(over_work: Peer) -> None:
    """By the contact at its end alone one of ten would miss it: there the tool has begun to hunt."""
    peer = over_work
    arm(peer)
    move_x(peer, WORK_X_UM)
    peer.ok("TLM_START", period_us=10_000, batch=1)
    touch = {"fast_um_s": 20.0, "fast_to_um": 5.0, "speed_um_s": 5.0, "z_max_um": 60.0}
    peer.ok("TOUCH_OFF", **touch, back_off_um=1.0, dwell_s=0.05, touches=20)
    peer.event("TOUCH_DONE", 60.0)
    rows = {
        time: TLM.read_record(record)["flags"] & CONTACT for time, record in samples(peer.telemetry).items()
    }
    touches = [event["t_us"] for event in peer.events if event["code"] == EVENT["TOUCH"]]
    shown = [rows[(first + 9999) // 10_000 * 10_000] for first in touches]
    assert shown == 20 * [CONTACT], peer.story(f"contact in the samples: {shown}", "the-millisecond")


@pytest.mark.parametrize("again", ["TLM_START", "TLM_STOP"])
def test_l17_telemetry_that_starts_anew_carries_nothing_of_before(over_work: Peer, again: str) -> None:
    peer = over_work
    start_pulses(peer)
    size = layouts.PARAMETERS["block_pulses"].default
    asked = {"period_us": 10_000, "batch": 5, "pulse_log": PULSE_LOG["BLOCKS"]}
    for _ in range(4):
        peer.ok("TLM_START", **asked)
        peer.pump(0.107)  # a frame is not full, nor a block
        if again == "TLM_STOP":
            peer.ok("TLM_STOP")
        peer.pump(0.002)
    peer.pulses.clear()
    peer.ok("TLM_START", **asked)
    peer.pump(0.5)
    block = layouts.ANSWERS[layouts.NAMES["PULSE_BLOCKS"]]
    rows = [block.read_record(record) for frame in peer.pulses for record in frame["records"]]
    assert len(rows) > 19
    sums = {row["n_open"] + row["n_normal"] + row["n_arc"] + row["n_short"] for row in rows}
    assert sums == {size}, peer.story(f"blocks of {sums} pulses", "telemetry")
