"""The actuator in steps upwards, without pulses: converter, amplifier, its monitor and the displacement sensor."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from statistics import linear_regression

from edmctl.board.first_start import nets
from edmctl.board.first_start.checklist import Checklist, Found, Spec, mean, wrong
from edmctl.board.first_start.nets import cause
from edmctl.dataclasses import dataclass, replace
from edmctl.procedures.settings import motion_settings
from edmctl.wording import decimal, signed

PART = "actuator"
SMALL_V = (0.5, 1.0, 1.5, 2.0)
"""A monitor that is reversed is off by 4 V at the last: the controller gives up at 4.5 V."""
LARGE_V = (5.0, 10.0, 20.0, 40.0, 20.0, 10.0, 0.0)
SLEW_V_S, STEP_S = 20.0, 0.3
DEAD = 0.1
"""A slope below this share of the expected one is none."""
MONITOR_GAIN, MONITOR_OFFSET_V, MONITOR_STEP_V = 0.05, 1.5, 1.5
SMALL_GAIN, LARGE_GAIN = (0.25, 1.6), (0.5, 1.4)
"""Of the setup's gain, which is that of the whole stroke: hysteresis leaves less of it to small steps."""
BACK_UM = 10.0
SAFE_UM = 20.0

AMPLIFIER = Spec(
    "amplifier-on",
    "amplifier on",
    "The amplifier was switched on at 0 V; monitor and sensor were read.",
    f"the monitor within {MONITOR_OFFSET_V:g} V of 0, the sensor within {BACK_UM:g} µm of before",
    ("idle", "armed-estop", "armed-door", "contact"),
)
_STEPS = ", ".join(f"{v:g}" for v in SMALL_V)
DRIVE = Spec(
    "drive",
    "actuator drive",
    f"Steps to {_STEPS} V; monitor and sensor were read at each.",
    "either of them follows",
    ("amplifier-on",),
)
MONITOR = Spec(
    "monitor",
    "actuator monitor",
    "The same steps.",
    f"gain 1 within {100.0 * MONITOR_GAIN:.0f} %, offset below {MONITOR_OFFSET_V:g} V",
    ("drive",),
)
DISPLACEMENT = Spec(
    "displacement",
    "displacement sensor",
    "The same steps.",
    "more with more voltage",
    ("drive",),
)
RANGE = Spec(
    "range",
    "actuator to 40 V",
    f"Steps to {', '.join(f'{v:g}' for v in LARGE_V)} V.",
    f"the monitor within {MONITOR_STEP_V:g} V at each",
    ("monitor", "displacement"),
)


def look(c: Checklist) -> None:
    """Switch the amplifier on and drive the actuator in steps upwards."""
    c.part = PART
    c.item(AMPLIFIER, partial(_amplifier_on, c))
    steps: list[Step] = []
    c.item(DRIVE, partial(_drive, c, steps))
    c.item(MONITOR, partial(_monitor, steps))
    displacement = _bounded(c, DISPLACEMENT, SMALL_GAIN)
    if c.setup.sensor.fitted or not c.is_right(DRIVE.key):
        c.item(displacement, partial(_displacement, c, steps))
    else:
        c.skip(displacement, "no sensor is fitted by the setup", absent=True)
    full = replace(RANGE, expected=f"{RANGE.expected}; the sensor back within {BACK_UM:g} µm, up")
    c.item(_bounded(c, full, LARGE_GAIN) if c.setup.sensor.fitted else RANGE, partial(_range, c))


def _bounded(c: Checklist, spec: Spec, bounds: tuple[float, float]) -> Spec:
    gain = c.setup.actuator.gain_um_per_v
    low, high = bounds
    text = f"by {low * gain:.2f} to {high * gain:.2f} µm/V ({low:g} to {high:g} of the setup's {gain:g})"
    return replace(spec, expected=f"{spec.expected} {text}")


def _gain_in_words(slope: float, gain: float) -> str:
    return f"{signed(slope)} µm/V, {decimal(slope / gain)} of the setup's"


@dataclass(frozen=True, slots=True)
class Step:
    """Means at one voltage."""

    command_v: float
    monitor_v: float
    displacement_um: float


def _amplifier_on(c: Checklist) -> Found:
    c.allow("actuator")
    before_um = mean([status.displacement_um for status in c.read()])
    c.act("amplifier-on")
    found = c.read()
    monitor_v = mean([status.monitor_v for status in found])
    way_um = mean([status.displacement_um for status in found]) - before_um
    read = f"monitor {decimal(monitor_v)} V, sensor {signed(way_um)} µm from before"
    causes = []
    if abs(monitor_v) > MONITOR_OFFSET_V and not abs(way_um) > BACK_UM:
        causes.append(cause("actuator monitor has an offset: its ground, or its amplifier", nets.MONITOR))
    elif abs(way_um) > BACK_UM:
        text = (
            "the actuator moves at 0 V: the converter is not at 0, or the amplifier's offset; switch it off"
        )
        causes.append(cause(text, nets.DAC))
    return Found(read, tuple(causes))


def _steps(c: Checklist, voltages: tuple[float, ...]) -> list[Step]:
    """Arm without pulses, step through the voltages and back; return the readings of each."""
    fitted = c.setup.sensor.fitted
    rest_um = mean([status.displacement_um for status in c.read()]) if fitted else 0.0
    c.machine.configure(motion_settings(c.setup, rest_um + SAFE_UM, sensor_fitted=fitted, pulses=True))
    c.machine.arm(pulses=False)
    found = [_step(c, 0.0)]
    for voltage in voltages:
        c.machine.ramp(voltage, min(SLEW_V_S, c.setup.actuator.slew_v_s))
        found.append(_step(c, voltage))
    c.machine.disarm()
    return found


def _step(c: Checklist, voltage: float) -> Step:
    c.machine.rest(STEP_S)
    read = c.read()
    return Step(voltage, mean([s.monitor_v for s in read]), mean([s.displacement_um for s in read]))


def _line(steps: list[Step], value: Callable[[Step], float]) -> tuple[float, float]:
    """Return slope and offset of a value over the command."""
    slope, offset = linear_regression([step.command_v for step in steps], [value(step) for step in steps])
    return slope, offset


def _drive(c: Checklist, steps: list[Step]) -> Found:
    steps += _steps(c, SMALL_V)
    monitor = _line(steps, lambda step: step.monitor_v)[0]
    displacement = _line(steps, lambda step: step.displacement_um)[0]
    gain = c.setup.actuator.gain_um_per_v
    read = f"monitor {signed(monitor)} V/V, sensor {signed(displacement)} µm/V"
    if abs(monitor) >= DEAD or (c.setup.sensor.fitted and abs(displacement) >= DEAD * gain):
        return Found(read)
    text = "nothing follows: the converter's wires, the amplifier's input or its supply"
    return wrong(read, text, nets.DAC)


def _monitor(steps: list[Step]) -> Found:
    gain, offset_v = _line(steps, lambda step: step.monitor_v)
    read = f"gain {signed(gain)}, offset {signed(offset_v)} V"
    if abs(gain - 1.0) <= MONITOR_GAIN and abs(offset_v) <= MONITOR_OFFSET_V:
        return Found(read)
    if abs(gain) < DEAD:
        text = "actuator monitor does not follow, and the actuator does: wire off"
    elif gain < 0.0:
        text = "actuator monitor is reversed"
    elif abs(gain - 1.0) > MONITOR_GAIN:
        text = (
            f"actuator monitor reads {gain:.2f} of the voltage: the wrong divider, or gain of the amplifier"
        )
    else:
        text = "actuator monitor has an offset"
    return wrong(read, text, nets.MONITOR)


def _displacement(c: Checklist, steps: list[Step]) -> Found:
    gain = c.setup.actuator.gain_um_per_v
    slope = _line(steps, lambda step: step.displacement_um)[0]
    read = _gain_in_words(slope, gain)
    low, high = SMALL_GAIN
    if low * gain <= slope <= high * gain:
        return Found(read)
    if abs(slope) < DEAD * gain:
        text = "displacement sensor does not follow, and the monitor does: wire off, or it does not look at the tool"
    elif slope < 0.0:
        text = "displacement sensor is reversed: more voltage has to read more displacement, towards the work"
    else:
        text = "displacement sensor has another scale than the setup, or the actuator another gain"
    return wrong(read, text, nets.DISPLACEMENT)


def _range(c: Checklist) -> Found:
    steps = _steps(c, tuple(v for v in LARGE_V if v <= c.setup.actuator.stroke_v))
    worst_v = max((step.monitor_v - step.command_v for step in steps), key=abs)
    top = max(steps, key=lambda step: step.command_v)
    read, causes = f"monitor {signed(worst_v)} V off at most", []
    if abs(worst_v) > MONITOR_STEP_V:
        causes.append(cause("actuator monitor has another gain at more voltage", nets.MONITOR, nets.DAC))
    if c.setup.sensor.fitted:
        gain = c.setup.actuator.gain_um_per_v
        slope = (top.displacement_um - steps[0].displacement_um) / top.command_v
        back_um = steps[-1].displacement_um - steps[0].displacement_um
        read += f"; sensor {_gain_in_words(slope, gain)}, {signed(back_um)} µm after"
        low, high = LARGE_GAIN
        if not low * gain <= slope <= high * gain or abs(back_um) > BACK_UM:
            text = "displacement sensor and setup do not agree: scale, fixing, or actuator.gain_um_per_v"
            causes.append(cause(text, nets.DISPLACEMENT))
    return Found(read, tuple(causes))
