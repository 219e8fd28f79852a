"""L15: every status and every fault of the controller can be reached, told, survived and cleared."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tests.conformance import layouts, wire
from tests.conformance.acts import (
    DUTY_V,
    PARK_X_UM,
    WORK_X_UM,
    arm,
    assert_pulses_off,
    clear,
    defaults,
    disarm,
    lead,
    move_x,
    set_parameters,
    settle,
)
from tests.conformance.layouts import Fields
from tests.conformance.peer import STATE_NAMES, STATUS_NAMES, Peer

ESTOP = 4001
ROWS = [row for row in layouts.faults() if row["who"] in ("controller", "both")]
# Statuses that no command of this version needs; the numbers are kept.
RESERVED = {"NOT_CALIBRATED", "BAD_SESSION", "NO_CONTACT", "INTERNAL"}
# Parameters with which a fault comes soon, as wire integers.
SOONER = {"TRAVEL_LIMIT": {"piezo_max_v": 16_000}, "NO_SPARK": {"open_lost_s": 1000}}
# Faults that the line itself can cause: these need no virtual machine.
BY_BYTES = ("HOST_SILENT", "ABORT_RUN", "LINE_NOISE")


def test_l15_every_status_is_reached(peer: Peer) -> None:
    crc = layouts.profile_crc()
    seen = {
        peer.ok("GET_STATUS").status,
        peer.refused("DISARM", "BAD_STATE").status,
        peer.refused("ARM", "PROFILE_MISMATCH", param_crc=crc ^ 1).status,
        peer.refused("GET_PARAM", "OUT_OF_RANGE", param=999).status,
        peer.refused("TLM_START", "RATE_TOO_HIGH", period_us=1, batch=1).status,
    }
    for type_id, payload in ((0x3E, b""), (layouts.NAMES["ARM"], b"\0")):
        reply = peer.reply_to(type_id, peer.send_payload(type_id, payload))
        assert reply is not None
        seen.add(reply.status)
    arm(peer)
    peer.ok("PIEZO_SET", actuator_v=60.0, slew_v_s=600.0)
    peer.event("MOVE_DONE", 5.0)
    seen.add(peer.refused("STAGE_MOVE", "INTERLOCK", axis=0, target=0, speed=1000).status)
    peer.write(wire.ABORT)
    peer.fault(0.5)
    seen.add(peer.refused("CLEAR_FAULT", "BUSY", fault=1002).status)
    seen.add(peer.hello(proto_major=layouts.MAJOR + 1).status)
    names = {STATUS_NAMES[status] for status in seen}
    assert names == set(STATUS_NAMES.values()) - RESERVED, peer.story(f"reached: {sorted(names)}", "delivery")


def cause(peer: Peer, name: str) -> None:
    """Bring a fault about by bytes alone."""
    lead(peer, "machining")
    if name == "HOST_SILENT":
        peer.beating = False
        peer.wait(lambda: peer.faults, 0.6)
        peer.beating = True
    elif name == "ABORT_RUN":
        peer.write(wire.ABORT)
    else:
        for number in range(layouts.PARAMETERS["bad_frames"].default + 2):
            damaged = bytearray(wire.encode(4, number, peer.session))
            damaged[-2] ^= 1
            peer.write(bytes(damaged))
    peer.fault(0.5)


def run_until_fault(peer: Peer, crc: int) -> None:
    """Everything a job does, in turn, until the controller has enough of it."""

    def over() -> bool:
        return bool(peer.faults) or bool(peer.boots)

    def go(name: str, until: str | None = None, within_s: float = 20.0, **values: float) -> bool:
        """Send a command and wait for its event; False once the controller has stopped."""
        if over() or peer.command(name, **values).status != 0:
            peer.wait(over, 1.0)
            return False
        if until:
            peer.wait(lambda: over() or peer.ended(until), within_s)
        return not over()

    def rests() -> bool:
        peer.wait(over, 0.3)  # the displacement that interlocks stages is low-passed
        return not over()

    arm(peer, crc)
    touch = {"fast_um_s": 20.0, "fast_to_um": 5.0, "speed_um_s": 5.0, "z_max_um": 60.0}
    approach = {"speed_um_s": 10.0, "max_travel_um": 60.0, "gap_ref_v": 0.9 * DUTY_V}
    servo = {"gap_ref_v": 0.8 * DUTY_V, "z_limit_um": 500.0, "max_time_s": 100.0}
    _ = (
        go("PULSE_ENABLE", on=1)
        and go("SELF_TEST", "TEST_DONE", 3.0)
        and go("PIEZO_SET", "MOVE_DONE", actuator_v=15.0, slew_v_s=300.0)
        and go("PIEZO_SET", "MOVE_DONE", actuator_v=0.0, slew_v_s=300.0)
        and rests()
        and go("STAGE_MOVE", "STAGE_DONE", axis=0, target=round(WORK_X_UM * 1000), speed=10_000_000)
        and go("TOUCH_OFF", "TOUCH_DONE", **touch, back_off_um=5.0, dwell_s=0.1, touches=2)
        and go("PIEZO_SET", "MOVE_DONE", actuator_v=0.0, slew_v_s=300.0)
        and go("APPROACH", "APPROACH_DONE", **approach)
        and go("SERVO_START", "CUT_DONE", 100.0, **servo)
    )
    if not over():
        peer.wait(over, 20.0)


def assert_latched_and_clears(peer: Peer, row: Fields) -> None:
    code = row["code"]
    assert peer.faults, peer.story(f"{row['name']} was not told", "faults")
    assert peer.faults[0]["code"] == code, peer.story(
        f"{row['name']}: fault {peer.faults[0]['code']}", "faults"
    )
    status = peer.ok("GET_STATUS")
    assert STATE_NAMES[status.state] == ("ESTOP" if code == ESTOP else "FAULT")
    assert_pulses_off(peer)
    peer.pump(1.0 if peer.exact else 0.3)
    if peer.line.bench is not None:
        peer.line.bench.clear_injections()
    assert peer.ok("GET_STATUS").fault == code, peer.story("the fault is not latched", "faults")
    clear(peer)
    assert peer.state() == "IDLE"
    defaults(peer)
    arm(peer)
    disarm(peer)


@pytest.mark.parametrize("name", BY_BYTES)
def test_l15_a_fault_of_the_line_is_reached_by_bytes(peer: Peer, name: str) -> None:
    cause(peer, name)
    assert_latched_and_clears(peer, next(row for row in ROWS if row["name"] == name))


@pytest.mark.parametrize(
    "row",
    [r for r in ROWS if r["name"] not in BY_BYTES],
    ids=[r["name"] for r in ROWS if r["name"] not in BY_BYTES],
)
def test_l15_every_fault_of_the_controller_is_reached(
    over_work: Peer, inject: Callable[[str], None], row: Fields
) -> None:
    peer = over_work
    inject(row["name"])
    run_until_fault(peer, set_parameters(peer, **SOONER.get(row["name"], {})))
    if row["name"] == "RESET":
        assert peer.boots, peer.story("no BOOT after a reset", "session")
        assert peer.hello().fault == row["code"], peer.story("the reset is not latched", "faults")
        clear(peer)
        return
    assert_latched_and_clears(peer, row)
    settle(peer)
    assert peer.ok("GET_STATUS").x_um == PARK_X_UM


def test_l15_a_repaired_machine_works_again(over_work: Peer, inject: Callable[[str], None]) -> None:
    peer = over_work
    inject("DOOR@arm+0.05")
    arm(peer)
    peer.fault(1.0)
    peer.line.bench.clear_injections()
    peer.pump(0.5)
    clear(peer)
    arm(peer)
    move_x(peer, WORK_X_UM)
    assert peer.state() == "ARMED"
