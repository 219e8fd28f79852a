"""Part 2, with the high voltage on and neither actuator nor pulses: interlocks while armed, and the stages."""

from __future__ import annotations

from functools import partial

from edmctl.board.first_start.checklist import NETS, Checklist, Finding, Skip, check, mistake, wrong
from edmctl.board.first_start.cold import GAP_ZERO_V, NETS_OF, names_of
from edmctl.errors import MachineFault
from edmctl.link.faults import FaultCode
from edmctl.machine.faults import InterlockOpen
from edmctl.machine.interface import Axis, Interlock, MachineState
from edmctl.procedures.settings import motion_settings
from edmctl.wording import decimal

STAGE_MOVE = {Axis.X: 1000.0, Axis.Y: 1000.0, Axis.THETA: 5.0}
"""µm, and degrees of theta."""
SWITCHED_S, SAFE_UM = 0.3, 20.0


@check("supply-on", volts=GAP_ZERO_V)
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
        causes.append(mistake("supply_input_open"))
    if others:
        causes.append(mistake("supply_changes", *others, others=" and ".join(others)))
    if abs(after_v - before_v) >= GAP_ZERO_V:
        causes.append(mistake("gap_energised"))
    return Finding(read, tuple(causes))


@check("idle")
def idle(c: Checklist) -> Finding:
    status = c.machine.readings()
    if status.fault == FaultCode.ESTOP:
        c.machine.clear_fault(status.fault)
    status = c.machine.readings()
    read = f"state {status.state.name}, fault {status.fault or 'none'}"
    return Finding(read) if status.state is MachineState.IDLE else wrong(read, "fault_unknown")


def _arm(c: Checklist) -> None:
    """Arm without pulses and without the sensor: only stages move."""
    c.machine.configure(motion_settings(c.setup, SAFE_UM, sensor_fitted=False, pulses=True))
    c.machine.arm(pulses=False)


@check("armed-estop")
def armed_estop(c: Checklist) -> Finding:
    return _interlock_while_armed(c, "estop-press", "estop-release", FaultCode.ESTOP, NETS["estop"])


@check("armed-door")
def armed_door(c: Checklist) -> Finding:
    return _interlock_while_armed(c, "door-open", "door-close", FaultCode.DOOR, NETS["door"])


def _interlock_while_armed(c: Checklist, open_by: str, close_by: str, code: FaultCode, net: str) -> Finding:
    _arm(c)
    try:
        c.act(open_by)
        status = c.machine.readings()
    finally:
        c.machine.safe_stop()
    _restore(c, close_by, status.fault)
    read = f"state {status.state.name}, fault {status.fault or 'none'}"
    return Finding(read) if status.fault == code else wrong(read, "not_stopped", net)


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


@check("stages")
def stages(c: Checklist) -> Finding:
    return c.allow("stages")


@check("limit")
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
    return wrong("the stage moved", "limit_ignored")


def _direction(c: Checklist, axis: Axis) -> Finding:
    name = axis.name.lower()
    speed = c.setup.stage.rotary_deg_s if axis is Axis.THETA else c.setup.stage.speed_um_s
    status = c.machine.readings()
    home = {Axis.X: status.x_um, Axis.Y: status.y_um, Axis.THETA: status.theta_deg}[axis]

    def move(target: float) -> None:
        _arm(c)
        c.machine.move_stage(axis, target, speed)
        c.machine.disarm()  # a person looks at the stage next

    move(home + STAGE_MOVE[axis])
    try:
        answer = c.kept[name] = c.ask(f"{name}-direction")
    except Skip:
        move(home)
        raise
    move(home)
    if answer == "plus":
        return Finding("plus")
    if answer == "minus":
        return wrong("minus", "stage_reversed", NETS[f"{name}_direction"])
    if answer == "none":
        return wrong("none", "stage_still", NETS[f"{name}_step"])
    if axis is Axis.Y and c.kept.get("x") == "other":
        raise Skip("reported at: X direction")
    exchanged = {Axis.X: [NETS["y_step"]], Axis.Y: [NETS["x_step"]]}.get(axis, [])
    return wrong("another axis", "stages_exchanged", NETS[f"{name}_step"], *exchanged)


for _axis in Axis:
    check(f"{_axis.name.lower()}-direction")(partial(_direction, axis=_axis))
