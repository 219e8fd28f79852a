"""High voltage on, neither actuator nor pulses: interlocks of an armed machine, and which way the stages go."""

from __future__ import annotations

from functools import partial

from edmctl.board.first_start import nets
from edmctl.board.first_start.checklist import Checklist, Found, Skip, Spec, wrong
from edmctl.board.first_start.cold import COLD, GAP_ZERO_V, NETS_OF, gap_v
from edmctl.board.first_start.nets import cause
from edmctl.errors import MachineFault
from edmctl.link.faults import FaultCode
from edmctl.machine.faults import INTERLOCKS, InterlockOpen
from edmctl.machine.interface import Axis, Interlock, MachineState
from edmctl.procedures.settings import motion_settings
from edmctl.wording import decimal

PART = "high voltage on, stages"
STAGE_MOVE = {Axis.X: 1000.0, Axis.Y: 1000.0, Axis.THETA: 5.0}
SWITCHED_S = 0.3
SAFE_UM = 20.0

SUPPLY = Spec(
    "supply-on",
    "high voltage on",
    "The supply was switched on; inputs and gap voltage were read.",
    f"its input closes and no other changes; the gap voltage changes by less than {GAP_ZERO_V:g} V",
    (*COLD, "monitor-rest", "displacement-rest"),
)
CLEARED = Spec(
    "idle",
    "controller idle",
    "The fault of the e-stop test was cleared.",
    "state IDLE",
    ("supply-on",),
)
CHAIN_ESTOP = Spec(
    "armed-estop",
    "e-stop while armed",
    "Armed without pulses; the e-stop was pressed and released.",
    "fault 4001, state ESTOP",
    ("idle",),
)
CHAIN_DOOR = Spec(
    "armed-door",
    "door while armed",
    "Armed without pulses; the door was opened and closed.",
    "fault 4002, state FAULT",
    ("armed-estop",),
)
LIMIT = Spec(
    "limit",
    "limit switches",
    "A limit switch was held closed; X was told to move by 0.1 mm.",
    "fault 2004",
    ("idle", "stages"),
)
STAGES = Spec("stages", "stages allowed", "The moves were asked for.", "yes", ("armed-estop", "armed-door"))
AXES = {
    axis: Spec(
        f"{axis.name.lower()}-direction",
        f"{axis.name if axis is not Axis.THETA else 'theta'} direction",
        f"It moved by +{STAGE_MOVE[axis] / 1000.0:g} mm and back."
        if axis is not Axis.THETA
        else f"It turned by +{STAGE_MOVE[axis]:g} degrees and back.",
        "towards plus",
        ("stages",),
    )
    for axis in Axis
}


def look(c: Checklist) -> None:
    """Switch the high voltage on; interlocks while armed, and the stages."""
    c.part = PART
    c.item(SUPPLY, partial(_supply_on, c))
    c.item(CLEARED, partial(_cleared, c))
    c.item(CHAIN_ESTOP, partial(_armed, c, "estop-press", "estop-release", FaultCode.ESTOP, nets.ESTOP))
    c.item(CHAIN_DOOR, partial(_armed, c, "door-open", "door-close", FaultCode.DOOR, nets.DOOR))
    c.item(STAGES, partial(c.allow, "stages"))
    c.item(LIMIT, partial(_limit, c))
    _directions(c)


def _supply_on(c: Checklist) -> Found:
    before, before_v = c.machine.readings().interlocks, gap_v(c)
    c.allow("high-voltage")
    c.act("supply-on")
    c.machine.pass_time(SWITCHED_S)
    after, after_v = c.machine.readings().interlocks, gap_v(c)
    others = [NETS_OF[bit] for bit in Interlock if bit in (before ^ after) & ~Interlock.HV_SUPPLY]
    open_now = ", ".join(name for bit, (name, _, _) in INTERLOCKS.items() if bit in after) or "none"
    read = f"open inputs {open_now}; gap {decimal(before_v)} V before, {decimal(after_v)} V after"
    causes = []
    if Interlock.HV_SUPPLY in after:
        text = (
            "the input stays open with the supply on: wire off, the supply reports a failure, or the guard of the "
            "mode switch, which does not stand where it is told"
        )
        causes.append(cause(text, nets.SUPPLY_OK, nets.MODE))
    if others:
        causes.append(cause(f"{' and '.join(others)} changed with the supply", nets.SUPPLY_OK, *others))
    if abs(after_v - before_v) >= GAP_ZERO_V:
        text = (
            "voltage at the gap though nothing permits it: the gate is stuck on, and the generator comes past the "
            "mode switch; switch the supply off"
        )
        causes.append(cause(text, nets.GATE, nets.MODE))
    return Found(read, tuple(causes))


def _cleared(c: Checklist) -> Found:
    status = c.machine.readings()
    if status.fault == FaultCode.ESTOP:
        c.machine.clear_fault(status.fault)
    status = c.machine.readings()
    read = f"state {status.state.name}, fault {status.fault or 'none'}"
    if status.state is MachineState.IDLE:
        return Found(read)
    return wrong(read, "a fault is latched that this list has not caused: `edmctl reset` tells which")


def _still(c: Checklist) -> None:
    """Arm without pulses and without the sensor: only stages move."""
    c.machine.configure(motion_settings(c.setup, SAFE_UM, sensor_fitted=False, pulses=True))
    c.machine.arm(pulses=False)


def _armed(c: Checklist, open_by: str, close_by: str, code: FaultCode, net: str) -> Found:
    _still(c)
    try:
        c.act(open_by)
        status = c.machine.readings()
    finally:
        c.machine.safe_stop()
    _put_back(c, close_by, status.fault)
    read = f"state {status.state.name}, fault {status.fault or 'none'}"
    if status.fault == code:
        return Found(read)
    return wrong(read, "an armed machine does not stop for it", net)


def _put_back(c: Checklist, close_by: str, fault: int) -> None:
    """Have that put back which has brought a fault about, and clear the fault, also where the act is skipped.

    Raises Skip; with what is to be done where the fault is still latched.
    """
    skipped: Skip | None = None
    try:
        c.act(close_by)
    except Skip as left_out:
        skipped = left_out
    if fault:
        try:
            c.machine.clear_fault(fault)
        except InterlockOpen as still:
            if skipped is None:
                raise
            raise Skip(f"{skipped.reason}; {still.message} {still.hint}") from still
    if skipped is not None:
        raise skipped


def _limit(c: Checklist) -> Found:
    c.act("limit-close")
    _still(c)
    try:
        c.machine.move_stage(Axis.X, c.machine.readings().x_um + 100.0, c.setup.stage.speed_um_s)
    except MachineFault as error:
        if error.fault != FaultCode.STAGE_LIMIT:
            raise
        c.machine.safe_stop()
        _put_back(c, "limit-open", error.fault)
        return Found(f"refused, fault {error.fault:d}")
    c.machine.disarm()
    c.act("limit-open")
    text = "a stage moves with its limit switch closed: wire bridged, or contacts the wrong way round"
    return wrong("the stage moved", text, nets.LIMITS)


def _directions(c: Checklist) -> None:
    """Move every axis and ask; two exchanged axes are one mistake."""
    seen: dict[Axis, str] = {}
    for axis, spec in AXES.items():
        if axis is Axis.Y and seen.get(Axis.X) == "other":
            seen[axis] = ""
            found = partial(_direction, c, axis, seen)
            c.item(spec, lambda found=found: _with_x(found(), seen))  # type: ignore[misc]
            continue
        c.item(spec, partial(_direction, c, axis, seen))


def _with_x(found: Found, seen: dict[Axis, str]) -> Found:
    """Skip Y if X has moved another stage: it is the same mistake."""
    if seen[Axis.Y] == "other":
        raise Skip("told at: X direction")
    return found


def _back(c: Checklist, axis: Axis, home: float, speed: float) -> None:
    _still(c)
    c.machine.move_stage(axis, home, speed)
    c.machine.disarm()


def _direction(c: Checklist, axis: Axis, seen: dict[Axis, str]) -> Found:
    speed = c.setup.stage.rotary_deg_s if axis is Axis.THETA else c.setup.stage.speed_um_s
    status = c.machine.readings()
    home = {Axis.X: status.x_um, Axis.Y: status.y_um, Axis.THETA: status.theta_deg}[axis]
    _still(c)
    c.machine.move_stage(axis, home + STAGE_MOVE[axis], speed)
    c.machine.disarm()  # nobody is armed while a person looks
    try:
        seen[axis] = answer = c.answer(f"{axis.name.lower()}-direction")
    except Skip:
        _back(c, axis, home, speed)
        raise
    _back(c, axis, home, speed)
    step, direction = nets.STEPS[axis], nets.DIRECTIONS[axis]
    if answer == "plus":
        return Found("plus")
    if answer == "minus":
        return wrong("minus", "the direction is inverted: swap the motor's pair, or its input", direction)
    if answer == "none":
        return wrong("none", "no steps arrive: wire off, or the drive has no supply or no enable", step)
    everyone = [
        nets.STEPS[other] for other in (Axis.X, Axis.Y) if other is not axis and axis is not Axis.THETA
    ]
    text = "the steps go to the drive of another axis: exchanged"
    return wrong("another axis", text, step, *everyone)
