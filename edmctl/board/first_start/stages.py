"""Part 2, with the high voltage on and neither actuator nor pulses: interlocks while armed, and the stages."""

from __future__ import annotations

from edmctl.board.first_start import nets
from edmctl.board.first_start.checklist import Check, Checklist, Finding, Part, Skip, cause, wrong
from edmctl.board.first_start.cold import COLD, GAP_ZERO_V, NETS_OF, names_of
from edmctl.errors import MachineFault
from edmctl.link.faults import FaultCode
from edmctl.machine.faults import InterlockOpen
from edmctl.machine.interface import Axis, Interlock, MachineState
from edmctl.procedures.settings import motion_settings
from edmctl.wording import decimal

STAGE_MOVE = {Axis.X: 1000.0, Axis.Y: 1000.0, Axis.THETA: 5.0}
SWITCHED_S = 0.3
SAFE_UM = 20.0
PART = Part("high voltage on, stages")


@PART.check(
    "supply-on",
    "high voltage on",
    "The supply was switched on; inputs and gap voltage were read.",
    f"its input closes and no other changes; the gap voltage changes by less than {GAP_ZERO_V:g} V",
    f"{COLD} monitor-rest displacement-rest",
)
def supply_on(c: Checklist) -> Finding:
    before, before_v = c.machine.readings().interlocks, c.mean("gap_v")
    c.allow("high-voltage")
    c.act("supply-on")
    c.machine.pass_time(SWITCHED_S)
    after, after_v = c.machine.readings().interlocks, c.mean("gap_v")
    others = [NETS_OF[bit] for bit in Interlock if bit in (before ^ after) & ~Interlock.HV_SUPPLY]
    read = f"open inputs {names_of(after)}; gap {decimal(before_v)} V before, {decimal(after_v)} V after"
    causes = []
    if Interlock.HV_SUPPLY in after:
        text = (
            "the input stays open with the supply on: wire off, the supply reports a failure, or the guard of the "
            "mode switch, which is not in the position that is set"
        )
        causes.append(cause(text, nets.SUPPLY_OK, nets.MODE))
    if others:
        causes.append(cause(f"{' and '.join(others)} changed with the supply", nets.SUPPLY_OK, *others))
    if abs(after_v - before_v) >= GAP_ZERO_V:
        text = (
            "voltage at the gap without permission: the gate is stuck on, and the generator comes past the mode "
            "switch; switch the supply off"
        )
        causes.append(cause(text, nets.GATE, nets.MODE))
    return Finding(read, tuple(causes))


@PART.check("idle", "controller idle", "The fault of the e-stop test was cleared.", "state IDLE", "supply-on")
def idle(c: Checklist) -> Finding:
    status = c.machine.readings()
    if status.fault == FaultCode.ESTOP:
        c.machine.clear_fault(status.fault)
    status = c.machine.readings()
    read = f"state {status.state.name}, fault {status.fault or 'none'}"
    if status.state is MachineState.IDLE:
        return Finding(read)
    return wrong(read, "a fault is latched that this list has not caused: `edmctl reset` shows which")


def _arm(c: Checklist) -> None:
    """Arm without pulses and without the sensor: only stages move."""
    c.machine.configure(motion_settings(c.setup, SAFE_UM, sensor_fitted=False, pulses=True))
    c.machine.arm(pulses=False)


def _interlock_while_armed(c: Checklist, open_by: str, close_by: str, code: FaultCode, net: str) -> Finding:
    _arm(c)
    try:
        c.act(open_by)
        status = c.machine.readings()
    finally:
        c.machine.safe_stop()
    _restore(c, close_by, status.fault)
    read = f"state {status.state.name}, fault {status.fault or 'none'}"
    if status.fault == code:
        return Finding(read)
    return wrong(read, "an armed machine does not stop for it", net)


def _restore(c: Checklist, close_by: str, fault: int) -> None:
    """Have a provoked fault's cause removed and clear the fault, also if the action is skipped.

    Raises Skip, with what is to be done if the fault is still latched.
    """
    skipped: Skip | None = None
    try:
        c.act(close_by)
    except Skip as skip:
        skipped = skip
    try:
        if fault:
            c.machine.clear_fault(fault)
    except InterlockOpen as still:
        if skipped is None:
            raise
        raise Skip(f"{skipped.reason}; {still.message} {still.hint}") from still
    if skipped is not None:
        raise skipped


@PART.check(
    "armed-estop",
    "e-stop while armed",
    "Armed without pulses; the e-stop was pressed and released.",
    "fault 4001, state ESTOP",
    "idle",
)
def armed_estop(c: Checklist) -> Finding:
    return _interlock_while_armed(c, "estop-press", "estop-release", FaultCode.ESTOP, nets.ESTOP)


@PART.check(
    "armed-door",
    "door while armed",
    "Armed without pulses; the door was opened and closed.",
    "fault 4002, state FAULT",
    "armed-estop",
)
def armed_door(c: Checklist) -> Finding:
    return _interlock_while_armed(c, "door-open", "door-close", FaultCode.DOOR, nets.DOOR)


@PART.check("stages", "stages allowed", "The moves were asked for.", "yes", "armed-estop armed-door")
def stages(c: Checklist) -> Finding:
    return c.allow("stages")


@PART.check(
    "limit",
    "limit switches",
    "A limit switch was held closed; a move of X by 0.1 mm was commanded.",
    "fault 2004",
    "idle stages",
)
def limit(c: Checklist) -> Finding:
    c.act("limit-close")
    _arm(c)
    try:
        c.machine.move_stage(Axis.X, c.machine.readings().x_um + 100.0, c.setup.stage.speed_um_s)
    except MachineFault as error:
        if error.fault != FaultCode.STAGE_LIMIT:
            raise
        c.machine.safe_stop()
        _restore(c, "limit-open", error.fault)
        return Finding(f"refused, fault {error.fault:d}")
    c.machine.disarm()
    c.act("limit-open")
    text = "a stage moves with its limit switch closed: wire bridged, or contacts the wrong way round"
    return wrong("the stage moved", text, nets.LIMITS)


def _declare(axis: Axis) -> Check:
    name = axis.name if axis is not Axis.THETA else "theta"
    done = f"It moved by +{STAGE_MOVE[axis] / 1000.0:g} mm and back."
    if axis is Axis.THETA:
        done = f"It turned by +{STAGE_MOVE[axis]:g} degrees and back."
    key = f"{axis.name.lower()}-direction"
    return PART.check(key, f"{name} direction", done, "towards plus", "stages")(
        lambda c: _direction(c, axis, key)
    )


for _axis in Axis:
    _declare(_axis)


def _direction(c: Checklist, axis: Axis, key: str) -> Finding:
    speed = c.setup.stage.rotary_deg_s if axis is Axis.THETA else c.setup.stage.speed_um_s
    status = c.machine.readings()
    home = {Axis.X: status.x_um, Axis.Y: status.y_um, Axis.THETA: status.theta_deg}[axis]

    def move(target: float) -> None:
        _arm(c)
        c.machine.move_stage(axis, target, speed)
        c.machine.disarm()  # a person looks at the stage next

    move(home + STAGE_MOVE[axis])
    try:
        answer = c.kept[key] = c.ask(key)
    except Skip:
        move(home)
        raise
    move(home)
    step = nets.STEPS[axis]
    if answer == "plus":
        return Finding("plus")
    if answer == "minus":
        text = "the direction is inverted: swap the motor's pair, or its input"
        return wrong("minus", text, nets.DIRECTIONS[axis])
    if answer == "none":
        return wrong("none", "no steps arrive: wire off, or the drive has no supply or no enable", step)
    if axis is Axis.Y and c.kept.get("x-direction") == "other":
        raise Skip("reported at: X direction")
    exchanged = {Axis.X: [nets.STEPS[Axis.Y]], Axis.Y: [nets.STEPS[Axis.X]]}.get(axis, [])
    text = "the steps go to the drive of another axis: exchanged"
    return wrong("another axis", text, step, *exchanged)
