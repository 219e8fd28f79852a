"""L25: a scan follows its lines in order, both axes together, and no further than it may."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from tests.conformance.acts import (
    DUTY_V,
    arm,
    lead,
    line_to,
    scan_start,
    set_parameters,
    start_sparks,
)
from tests.conformance.peer import STATUS, Peer

QUEUE = 16
HELD_UM = 5.0


def start_scan(peer: Peer, **scan: float) -> tuple[float, float]:
    """From IDLE to a scan without lines; where the stages are."""
    arm(peer)
    peer.ok("PULSE_ENABLE", on=1)
    scan_start(peer, **scan)
    return place(peer)


def place(peer: Peer) -> tuple[float, float]:
    status = peer.ok("GET_STATUS")
    return status.x_um, status.y_um


def test_l25_a_line_moves_both_axes_at_its_speed_and_the_last_one_ends_the_scan(peer: Peer) -> None:
    x, y = start_scan(peer)
    peer.ok("PATH_MOVE", **line_to(x - 30.0, y + 40.0, speed_um_s=50.0))
    peer.pump(0.5)
    here = place(peer)
    gone = math.dist(here, (x, y))
    assert gone == pytest.approx(25.0, abs=1.0 if peer.exact else 5.0), peer.story("speed", "scanning")
    assert (here[0] - x) * 4.0 == pytest.approx((here[1] - y) * -3.0, abs=0.1), peer.story("both", "scanning")
    peer.ok("PATH_MOVE", **line_to(x, y, last=1))
    assert peer.event("PATH_DONE", 5.0)
    assert place(peer) == pytest.approx((x, y), abs=0.01)
    assert peer.state() == "ARMED", peer.story("state after PATH_DONE", "scanning")


def test_l25_a_full_queue_is_busy_and_takes_the_line_later(peer: Peer) -> None:
    x, y = start_scan(peer)
    taken = 0
    while (
        peer.command("PATH_MOVE", **line_to(x - 4.0 * (taken % 2), y, speed_um_s=20.0)).status == STATUS["OK"]
    ):
        taken += 1
        assert taken <= QUEUE + 1
    assert taken >= QUEUE, peer.story(f"the queue holds {taken}", "scanning")
    peer.refused("PATH_MOVE", "BUSY", **line_to(x, y))
    peer.pump(0.5)
    peer.ok("PATH_MOVE", **line_to(x, y, last=1))
    peer.refused("PATH_MOVE", "BAD_STATE", **line_to(x, y))
    assert peer.event("PATH_DONE", 10.0)
    assert place(peer) == pytest.approx((x, y), abs=0.01)


@pytest.mark.parametrize("way", ["idle", "armed", "machining", "touch", "jump"])
def test_l25_lines_are_refused_outside_a_scan(peer: Peer, way: str) -> None:
    lead(peer, way)
    before = place(peer)
    peer.refused("PATH_MOVE", "BAD_STATE", **line_to(before[0] - 50.0, before[1]))
    peer.pump(0.1)
    assert place(peer) == before


def test_l25_a_scan_needs_pulses_and_a_line_a_speed(peer: Peer) -> None:
    peer.refused("SCAN_START", "BAD_STATE", gap_ref_v=0.8 * DUTY_V, z_limit_um=HELD_UM, max_time_s=1.0)
    arm(peer)
    peer.refused("SCAN_START", "BAD_STATE", gap_ref_v=0.8 * DUTY_V, z_limit_um=HELD_UM, max_time_s=1.0)
    peer.ok("PULSE_ENABLE", on=1)
    scan_start(peer)
    peer.refused("PATH_MOVE", "OUT_OF_RANGE", **line_to(0.0, 0.0, speed_um_s=0.0))


def test_l25_the_tool_is_held_at_the_limit_of_the_line_it_is_on(peer: Peer) -> None:
    x, y = start_scan(peer, z_limit_um=HELD_UM)
    peer.pump(3.0)
    assert peer.state() == "MACHINING", peer.story("a limit is no end of a scan", "scanning")
    if not peer.exact:
        pytest.skip("needs a known actuator")
    assert peer.ok("GET_STATUS").displacement_um == pytest.approx(HELD_UM, abs=1.0)
    peer.ok("PATH_MOVE", **line_to(x - 20.0, y, speed_um_s=10.0, z_limit_um=HELD_UM - 3.0))
    peer.pump(1.0)
    assert peer.ok("GET_STATUS").displacement_um == pytest.approx(HELD_UM - 1.5, abs=1.0)
    peer.pump(4.0)
    assert peer.ok("GET_STATUS").displacement_um == pytest.approx(HELD_UM - 3.0, abs=1.0)


def test_l25_a_held_tool_may_find_no_sparks_for_long(peer: Peer) -> None:
    if not peer.exact:
        pytest.skip("would take long on a board")
    arm(peer, set_parameters(peer, open_lost_s=3000))
    peer.ok("PULSE_ENABLE", on=1)
    scan_start(peer)
    x, y = place(peer)
    peer.pump(6.0)
    assert peer.state() == "MACHINING", peer.story("open_lost_s counts while the tool is held", "scanning")
    peer.ok("PATH_MOVE", **line_to(x, y, z_limit_um=HELD_UM + 3.0))
    peer.pump(6.0)
    assert peer.state() == "MACHINING", peer.story("the time in which it was held counts later", "scanning")
    peer.ok("PATH_MOVE", **line_to(x, y, z_limit_um=HELD_UM + 30.0))
    assert peer.fault(10.0)["code"] == 3005, peer.story("open_lost_um counts in a scan", "scanning")


def test_l25_stages_stand_still_in_a_jump(peer: Peer) -> None:
    x, y = start_scan(peer)
    peer.pump(2.0)
    peer.ok("PATH_MOVE", **line_to(x - 100.0, y, speed_um_s=50.0))
    peer.pump(0.2)
    peer.ok("JUMP", height_um=2.0, speed_um_s=50.0, dwell_s=0.5, clearance_um=0.0)
    before = place(peer)
    peer.pump(0.3)
    assert peer.state() == "JUMP"
    assert place(peer) == before, peer.story("a stage moved in a jump", "scanning")
    peer.event("JUMP_DONE", 10.0)
    peer.pump(0.3)
    assert place(peer)[0] < before[0] - 5.0, peer.story("the scan did not go on after the jump", "scanning")


@pytest.mark.parametrize("end", ["SERVO_STOP", "TIME_UP", "PULSE_ENABLE"])
def test_l25_whatever_ends_a_scan_stops_the_stages_and_forgets_the_lines(peer: Peer, end: str) -> None:
    x, y = start_scan(peer, max_time_s=0.5 if end == "TIME_UP" else 60.0)
    peer.ok("PATH_MOVE", **line_to(x - 200.0, y, speed_um_s=50.0))
    peer.pump(0.2)
    if end == "SERVO_STOP":
        peer.ok("SERVO_STOP")
    elif end == "PULSE_ENABLE":
        peer.ok("PULSE_ENABLE", on=0)
    peer.event("TIME_UP" if end == "TIME_UP" else "STOPPED", 5.0)
    stopped = place(peer)
    assert x - 50.0 < stopped[0] < x
    peer.ok("PULSE_ENABLE", on=1)
    for start in ("SCAN_START", "SERVO_START"):
        peer.ok(start, gap_ref_v=0.8 * DUTY_V, z_limit_um=100.0, max_time_s=60.0)
        peer.pump(0.3)
        assert place(peer) == stopped, peer.story("a line of the scan before", "scanning")
        if start == "SERVO_START":
            peer.refused("PATH_MOVE", "BAD_STATE", **line_to(x, y))
        peer.ok("SERVO_STOP")
        peer.event("STOPPED", 1.0)


@pytest.mark.parametrize("fault", ["silence", "limit", "door"])
def test_l25_a_fault_stops_pulses_and_stages(peer: Peer, inject: Callable[[str], None], fault: str) -> None:
    x, y = start_scan(peer)
    peer.ok("PATH_MOVE", **line_to(x - 400.0, y, speed_um_s=50.0))
    peer.pump(0.2)
    if fault == "silence":
        peer.silence(0.3)
    else:
        inject("STAGE_LIMIT@0" if fault == "limit" else "DOOR@0")
    assert peer.fault(0.5)["code"] == {"silence": 1001, "limit": 2004, "door": 4002}[fault]
    stopped = place(peer)
    assert stopped[0] > x - 30.0
    peer.pump(0.5)
    assert place(peer) == stopped, peer.story("the stages went on after a fault", "safe-state-and-watchdog")


def test_l25_a_short_keeps_the_stages(over_work: Peer, inject: Callable[[str], None]) -> None:
    peer = over_work
    start_sparks(peer)
    peer.pump(1.0)
    peer.ok("SERVO_STOP")
    peer.event("STOPPED", 1.0)
    scan_start(peer, z_limit_um=peer.ok("GET_STATUS").displacement_um)
    x, y = place(peer)
    peer.ok("PATH_MOVE", **line_to(x + 100.0, y, speed_um_s=20.0, z_limit_um=0.0))
    peer.pump(0.5)
    inject("WIRE_SHORT@0")
    peer.pump(0.005)
    before = place(peer)
    assert before[0] > x
    peer.pump(1.0)
    assert place(peer) == before, peer.story("a stage moved while the gap was shorted", "scanning")
    peer.line.bench.clear_injections()
    peer.pump(1.0)
    assert place(peer)[0] > before[0] + 10.0
