"""L27: the host says where `safe_z_um` counts from, and cannot say much that the controller does not see itself."""

from __future__ import annotations

import pytest

from tests.conformance.acts import ARMED_STATES, arm, disarm, lead, set_parameters
from tests.conformance.peer import Peer

BELOW_UM, ABOVE_UM = 5.0, 25.0
"""The reading may lie so far below and above the zero."""
LOW_PASS_S = 0.3
"""The displacement that interlocks stages is low-passed."""
SECTION = "states"


def armed_too_deep(peer: Peer, by_um: float) -> tuple[float, int]:
    """Arm with `safe_z_um` that much above the tool at rest; the reading there, and the parameters' check."""
    peer.pump(LOW_PASS_S)
    rest_um = peer.ok("GET_STATUS").displacement_um
    crc = set_parameters(peer, safe_z_um=round(1000.0 * (rest_um - by_um)))
    arm(peer, crc)
    return rest_um, crc


def try_stage(peer: Peer) -> bool:
    """Let a stage move to where it stands; whether it was allowed to."""
    x_um = peer.ok("GET_STATUS").x_um
    reply = peer.command("STAGE_MOVE", axis=0, target=round(1000.0 * x_um), speed=1_000_000)
    if reply.status == 0:
        peer.event("STAGE_DONE", 2.0)
    return bool(reply.status == 0)


def test_l27_safe_z_counts_from_the_zero_until_the_next_arm(peer: Peer) -> None:
    rest_um, crc = armed_too_deep(peer, by_um=2.5)
    assert not try_stage(peer), peer.story("a stage moved beyond safe_z_um", SECTION)
    peer.ok("SET_ZERO", zero_um=rest_um + 4.0)
    assert try_stage(peer), peer.story("safe_z_um does not count from the zero", SECTION)
    peer.ok("SET_ZERO", zero_um=rest_um - 4.0)
    assert not try_stage(peer), peer.story("the zero before still counts", SECTION)
    peer.ok("SET_ZERO", zero_um=rest_um + 4.0)
    disarm(peer)
    arm(peer, crc)
    assert not try_stage(peer), peer.story("ARM did not forget the zero", SECTION)


@pytest.mark.parametrize(("side", "within_um"), [(-1.0, ABOVE_UM), (1.0, BELOW_UM)])
def test_l27_a_zero_that_the_controller_does_not_see_is_refused(
    peer: Peer, side: float, within_um: float
) -> None:
    rest_um, _ = armed_too_deep(peer, by_um=2.5)
    for away_um in (within_um + 1.0, 40.0, 2e6):
        peer.refused("SET_ZERO", "OUT_OF_RANGE", zero_um=rest_um + side * away_um)
    assert not try_stage(peer), peer.story("a refused zero counts", SECTION)
    peer.ok("SET_ZERO", zero_um=rest_um + side * (within_um - 1.0))


def test_l27_displacements_stay_those_of_the_sensor(peer: Peer) -> None:
    rest_um, _ = armed_too_deep(peer, by_um=0.0)
    peer.ok("SET_ZERO", zero_um=rest_um + 4.0)
    peer.pump(0.1)
    assert peer.ok("GET_STATUS").displacement_um == pytest.approx(rest_um, abs=1.0)


def test_l27_the_zero_of_an_extended_tool_is_refused(peer: Peer) -> None:
    arm(peer)
    peer.ok("PIEZO_SET", actuator_v=10.0, slew_v_s=300.0)
    peer.event("MOVE_DONE", 5.0)
    peer.pump(LOW_PASS_S)
    peer.refused("SET_ZERO", "BAD_STATE", zero_um=peer.ok("GET_STATUS").displacement_um)


@pytest.mark.parametrize("way", ["idle", "fault", *(way for way in ARMED_STATES if way != "armed")])
def test_l27_the_zero_is_told_at_rest_alone(peer: Peer, way: str) -> None:
    lead(peer, way)
    peer.refused("SET_ZERO", "BAD_STATE", zero_um=0.0)
