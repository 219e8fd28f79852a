"""L26: voltage and current of the gap about a fault."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.conformance import layouts, wire
from tests.conformance.acts import OFF_US, ON_US, clear, lead, start_pulses, start_sparks
from tests.conformance.lines import shorten_waveforms
from tests.conformance.peer import STATUS, Peer, Reply

PULSES = layouts.ANSWERS[layouts.NAMES["PULSES"]]
OPEN = layouts.enum("PulseClass")["OPEN"]
PULSES_BEFORE, PERIODS_AFTER = 64, 16
SWITCH_OFF_US = 10.0


def when_ready(peer: Peer, offset: int) -> Reply:
    """A page, as soon as the time after the fault has passed."""
    for _ in range(200):
        reply = peer.command("WAVEFORM_READ", offset=offset)
        if reply.status != STATUS["BUSY"]:
            break
        peer.pump(0.01)
    assert reply.status == STATUS["OK"], peer.story("WAVEFORM_READ is refused", "waveforms")
    return reply


def waveforms(peer: Peer) -> tuple[int, float, NDArray[np.int16]]:
    """Time of the first sample, µs between two, and counts of voltage and current, shape (total, 2)."""
    page = when_ready(peer, 0)
    total, head, data = page.total, (page.total, page.t0_us, page.period_ns), b""
    while len(data) < 4 * total:
        page = when_ready(peer, len(data) // 4)
        assert (page.total, page.t0_us, page.period_ns) == head, peer.story("pages disagree", "waveforms")
        assert 0 < page.n <= 58, peer.story(f"{page.n} samples in a page", "waveforms")
        data += b"".join(page.records)
    assert len(data) == 4 * total
    return page.t0_us, page.period_ns / 1000, np.frombuffer(data, "<i2").reshape(-1, 2)


def assert_window(peer: Peer, begin_us: float, end_us: float, period_us: float, step_us: float) -> None:
    """Fail where the record, in time after the fault, is not the part of 64 and 16 periods that a memory holds.

    A fifth of the memory is for the time after the fault, so the time before is four times that, from the begin of
    the first pulse on.
    """
    assert 0 < end_us <= PERIODS_AFTER * period_us + 1 + step_us, peer.story(
        f"they end {end_us} us after the fault", "waveforms"
    )
    before_us, slack_us = 4.0 * end_us, 5.0 * (1 + step_us)
    assert before_us - period_us - slack_us <= -begin_us <= before_us + slack_us, peer.story(
        f"they begin {begin_us} us from the fault and end {end_us} us after it", "waveforms"
    )


@pytest.mark.parametrize("memory", [65536, 20_000, 2000])
def test_l26_a_short_memory_holds_a_part_of_both_sides(over_work: Peer, memory: int) -> None:
    peer = over_work
    memory = shorten_waveforms(peer.line.bench, memory)
    start_pulses(peer)
    peer.pump(0.2)
    peer.write(wire.ABORT)
    fault = peer.fault(0.5)
    t0_us, step_us, counts = waveforms(peer)
    shorten_waveforms(peer.line.bench, 65536)
    begin_us = t0_us - fault["t_us"]
    assert_window(peer, begin_us, begin_us + step_us * len(counts), ON_US + OFF_US, step_us)
    whole = (PULSES_BEFORE + PERIODS_AFTER) * (ON_US + OFF_US)
    assert len(counts) <= memory
    assert len(counts) >= min(whole, memory) - (ON_US + OFF_US) - 2
    assert counts[0, 0] < 1000 < counts[8, 0], peer.story("they do not begin with a pulse", "waveforms")


def test_l26_without_a_fault_there_are_none(peer: Peer) -> None:
    page = peer.ok("WAVEFORM_READ", offset=0)
    assert (page.total, page.n) == (0, 0)
    assert peer.ok("WAVEFORM_READ", offset=2**32 - 1).n == 0


def test_l26_a_fault_without_pulses_leaves_none_and_they_may_be_asked_for_in_every_state(peer: Peer) -> None:
    for way in ("armed", "fault"):
        lead(peer, way)
        assert when_ready(peer, 0).total == 0


def test_l26_the_waveforms_are_the_pulses_that_telemetry_told(over_work: Peer) -> None:
    peer = over_work
    start_sparks(peer)
    peer.ok("TLM_START", period_us=10_000, batch=5, pulse_log=layouts.enum("PulseLog")["FULL"])
    peer.pump(0.5)
    peer.write(wire.ABORT)
    fault = peer.fault(0.5)
    t0_us, step_us, counts = waveforms(peer)
    assert 0 < step_us <= 1.0
    told = {
        frame["t0_us"] + number * frame["period_ns"] / 1000: struct.unpack("<BHHB", record)
        for frame in peer.pulses
        for number, record in enumerate(frame["records"])
    }
    period_us = peer.pulses[0]["period_ns"] / 1000
    begin_us = t0_us - fault["t_us"]
    assert_window(peer, begin_us, begin_us + step_us * len(counts), period_us, step_us)
    current_a = counts[:, 1] * 0.001
    compared = 0
    for start_us, (pulse_class, _, discharge, _) in told.items():
        if start_us < t0_us - 1.5 or start_us + ON_US > fault["t_us"]:
            continue
        first = max(0, round((start_us - t0_us) / step_us))
        burning = current_a[first : first + int(0.9 * period_us / step_us)] > 0.05
        expected = 0 if pulse_class == OPEN else discharge / 10 / step_us
        assert abs(int(burning.sum()) - expected) <= 2, peer.story(
            f"current for {burning.sum()} samples, telemetry told {expected:.1f}", "waveforms"
        )
        compared += 1
    assert compared >= min(PULSES_BEFORE, -begin_us / period_us) - 2
    after = round((fault["t_us"] + peer.line.decides_us + SWITCH_OFF_US - t0_us) / step_us)
    assert np.abs(current_a[after:]).max() < 0.02, peer.story("current after the fault", "waveforms")
    peer.pump(0.3)
    assert np.array_equal(waveforms(peer)[2], counts), peer.story("a fault freezes them", "waveforms")
    clear(peer)
    assert peer.ok("WAVEFORM_READ", offset=0).total == 0


def test_l26_they_are_not_told_before_they_are_whole(over_work: Peer) -> None:
    peer = over_work
    start_sparks(peer)
    peer.pump(0.2)
    peer.write(wire.ABORT)
    reply = peer.command("WAVEFORM_READ", offset=0)
    if peer.exact:
        assert reply.status == STATUS["BUSY"], peer.story("half a record", "waveforms")
    assert when_ready(peer, 0).total > 0
