"""Between controller and plant: all that a controller can tell the machine, and all that it can read of it.

A controller is called once a millisecond with these two records, laid out as C structs: it reads `Readings` and sets
`Drive`.
"""

from __future__ import annotations

from edmctl.array_types import Array
from edmctl.core.records import Record, record, series

TICK_S = 0.001
TICK_NS = 1_000_000
DAC_V = 0.0025  # least step of the actuator voltage, about 7 nm of tool travel
STEPS_PER_V = 400.0
MOST_PULSES = 64  # room for those of one tick: 50 kHz is the highest frequency
PATH_LINES = 16  # lines of a path that wait


@record
class Drive(Record):
    """What the controller tells the machine, for the millisecond that comes."""

    actuator_v: float  # on the converter's grid
    pulses_on: int  # the gate of the generator
    generator: int  # mode switch, 1: generator at the gap; 0: contact circuit there
    pulse_starts: int  # so often the gate was opened: with another one the period of the pulses begins anew
    contact_tests: int  # further touches of a touch-off for which the contact circuit was set
    stage_x_um: float  # where the stages are to report to be
    stage_y_um: float
    stage_moves: int  # 1: the stages went along the path in the millisecond that ends
    stage_line: int  # row of the line that they began it on
    stage_lines_done: int  # lines that they came to the end of
    stage_share: float  # share that they went of what was left of the next one
    stage_way_um: float  # way that they went


@record
class Readings(Record):
    """What the machine shows the controller of the millisecond that ended."""

    tick: int  # milliseconds since the machine was set up, with that one
    sensor_um: float  # displacement sensor
    contact: int  # 1: the contact circuit is closed
    monitor_v: float  # voltage monitor of the actuator's amplifier
    gap_v: float  # gap voltage, mean over the pulses; NaN where there is none to measure
    charge_uc: float  # that went through the gap
    generator_siemens: float  # conductance of the generator: current over voltage drop in a discharge
    off_time_a: float  # current that goes on into the off-time
    stray_pulses: int  # that come although the gate is shut
    first_pulse_ns: int  # when the first of the pulses began, since the machine was set up
    pulses: int  # so many entries of the series are of this millisecond
    delay_us: Array = series(MOST_PULSES)  # ignition delay
    discharge_us: Array = series(MOST_PULSES)  # time of current; 0: none
    plateau_v: Array = series(MOST_PULSES)  # gap voltage of the discharge, or of the open gap
    energy_uj: Array = series(MOST_PULSES)  # of the discharge
