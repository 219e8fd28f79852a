"""Parts 2 and 3, with the high voltage on: interlocks while armed, stages, and the actuator without pulses."""

from __future__ import annotations

from functools import partial
from statistics import fmean, linear_regression

from edmctl.board.first_start.checklist import (
    NETS,
    NOT_FITTED,
    Checklist,
    Finding,
    Skip,
    check,
    mistake,
    wrong,
)
from edmctl.board.first_start.cold import GAP_ZERO_V, NETS_OF, names_of
from edmctl.dataclasses import dataclass
from edmctl.errors import MachineFault
from edmctl.link.faults import FaultCode
from edmctl.machine.faults import InterlockOpen
from edmctl.machine.interface import Axis, Interlock, MachineState
from edmctl.procedures.settings import motion_settings
from edmctl.wording import decimal, signed

STAGE_MOVE = {Axis.X: 1000.0, Axis.Y: 1000.0, Axis.THETA: 5.0}
"""µm, and degrees of theta."""
SWITCHED_S = 0.3
SAFE_UM = 20.0

SMALL_V = (0.5, 1.0, 1.5, 2.0)
"""A monitor that is reversed is off by 4 V at the last: the controller gives up at 4.5 V."""
LARGE_V = (5.0, 10.0, 20.0, 40.0, 20.0, 10.0, 0.0)
SLEW_V_S, STEP_S = 20.0, 0.3
DEAD = 0.1
"""A slope below this share of the expected one counts as none."""
MONITOR_GAIN, MONITOR_OFFSET_V, MONITOR_STEP_V = 0.05, 1.5, 1.5
SMALL_GAIN, LARGE_GAIN = (0.25, 1.6), (0.5, 1.4)
"""Shares of the setup's gain, which is that of the whole stroke: hysteresis reduces it for small steps."""
BACK_UM = 10.0


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


@dataclass(frozen=True, slots=True)
class Step:
    """Mean readings at one voltage."""

    command_v: float
    monitor_v: float
    displacement_um: float


def _step_through(c: Checklist, voltages: tuple[float, ...]) -> list[Step]:
    """Arm without pulses, step through the voltages and back; return the readings at 0 V and at each."""
    safe_um = c.resting_um() + SAFE_UM
    c.machine.configure(motion_settings(c.setup, safe_um, sensor_fitted=c.setup.sensor.fitted, pulses=True))
    c.machine.arm(pulses=False)
    steps: list[Step] = []
    for voltage in (0.0, *voltages):
        if steps:
            c.machine.ramp(voltage, min(SLEW_V_S, c.setup.actuator.slew_v_s))
        c.machine.rest(STEP_S)
        readings = c.read()
        monitor_v = fmean(status.monitor_v for status in readings)
        steps.append(Step(voltage, monitor_v, fmean(status.displacement_um for status in readings)))
    c.machine.disarm()
    return steps


def _line(steps: list[Step], name: str) -> tuple[float, float]:
    """Return slope and offset of a reading over the command."""
    slope, offset = linear_regression([s.command_v for s in steps], [getattr(s, name) for s in steps])
    return slope, offset


@check("amplifier-on", volts=MONITOR_OFFSET_V, um=BACK_UM)
def amplifier_on(c: Checklist) -> Finding:
    c.allow("actuator")
    before_um = c.mean("displacement_um")
    c.act("amplifier-on")
    readings = c.read()
    monitor_v = fmean(status.monitor_v for status in readings)
    way_um = fmean(status.displacement_um for status in readings) - before_um
    read = f"monitor {decimal(monitor_v)} V, sensor {signed(way_um)} µm from before"
    if abs(way_um) > BACK_UM:
        return wrong(read, "amplifier_moves")
    return wrong(read, "amplifier_offset") if abs(monitor_v) > MONITOR_OFFSET_V else Finding(read)


@check("drive")
def drive(c: Checklist) -> Finding:
    steps = c.kept["steps"] = _step_through(c, SMALL_V)
    monitor, displacement = _line(steps, "monitor_v")[0], _line(steps, "displacement_um")[0]
    read = f"monitor {signed(monitor)} V/V, sensor {signed(displacement)} µm/V"
    dead = DEAD * c.setup.actuator.gain_um_per_v
    follows = abs(monitor) >= DEAD or (c.setup.sensor.fitted and abs(displacement) >= dead)
    return Finding(read) if follows else wrong(read, "drive_dead")


@check("monitor", gain=MONITOR_GAIN, volts=MONITOR_OFFSET_V)
def monitor(c: Checklist) -> Finding:
    gain, offset_v = _line(c.kept["steps"], "monitor_v")
    read = f"gain {signed(gain)}, offset {signed(offset_v)} V"
    if abs(gain - 1.0) <= MONITOR_GAIN:
        return Finding(read) if abs(offset_v) <= MONITOR_OFFSET_V else wrong(read, "monitor_offset")
    if abs(gain) < DEAD:
        return wrong(read, "monitor_dead")
    return wrong(read, "monitor_reversed" if gain < 0.0 else "monitor_scale", gain=gain)


@check("displacement", share=SMALL_GAIN)
def displacement(c: Checklist) -> Finding:
    if not c.setup.sensor.fitted:
        raise Skip(NOT_FITTED, absent=True)
    gain = c.setup.actuator.gain_um_per_v
    share = _line(c.kept["steps"], "displacement_um")[0] / gain
    read = f"{signed(share * gain)} µm/V, {decimal(share)} of the setup's"
    if SMALL_GAIN[0] <= share <= SMALL_GAIN[1]:
        return Finding(read)
    if abs(share) < DEAD:
        return wrong(read, "displacement_dead")
    return wrong(read, "displacement_reversed" if share < 0.0 else "displacement_scale")


@check("range", volts=MONITOR_STEP_V, um=BACK_UM, share=LARGE_GAIN)
def full_range(c: Checklist) -> Finding:
    steps = _step_through(c, tuple(v for v in LARGE_V if v <= c.setup.actuator.stroke_v))
    worst_v = max((step.monitor_v - step.command_v for step in steps), key=abs)
    read = f"monitor {signed(worst_v)} V off at most"
    causes = [mistake("monitor_bends")] if abs(worst_v) > MONITOR_STEP_V else []
    if c.setup.sensor.fitted:
        top, gain = max(steps, key=lambda step: step.command_v), c.setup.actuator.gain_um_per_v
        slope = (top.displacement_um - steps[0].displacement_um) / top.command_v
        back_um = steps[-1].displacement_um - steps[0].displacement_um
        share = slope / gain
        read += f"; sensor {signed(slope)} µm/V, {decimal(share)} of the setup's, {signed(back_um)} µm after"
        if not LARGE_GAIN[0] <= share <= LARGE_GAIN[1] or abs(back_um) > BACK_UM:
            causes.append(mistake("displacement_setup"))
    return Finding(read, tuple(causes))
