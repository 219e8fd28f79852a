"""Pulses struck in a gap that a test holds, and what the controller makes of them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.link.messages import PulseBlocks, Pulses
from edmctl.simulator.controller_state import LOG_FULL, LoopState, Settings
from edmctl.simulator.discharge import strike_pulses
from edmctl.simulator.gap_monitor import judge_pulses
from edmctl.simulator.parameters import Parameters
from edmctl.core.records import rows

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from edmctl.simulator.plant import Plant


class PulseLog:
    """A controller that does nothing but judge and log pulses."""

    def __init__(self, plant: Plant) -> None:
        self._plant = plant
        self._settings, self._loop = Settings(), LoopState()
        Parameters(self._settings)
        self._settings.open_v = plant.unit.open_v
        self._settings.pulse_log = LOG_FULL
        self._blocks, self._pulses = rows(PulseBlocks.record_dtype(), 1), rows(Pulses.record_dtype(), 64)

    def strike(self) -> tuple[float, NDArray[np.void]]:
        """Strike the pulses of this tick: the sum of their mean voltages, and the record of each."""
        plant, random = self._plant, self._plant.random
        self._loop.log_n = 0
        random.provide(plant.state, 64, 1)
        readings = plant.readings.shared[0]
        strike_pulses(
            plant.unit.shared[0],
            plant.state.shared[0],
            plant.scope.shared[0],
            plant.drive.shared[0],
            readings,
            random.pulse,
            random.tables,
        )
        judge_pulses(self._settings.shared[0], self._loop.shared[0], readings, self._blocks, self._pulses)
        count = plant.readings.pulses
        return plant.readings.gap_v * count, self._pulses[:count].copy()
