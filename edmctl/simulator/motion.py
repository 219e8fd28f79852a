"""Motions of the virtual controller: ramps, stage moves, pulses on and off. No states and no events."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from edmctl.simulator import kernel as k

if TYPE_CHECKING:
    from edmctl.simulator.plant import Plant

STAGE_SETTLE_TICKS = 50


@dataclass(frozen=True, slots=True)
class StageMove:
    """An axis on its way: from where to where (µm, degrees), since when, and how long it travels."""

    axis: int
    start: float
    target: float
    start_tick: int
    travel_ticks: int

    @property
    def arrival_tick(self) -> int:
        """When the stage has come to rest."""
        return self.start_tick + self.travel_ticks + STAGE_SETTLE_TICKS


class Motion:
    """Begins and ends what moves; the kernel carries it out."""

    def __init__(self, plant: Plant) -> None:
        self._plant = plant
        self._st, self._ist, self._par = plant.st, plant.ist, plant.par
        self.stage: StageMove | None = None
        self.path = np.zeros((k.PATH_LINES, k.PATH_COLUMNS))
        self.path_ends = False

    def begin(self, mode: int) -> None:
        """Let the kernel begin a motion."""
        self._ist[k.MODE] = mode
        self._ist[k.PHASE] = 0
        self._ist[k.LIMIT_TICKS] = 0

    def hold(self) -> None:
        """Pulses off, tool and stages held where they are."""
        self._ist[k.PULSES_ON] = 0
        self._end_scan()
        self.begin(k.HOLD)

    def start_ramp(self, target_v: float, slew_v_s: float) -> None:
        """Pulses off, then ramp the actuator."""
        self._ist[k.PULSES_ON] = 0
        self._end_scan()
        self._st[k.TARGET_V], self._st[k.RAMP_V_S] = target_v, slew_v_s
        self.begin(k.RAMP)

    def pulses_on(self) -> None:
        """Switch the generator on, with fresh counters of what would stop it."""
        ist, st = self._ist, self._st
        ist[k.PULSES_ON] = 1
        ist[k.NEXT_PULSE] = ist.item(k.TICK) * k.TICK_NS
        ist[k.OPEN_TICKS] = ist[k.SHORT_TICKS] = ist[k.SHORTED] = ist[k.ARC_RUN] = ist[k.MISREADS] = 0
        st[k.LAST_SPARK_Z] = st[k.SLOW_Z]

    def start_test(self) -> None:
        """Test the gap sensor: generator off first, then on."""
        self._st[k.TOUCH_SUM] = 0.0
        self._ist[k.TOUCH_COUNT] = self._ist[k.MISREADS] = self._ist[k.SHORT_TICKS] = 0
        self._ist[k.PULSES_ON] = 0
        self.begin(k.TEST_OFF)

    def start_stage(self, axis: int, target: float, speed: float) -> None:
        """Let an axis travel (µm and µm/s, degrees and degrees/s) and come to rest."""
        start = self._plant.reported[axis]
        travel_ticks = math.ceil(abs(target - start) / speed / k.TICK_S)
        self.stage = StageMove(axis, start, target, self._ist.item(k.TICK), travel_ticks)

    def stop_stage(self) -> None:
        """End a stage move where the stage is now."""
        if self.stage is None:
            return
        move, self.stage = self.stage, None
        share = min(1.0, (self._ist.item(k.TICK) - move.start_tick) / max(1, move.travel_ticks))
        self._plant.stage_lands(move.axis, move.start + share * (move.target - move.start))

    def start_scan(self) -> None:
        """Let the stages follow the lines that will come."""
        self._ist[k.SCANNING] = 1
        self._ist[k.PATH_COUNT] = 0
        self.path_ends = False
        self._plant.begin_scan()

    def append_line(self, x_um: float, y_um: float, speed_um_s: float, z_um: float, last: bool) -> bool:
        """Append a line to the path; False where the queue is full."""
        count = self._ist.item(k.PATH_COUNT)
        if count == k.PATH_LINES:
            return False
        row = (self._ist.item(k.PATH_AT) + count) % k.PATH_LINES
        self.path[row] = (x_um, y_um, speed_um_s, z_um, float(last), *self._plant.stage_errors_um())
        self._ist[k.PATH_COUNT] = count + 1
        self.path_ends = last
        return True

    @property
    def stages_follow(self) -> bool:
        """Whether a scan has lines to go."""
        return bool(self._ist[k.PATH_COUNT])

    def _end_scan(self) -> None:
        self._ist[k.SCANNING] = self._ist[k.PATH_COUNT] = 0
        self._plant.follow_stages()

    def volts(self, length_um: float) -> float:
        """Volts that move the tool by a length, by the mean gain."""
        return length_um * self._par.item(k.V_PER_UM)
