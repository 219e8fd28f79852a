"""What tests do with a controller: bring it to rest, arm it, and lead it into every state."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from tests.conformance import layouts
from tests.conformance.peer import STATE_NAMES, STATUS, Peer

OPEN_V, ON_US, OFF_US = 40.0, 130.435, 304.348
DUTY_V = OPEN_V * ON_US / (ON_US + OFF_US)
PARK_X_UM, WORK_X_UM = -5000.0, 0.0
LATCHED = ("FAULT", "ESTOP")


def settle(peer: Peer) -> None:
    """Open a session and bring the controller into IDLE with the default parameters, whatever it was at."""
    peer.hello()
    clear(peer)
    if peer.state() != "IDLE":
        rest(peer)
    peer.ok("TLM_STOP")
    defaults(peer)
    if peer.line.bench is not None and peer.ok("GET_STATUS").x_um != PARK_X_UM:
        peer.pump(0.3)  # the displacement that interlocks stages is low-passed
        arm(peer)
        move_x(peer, PARK_X_UM)
        disarm(peer)
    peer.fresh_beat()
    peer.forget()


def clear(peer: Peer) -> None:
    """Clear whatever fault is latched, waiting for the retreat; forget the FAULT that told it."""
    for _ in range(200):
        status = peer.ok("GET_STATUS")
        if STATE_NAMES[status.state] not in LATCHED:
            break
        reply = peer.command("CLEAR_FAULT", fault=status.fault)
        if reply.status == STATUS["BUSY"]:
            peer.pump(0.05)
    else:
        raise AssertionError(peer.story("the fault cannot be cleared", "safe-state-and-watchdog"))
    peer.pump(0.01)
    peer.forget()


def rest(peer: Peer) -> None:
    """Stop what runs and disarm."""
    peer.command("STAGE_STOP")
    peer.command("SERVO_STOP")
    peer.command("DISARM")
    assert peer.wait(lambda: peer.fresh_beat()["state"] == layouts.enum("State")["IDLE"], 10.0), peer.story(
        "DISARM does not lead to IDLE", "states"
    )


def defaults(peer: Peer) -> None:
    """Make the default parameters and a known generator setting current."""
    crc = layouts.profile_crc()
    if peer.command("COMMIT_PROFILE", crc=crc).status != STATUS["OK"]:
        for p in layouts.PARAMETERS.values():
            peer.ok("SET_PARAM", param=p.id, value=p.default)
        peer.ok("COMMIT_PROFILE", crc=crc)
    peer.ok(
        "PULSE_CONFIG",
        on_time_us=ON_US,
        off_time_us=OFF_US,
        open_voltage_v=OPEN_V,
        peak_current_a=0.12,
    )


def set_parameters(peer: Peer, **counts: int) -> int:
    """Make these parameters (wire integers) current, all others at their defaults; returns the check."""
    for name, count in counts.items():
        peer.ok("SET_PARAM", param=layouts.PARAMETERS[name].id, value=count)
    crc = layouts.profile_crc(counts)
    peer.ok("COMMIT_PROFILE", crc=crc)
    return crc


def arm(peer: Peer, crc: int | None = None) -> None:
    """ARM on the given check, by default that of the default parameters."""
    peer.ok("ARM", param_crc=layouts.profile_crc() if crc is None else crc)


def disarm(peer: Peer) -> None:
    """DISARM and wait for IDLE."""
    peer.ok("DISARM")
    peer.event("MOVE_DONE", 10.0)


def move_x(peer: Peer, x_um: float) -> None:
    """Move the x axis and wait until it rests."""
    peer.ok("STAGE_MOVE", axis=layouts.enum("Axis")["X"], target=round(x_um * 1000), speed=10_000_000)
    peer.event("STAGE_DONE", 10.0)


def assert_pulses_off(peer: Peer) -> None:
    """Fail where the newest sample still has pulses on."""
    peer.pump(0.002)  # flags are those of the newest sample, which may be a millisecond old
    flags = peer.ok("GET_STATUS").flags
    assert not flags & layouts.enum("TlmFlags")["PULSES_ON"], peer.story(
        "pulses on in FAULT", "safe-state-and-watchdog"
    )


def start_sparks(peer: Peer, **servo: Any) -> None:
    """From IDLE to a running cut: arm, over the work, approach, servo."""
    arm(peer)
    peer.ok("PULSE_ENABLE", on=1)
    move_x(peer, WORK_X_UM)
    peer.ok("APPROACH", speed_um_s=10.0, max_travel_um=120.0, gap_ref_v=0.9 * DUTY_V)
    peer.event("APPROACH_DONE", 60.0)
    given = {"gap_ref_v": 0.8 * DUTY_V, "z_limit_um": 500.0, "max_time_s": 3000.0} | servo
    peer.ok("SERVO_START", **given)


# Each leads an IDLE controller into one state, away from any work and for some seconds at least.
def _to_idle(peer: Peer) -> None:
    pass


def _to_armed(peer: Peer) -> None:
    arm(peer)


def _to_ramp(peer: Peer) -> None:
    arm(peer)
    peer.ok("PIEZO_SET", actuator_v=60.0, slew_v_s=5.0)


def _to_stage(peer: Peer) -> None:
    arm(peer)
    x_um = peer.ok("GET_STATUS").x_um
    peer.ok("STAGE_MOVE", axis=0, target=round((x_um - 500.0) * 1000), speed=50_000)


def _to_touch(peer: Peer) -> None:
    arm(peer)
    values = {"fast_um_s": 2.0, "fast_to_um": 10.0, "speed_um_s": 1.0, "z_max_um": 100.0}
    peer.ok("TOUCH_OFF", **values, back_off_um=5.0, dwell_s=0.3, touches=1)


def _to_approach(peer: Peer) -> None:
    arm(peer)
    peer.ok("PULSE_ENABLE", on=1)
    peer.ok("APPROACH", speed_um_s=1.0, max_travel_um=100.0, gap_ref_v=0.9 * DUTY_V)


def servo_start(peer: Peer, **servo: Any) -> None:
    """From ARMED with pulses enabled to a cut that lasts, away from any work."""
    given = {"gap_ref_v": 0.8 * DUTY_V, "z_limit_um": 100.0, "max_time_s": 60.0} | servo
    peer.ok("SERVO_START", **given)


def start_pulses(peer: Peer, **servo: Any) -> None:
    """From IDLE to a cut away from any work, whose pulses are all open."""
    arm(peer)
    peer.ok("PULSE_ENABLE", on=1)
    servo_start(peer, **servo)


def _to_machining(peer: Peer) -> None:
    start_pulses(peer)


def scan_start(peer: Peer, **scan: Any) -> None:
    """From ARMED to a scan that holds the tool a little below where it is."""
    given = {"gap_ref_v": 0.8 * DUTY_V, "z_limit_um": 5.0, "max_time_s": 60.0} | scan
    peer.ok("SCAN_START", **given)


def line_to(x_um: float, y_um: float, **line: Any) -> dict[str, Any]:
    """Values of a PATH_MOVE."""
    return {"x_um": x_um, "y_um": y_um, "speed_um_s": 200.0, "z_limit_um": 5.0} | line


def _to_scan(peer: Peer) -> None:
    arm(peer)
    peer.ok("PULSE_ENABLE", on=1)
    scan_start(peer)
    status = peer.ok("GET_STATUS")
    peer.ok("PATH_MOVE", **line_to(status.x_um - 100.0, status.y_um, speed_um_s=10.0))


def _to_jump(peer: Peer) -> None:
    arm(peer)
    peer.ok("JUMP", height_um=1.0, speed_um_s=50.0, dwell_s=5.0, clearance_um=0.0)


def _to_fault(peer: Peer) -> None:
    peer.write(bytes(8))
    peer.fault(0.5)


ARMED_STATES: dict[str, tuple[str, Callable[[Peer], None]]] = {
    "armed": ("ARMED", _to_armed),
    "ramp": ("MOVING", _to_ramp),
    "stage": ("MOVING", _to_stage),
    "touch": ("TOUCH", _to_touch),
    "approach": ("APPROACH", _to_approach),
    "machining": ("MACHINING", _to_machining),
    "scan": ("MACHINING", _to_scan),
    "jump": ("JUMP", _to_jump),
}
EVERY_STATE: dict[str, tuple[str, Callable[[Peer], None]]] = {
    "idle": ("IDLE", _to_idle),
    **ARMED_STATES,
    "fault": ("FAULT", _to_fault),
}


def lead(peer: Peer, way: str) -> None:
    """Lead the controller into a state and make sure that it is there."""
    state, act = EVERY_STATE[way]
    act(peer)
    found = peer.state()
    assert found == state, peer.story(f"state {found} instead of {state}", "states")
