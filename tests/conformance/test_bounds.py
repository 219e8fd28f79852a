"""L33: what ends pulses on the way back from a jump, and in a scan that is held, as it does in a cut."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tests.conformance.acts import arm, scan_start, servo_start, set_parameters
from tests.conformance.peer import Peer

TRAVEL_LIMIT, NO_SPARK = 2001, 3005
START_V = 20.0
SLOWLY = {"short_back_um_s": 50}  # 0.05 um/s
LEAST_LOST = {"open_lost_s": 100}


def cut_and_jump(peer: Peer, parameters: dict[str, int], beyond_um: float, **servo: float) -> float:
    """From IDLE to a cut in the air whose limit lies so far beyond where it begins, and a jump; where it began."""
    if not peer.exact:
        pytest.skip("needs a known actuator")
    arm(peer, set_parameters(peer, **parameters))
    peer.ok("PULSE_ENABLE", on=1)
    peer.ok("PIEZO_SET", actuator_v=START_V, slew_v_s=300.0)
    peer.event("MOVE_DONE", 5.0)
    peer.pump(0.3)
    start_um: float = peer.ok("GET_STATUS").displacement_um
    servo_start(peer, z_limit_um=start_um + beyond_um, **servo)
    peer.pump(0.02)
    peer.ok("JUMP", height_um=40.0, speed_um_s=1000.0, dwell_s=0.0, clearance_um=40.0)
    return start_um


def test_l33_the_time_of_a_cut_goes_on_while_a_jump_has_pulses_on(peer: Peer) -> None:
    cut_and_jump(peer, SLOWLY, 100.0, max_time_s=1.0)
    before_us = peer.fresh_beat()["t_dev_us"]
    peer.event("JUMP_DONE", 2.0)
    ended = peer.event("TIME_UP", 0.1)
    assert ended["t_us"] - before_us < 1_300_000, peer.story("sparks without an end", "motions")
    assert peer.state() == "ARMED"


def test_l33_the_way_back_from_a_jump_ends_at_the_limit_of_the_cut(peer: Peer) -> None:
    start_um = cut_and_jump(peer, {}, 5.0)
    peer.event("JUMP_DONE", 5.0)
    ended = peer.event("CUT_DONE", 0.1)
    # The low-passed displacement is 2.5 µm behind.
    assert ended["displacement_um"] - start_um < 9.0, peer.story("deeper than the limit", "motions")


def test_l33_lost_sparks_are_found_on_the_way_back_from_a_jump(peer: Peer) -> None:
    start_um = cut_and_jump(peer, {}, 100.0)
    fault = peer.fault(5.0)
    assert fault["code"] == NO_SPARK
    assert fault["displacement_um"] - start_um < 19.0, peer.story("farther than open_lost_um", "motions")


def test_l33_a_displacement_that_fails_ends_the_way_back_from_a_jump(
    peer: Peer, inject: Callable[[str], None]
) -> None:
    cut_and_jump(peer, SLOWLY, 100.0)
    peer.pump(0.5)
    assert peer.state() == "JUMP"
    before_us = peer.fresh_beat()["t_dev_us"]
    inject("SENSOR_OPEN@0")
    fault = peer.fault(0.5)
    assert fault["code"] == TRAVEL_LIMIT, peer.story("nobody knows how deep", "motions")
    assert fault["t_us"] - before_us <= 5000


def test_l33_a_held_scan_does_not_know_open_lost_s(peer: Peer) -> None:
    arm(peer, set_parameters(peer, **LEAST_LOST))
    peer.ok("PULSE_ENABLE", on=1)
    peer.pump(0.3)
    scan_start(peer, z_limit_um=peer.ok("GET_STATUS").displacement_um)
    peer.pump(3.0)
    assert peer.state() == "MACHINING", peer.story("a held tool waits as long as it has to", "scanning")
