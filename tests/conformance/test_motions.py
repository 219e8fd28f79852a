"""L32: what a motion does that meets the work, or cannot tell where it is."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import pytest

from tests.conformance import layouts
from tests.conformance.acts import DUTY_V, WORK_X_UM, arm, move_x, set_parameters
from tests.conformance.layouts import Fields
from tests.conformance.peer import STATE, STATUS, Peer

NO_CONTACT, COLLISION, SHORT_STUCK, NO_SPARK = 2005, 2007, 3001, 3005
CONTACT = layouts.enum("TlmFlags")["CONTACT"]
TLM = layouts.ANSWERS[layouts.NAMES["TLM"]]


def rows(peer: Peer) -> dict[int, Fields]:
    """Samples of 1 ms by their time, µs."""
    return {
        frame["t0_us"] + 1000 * number: TLM.read_record(record)
        for frame in peer.telemetry
        for number, record in enumerate(frame["records"])
    }


def ramps_to(peer: Peer, actuator_v: float, slew_v_s: float = 1000.0, step_s: float = 0.001) -> bool:
    """PIEZO_SET to its end, looked for every `step_s`; False where a fault ends it."""
    peer.ok("PIEZO_SET", actuator_v=actuator_v, slew_v_s=slew_v_s)
    assert peer.wait(lambda: peer.ended("MOVE_DONE") or peer.faults, 5.0, step_s), peer.story(
        "PIEZO_SET does not end", "motions"
    )
    return not peer.faults


def test_l32_small_ramps_end_at_the_work_as_large_ones_do(over_work: Peer) -> None:
    """A ramp of one millisecond has no other than its last, which is judged too."""
    peer = over_work
    arm(peer)
    move_x(peer, WORK_X_UM)
    peer.ok("TLM_START", period_us=1000, batch=1)
    for volts in range(1, 60):
        if not ramps_to(peer, float(volts)):
            break
    fault = peer.fault(0.5)
    peer.pump(0.05)
    moving = {
        t_us: row["flags"] & CONTACT for t_us, row in rows(peer).items() if row["state"] == STATE["MOVING"]
    }
    before = [t_us for t_us, closed in moving.items() if closed and t_us < fault["t_us"]]
    assert fault["code"] == COLLISION
    assert moving
    assert not before, peer.story(f"contact at {before} us, fault at {fault['t_us']} us", "motions")


def test_l32_a_ramp_towards_the_work_does_not_begin_in_contact(
    peer: Peer, inject: Callable[[str], None]
) -> None:
    arm(peer)
    assert ramps_to(peer, 30.0)
    inject("CONTACT_INVERTED@0")
    peer.pump(0.01)
    for volts in (10.0, 10.0):
        assert ramps_to(peer, volts), peer.story("no way back out of contact", "motions")
    reply = peer.command("PIEZO_SET", actuator_v=11.0, slew_v_s=1000.0)
    assert reply.status == STATUS["OK"]
    assert [f["code"] for f in peer.faults] == [COLLISION], peer.story(
        "FAULT does not come before the reply", "events"
    )
    assert peer.ok("GET_STATUS").actuator_v <= 10.0, peer.story("the tool moved", "motions")


def test_l32_an_approach_does_not_advance_into_a_short(over_work: Peer) -> None:
    """With a reference that no short reaches it stands at the work, until that is a fault."""
    peer = over_work
    arm(peer)
    peer.ok("PULSE_ENABLE", on=1)
    peer.refused("APPROACH", "OUT_OF_RANGE", speed_um_s=10.0, max_travel_um=120.0, gap_ref_v=0.0)
    move_x(peer, WORK_X_UM)
    peer.ok("TLM_START", period_us=1000, batch=14)
    peer.ok("APPROACH", speed_um_s=10.0, max_travel_um=120.0, gap_ref_v=0.005)
    assert peer.fault(20.0)["code"] == SHORT_STUCK
    peer.pump(0.05)
    states, shorted = layouts.enum("State"), layouts.enum("TlmFlags")["SHORTED"]
    volts = [
        (row["flags"] & shorted, row["actuator_v"])
        for _, row in sorted(rows(peer).items())
        if row["state"] == states["APPROACH"]
    ]
    after = [b - a for (flag, a), (_, b) in pairwise(volts) if flag]
    assert len(after) > 2000
    assert max(after) == 0.0, peer.story(f"{sum(map(bool, after))} steps into a short", "motions")


def _touches(peer: Peer) -> None:
    values = {"fast_um_s": 5.0, "fast_to_um": 2_100_000.0, "speed_um_s": 5.0, "z_max_um": 2_147_000.0}
    peer.ok("TOUCH_OFF", **values, back_off_um=5.0, dwell_s=0.3, touches=1)


def _approaches(peer: Peer) -> None:
    peer.ok("PULSE_ENABLE", on=1)
    peer.ok("APPROACH", speed_um_s=5.0, max_travel_um=4_200_000.0, gap_ref_v=0.9 * DUTY_V)
    peer.pump(0.2)


@pytest.mark.parametrize(("begins", "code"), [(_touches, NO_CONTACT), (_approaches, NO_SPARK)])
def test_l32_no_limit_is_beyond_a_displacement_that_has_failed(
    peer: Peer, inject: Callable[[str], None], begins: Callable[[Peer], None], code: int
) -> None:
    arm(peer)
    begins(peer)
    peer.pump(0.1)
    assert not peer.faults
    before_us = peer.fresh_beat()["t_dev_us"]
    inject("SENSOR_OPEN@0")
    fault = peer.fault(0.5)
    assert fault["code"] == code
    assert (fault["t_us"] - before_us) % 2**32 <= 5000 or not peer.exact


@pytest.mark.parametrize("limit_v_s", [33.333, 337.25, 1000.0, 20_000.0])
def test_l32_a_ramp_is_slew_limited_where_it_asks_for_more_alone(peer: Peer, limit_v_s: float) -> None:
    """What rounding makes of a step of the sum is no more."""
    more_v_s = limit_v_s + 0.001 + 1e-6 * limit_v_s  # a board may reckon with 24 bits
    slew_limited = layouts.enum("TlmFlags")["SLEW_LIMITED"]
    arm(peer, set_parameters(peer, slew_limit_v_s=round(1000 * limit_v_s)))
    peer.ok("TLM_START", period_us=1000, batch=10)
    for slew_v_s, limited in ((limit_v_s, 0), (limit_v_s - 0.001, 0), (more_v_s, slew_limited)):
        for target_v in (100.0, 3.0):
            peer.telemetry.clear()
            assert ramps_to(peer, target_v, slew_v_s, 0.01)
            peer.pump(0.02)
            moving = [row for row in rows(peer).values() if row["state"] == STATE["MOVING"]]
            assert len(moving) >= 0.096 / (1e-3 * limit_v_s)
            # In the last millisecond it asks for what is left.
            flags = {row["flags"] & slew_limited for row in moving[:-1]}
            assert flags == {limited}, peer.story(f"SLEW_LIMITED at {slew_v_s} V/s", "the-millisecond")
