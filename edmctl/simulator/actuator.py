"""The piezo actuator of a virtual machine on its own: voltage in, displacement and sensor reading out.

It is the actuator of `plant`, without gap or work, behind the controller's slew limit and converter. One seed
is one unit: the same plays, creep and sensor error as on the virtual bench of that seed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from edmctl.array_types import Array
from edmctl.core.library import library
from edmctl.link.messages import PARAMS
from edmctl.simulator.config import BenchConfig
from edmctl.simulator.plant import Plant
from edmctl.simulator.plant_records import TICK_S
from edmctl.simulator.unit import BLOCK

RATE_HZ = 1.0 / TICK_S
LOW_V, HIGH_V = PARAMS["piezo_max_v"].minimum, PARAMS["piezo_max_v"].maximum
SLEW_V_S = PARAMS["slew_limit_v_s"].default

_TICKS_AT_ONCE = BLOCK // 2


class DrivenTicks(NamedTuple):
    """Consecutive ticks of 1 ms, ndarrays of shape (n,).

    t_s : since the actuator was set up. applied_v : after slew limit, range and converter.
    truth_um : position of the tool, which only the simulator knows. sensor_um : reading of the displacement sensor.
    """

    t_s: Array
    applied_v: Array
    truth_um: Array
    sensor_um: Array


class VirtualActuator:
    """One unit, at rest at 0 V after full swings long ago."""

    def __init__(self, seed: int) -> None:
        self._plant = Plant(BenchConfig(), seed)
        self._command_v = 0.0

    @property
    def serial(self) -> str:
        """Serial number of the virtual machine with this actuator."""
        return self._plant.serial

    def drive(self, command_v: Array) -> DrivenTicks:
        """Apply a voltage sampled every millisecond; calls continue one another.

        command_v : ndarray, shape (n,), finite. Range and slew limit are those of the controller.
        """
        plant = self._plant
        command_v = np.ascontiguousarray(command_v, dtype=np.float64)
        t_s = (plant.readings.tick + np.arange(command_v.size)) / RATE_HZ
        applied_v, truth_um, sensor_um = (np.empty(command_v.size) for _ in range(3))
        for start in range(0, command_v.size, _TICKS_AT_ONCE):
            part = slice(start, start + _TICKS_AT_ONCE)
            plant.random.provide(plant.state, 0, 2 * command_v[part].size)
            self._command_v = library().actuator_run(
                plant.in_c().place,
                command_v[part].size,
                command_v[part].ctypes.data,
                self._command_v,
                SLEW_V_S,
                HIGH_V,
                *(one[part].ctypes.data for one in (applied_v, truth_um, sensor_um)),
            )
        return DrivenTicks(t_s, applied_v, truth_um, sensor_um)
