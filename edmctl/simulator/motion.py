"""Motions of the virtual controller: ramps, stage moves, pulses on and off. No states and no events."""

from __future__ import annotations

import math
from dataclasses import dataclass

from edmctl.simulator.controller_state import (
    DISPLACEMENT_FAILED_UM,
    HOLD,
    RAMP,
    TEST_OFF,
    LoopState,
    Settings,
)
from edmctl.simulator.plant import Plant
from edmctl.simulator.plant_interface import PATH_LINES, TICK_S

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

    def __init__(self, plant: Plant, settings: Settings, loop: LoopState) -> None:
        self._plant, self._settings, self._loop = plant, settings, loop
        self.stage: StageMove | None = None
        self.path_ends = False

    def begin(self, mode: int) -> None:
        """Let the kernel begin a motion."""
        self._loop.mode = mode
        self._loop.phase = 0
        self._loop.limit_ticks = 0

    def hold(self) -> None:
        """Pulses off, tool and stages held where they are."""
        self._plant.drive.pulses_on = 0
        self._end_scan()
        self.begin(HOLD)

    def start_ramp(self, target_v: float, slew_v_s: float) -> None:
        """Pulses off, then ramp the actuator."""
        self._plant.drive.pulses_on = 0
        self._end_scan()
        self._loop.target_v, self._loop.ramp_v_s = target_v, slew_v_s
        self._loop.feeds = int(target_v > self._plant.drive.actuator_v)
        self.begin(RAMP)

    def pulses_on(self) -> None:
        """Switch the generator on, with fresh counters of what would stop it."""
        loop, drive = self._loop, self._plant.drive
        drive.pulses_on = 1
        drive.pulse_starts += 1
        loop.silent_ticks = loop.sparkless_ticks = 0
        loop.open_ticks = loop.short_ticks = loop.shorted = loop.arc_run = loop.misreads = 0
        loop.last_spark_um = self.place_um

    @property
    def place_um(self) -> float:
        """Where a way begins that must not get too long: with a sensor that has failed, as far back as can be."""
        place_um: float = self._loop.slow_displacement_um
        return place_um if place_um < DISPLACEMENT_FAILED_UM else -DISPLACEMENT_FAILED_UM

    def start_test(self) -> None:
        """Test the gap sensor: generator off first, then on."""
        loop = self._loop
        loop.touch_sum = 0.0
        loop.touch_count = loop.misreads = loop.short_ticks = 0
        self._plant.drive.pulses_on = 0
        self.begin(TEST_OFF)

    def start_stage(self, axis: int, target: float, speed: float) -> None:
        """Let an axis travel (µm and µm/s, degrees and degrees/s) and come to rest."""
        start = self._plant.reported[axis]
        travel_ticks = math.ceil(abs(target - start) / speed / TICK_S)
        self.stage = StageMove(axis, start, target, self._plant.readings.tick, travel_ticks)

    def stop_stage(self) -> None:
        """End a stage move where the stage is now."""
        if self.stage is None:
            return
        move, self.stage = self.stage, None
        share = min(1.0, (self._plant.readings.tick - move.start_tick) / max(1, move.travel_ticks))
        self._plant.stage_lands(move.axis, move.start + share * (move.target - move.start))

    def start_scan(self) -> None:
        """Let the stages follow the lines that will come."""
        self._loop.scanning = 1
        self._loop.path_count = 0
        self.path_ends = False
        self._plant.begin_scan()

    def append_line(self, x_um: float, y_um: float, speed_um_s: float, z_um: float, last: bool) -> bool:
        """Append a line to the path; False where the queue is full."""
        loop = self._loop
        if loop.path_count == PATH_LINES:
            return False
        row = (loop.path_at + loop.path_count) % PATH_LINES
        loop.path_x_um[row], loop.path_y_um[row] = x_um, y_um
        loop.path_speed_um_s[row], loop.path_z_um[row], loop.path_last[row] = speed_um_s, z_um, float(last)
        self._plant.draw_line_error(row)
        loop.path_count += 1
        self.path_ends = last
        return True

    @property
    def stages_follow(self) -> bool:
        """Whether a scan has lines to go."""
        return bool(self._loop.path_count)

    def follow_stages(self) -> None:
        """Let the stages report where the scan has brought them."""
        self._plant.follow_stages(scan_goes_on=bool(self._loop.scanning))

    def _end_scan(self) -> None:
        self._loop.scanning = self._loop.path_count = 0
        self.follow_stages()

    def volts(self, length_um: float) -> float:
        """Volts that move the tool by a length, by the mean gain."""
        return length_um * self._settings.v_per_um
