"""The machine at 1 kHz under the firmware's core: compiled plant and C controller by turns, in one loop."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from numba import types
from numba.extending import intrinsic

from edmctl.actuator.compiling import cached
from edmctl.simulator.controller_state import NOTHING
from edmctl.simulator.kernel import LOOK
from edmctl.simulator.plant_interface import Drive, Readings
from edmctl.simulator.plant_kernel import follow_drive, plant_tick
from edmctl.simulator.plant_state import PlantState, Scope, Unit

if TYPE_CHECKING:
    from edmctl.simulator.records import Floats


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
    random: Floats,
    tables: Floats,
    noise: Floats,
    levels: Floats,
    all_drives: Sequence[Drive],
    all_readings: Sequence[Readings],
    begin: int,
    end: int,
    core: int,
) -> int:
    """Advance by up to `ticks` ms as `kernel.run` does; `begin` and `end` are C functions of `core`."""
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
