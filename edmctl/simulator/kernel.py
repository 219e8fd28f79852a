"""The machine at 1 kHz with its every pulse: plant and controller, compiled or in C, by turns in one loop.

A tick is 1 ms: the controller commands, the plant lives through it, the controller judges, the plant follows.
Compiled by numba, readable as plain Python.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from numba import types
from numba.extending import intrinsic

from edmctl.actuator.compiling import cached
from edmctl.array_types import Array
from edmctl.simulator.controller_kernel import judge_tick
from edmctl.simulator.controller_state import NOTHING, LoopState, Settings
from edmctl.simulator.gap_monitor import close_block
from edmctl.simulator.plant_interface import TICK_S, Drive, Readings, on_grid
from edmctl.simulator.plant_kernel import actuator_tick, follow_drive, plant_tick, sensor
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


@cached
def run_actuator(
    command_v: Array,
    before_v: float,
    slew_v_s: float,
    highest_v: float,
    units: Sequence[Unit],
    plants: Sequence[PlantState],
    all_drives: Sequence[Drive],
    all_readings: Sequence[Readings],
    noise: Array,
    applied_v: Array,
    free_um: Array,
    sensor_um: Array,
) -> float:
    """Advance the actuator alone, one tick per command; voltage, displacement and reading go to the outputs (n,).

    Nothing stands in the tool's way. Commands pass a slew limit, the range and the converter. `before_v` is the
    command before, and the last one is returned. The caller provides `noise` for every tick, two each.
    """
    unit, plant, drive, readings = units[0], plants[0], all_drives[0], all_readings[0]
    most = slew_v_s * TICK_S
    v = before_v
    for i in range(command_v.shape[0]):
        v = min(v + most, max(v - most, command_v[i]))
        v = min(highest_v, max(0.0, v))
        drive.actuator_v = on_grid(v)
        actuator_tick(unit, plant, drive.actuator_v)
        plant.true_z_um = plant.free_z_um
        sensor_um[i] = sensor(unit, plant, readings.tick, noise)
        readings.tick += 1
        applied_v[i], free_um[i] = drive.actuator_v, plant.free_z_um
    return v


@intrinsic  # type: ignore[untyped-decorator, unused-ignore]
def _call(typing_context: Any, address: Any, argument: Any) -> tuple[Any, Callable[..., Any]]:
    """Call a C function at an address with one pointer; its int64."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        from llvmlite import ir

        word, pointer = ir.IntType(64), ir.IntType(8).as_pointer()
        function = builder.inttoptr(arguments[0], ir.FunctionType(word, [pointer]).as_pointer())
        return builder.call(function, [builder.inttoptr(arguments[1], pointer)])

    return types.int64(types.int64, types.int64), generate


@cached
def run_firmware(
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
    begin: int,
    end: int,
    core: int,
) -> int:
    """Advance by up to `ticks` ms as `run` does; `begin` and `end` are C functions of `core`."""
    unit, plant, scope, drive, readings = units[0], plants[0], scopes[0], all_drives[0], all_readings[0]
    for _ in range(ticks):
        _call(begin, core)  # type: ignore[call-arg]
        gives_way = plant_tick(unit, plant, scope, drive, readings, random, tables, noise, levels)
        happened: int = _call(end, core)
        look = follow_drive(unit, plant, drive, noise) or gives_way
        if happened != NOTHING:
            return happened
        if look:
            return LOOK
    return NOTHING
