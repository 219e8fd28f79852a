"""The machine at 1 kHz with its every pulse: plant and controller, compiled or in C, by turns in one loop.

A tick is 1 ms: the controller commands, the plant lives through it, the controller judges, the plant follows.
Compiled by numba, readable as plain Python.
"""

from __future__ import annotations

from collections.abc import Sequence

from edmctl.actuator.compiling import cached
from edmctl.array_types import Array
from edmctl.simulator.controller_kernel import judge_tick
from edmctl.simulator.controller_state import NOTHING, LoopState, Settings
from edmctl.simulator.gap_monitor import close_block
from edmctl.simulator.plant_interface import Drive, Readings
from edmctl.simulator.plant_kernel import follow_drive, plant_tick
from edmctl.simulator.plant_state import PlantState, Scope, Unit
from edmctl.simulator.records import Rows
from edmctl.simulator.servo import command_tick

LOOK = 99
"""Happened beside what the controller reports: the stages moved or the sheet gave way, and the plant should look."""


@cached
def run(
    ticks: int,
    units: Sequence[Unit],
    plants: Sequence[PlantState],
    scopes: Sequence[Scope],
    random: Array,
    tables: Array,
    noise: Array,
    levels: Array,
    all_drives: Sequence[Drive],
    all_readings: Sequence[Readings],
    all_settings: Sequence[Settings],
    loops: Sequence[LoopState],
    box: Array,
    samples: Rows,
    blocks: Rows,
    pulses: Rows,
) -> int:
    """Advance by up to `ticks` ms; stops early when something happened and says what.

    The caller provides `random` columns for every pulse and `noise` for every tick (two each, and touches).
    Zero ticks close the pulse block begun, for whoever wants to send everything now. `box`, shape
    (BOX_TICKS, BOX_COLUMNS), is the ring of the last milliseconds; `levels` the table of what lies under the tool.
    """
    unit, plant, scope, drive, readings = units[0], plants[0], scopes[0], all_drives[0], all_readings[0]
    settings, loop = all_settings[0], loops[0]
    if ticks == 0:
        close_block(loop, blocks)
    for _ in range(ticks):
        command_tick(settings, loop, drive, readings)
        gives_way = plant_tick(unit, plant, scope, drive, readings, random, tables, noise, levels)
        happened = judge_tick(settings, loop, drive, readings, box, samples, blocks, pulses)
        look = follow_drive(unit, plant, drive, noise) or gives_way
        if happened != NOTHING:
            return happened
        if look:
            return LOOK
    return NOTHING
