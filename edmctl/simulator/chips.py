"""Chips that lie on the work: where the tool comes over one, contact closes earlier by the chip's height.

A chip lies at a point under the tool's face, as wide as it is high; a tool that stands further off than its radius
and half the chip misses it. A loose one may be washed away whenever the tool lifts off it, a firm one stays.
Sparks strike the nearest point, so they eat the chip before anything else.
"""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from edmctl.simulator.plant import Plant

LOOK_TICKS = 10
"""Lifts and sparks are looked for this often while there is a chip; a jump takes longer."""
LIFT_UM = 20.0
"""A tool this far above a chip has lifted off: what is drawn in then may carry the chip away."""
WASHED_AWAY = 0.5
"""Chance of that at each lift, of a loose chip [assumed]."""
LEAST_UM = 0.05
"""What is left of a chip below this is dust."""


@dataclass(slots=True)
class Chip:
    """A chip at a point of the work, `height_um` high and as wide; `chance` is that of going at a lift."""

    x_um: float
    y_um: float
    height_um: float
    chance: float
    lifted: bool = True


@dataclass(slots=True)
class Chips:
    """What lies on the work. Its random numbers are its own: a machine without chips is not changed by them."""

    plant: Plant
    lying: list[Chip] = field(default_factory=list)
    _random: np.random.Generator = field(init=False)
    _depth_um: float = 0.0

    def __post_init__(self) -> None:
        seed = zlib.crc32(self.plant.serial.encode())
        self._random = np.random.default_rng([seed, zlib.crc32(b"chips")])

    def drop(self, height_um: float, *, loose: bool) -> None:
        """Let a chip fall somewhere under the tool where it stands."""
        radius_um = self.plant.config.tool_diameter_um / 2.0
        away_um = radius_um * math.sqrt(self._random.random())
        angle = 2.0 * math.pi * self._random.random()
        x, y = self.plant.position_um
        place = float(x) + away_um * math.cos(angle), float(y) + away_um * math.sin(angle)
        self.lying.append(Chip(*place, height_um, WASHED_AWAY if loose else 0.0))
        self._depth_um = self.plant.state.depth_um
        self.plant.set_surface()

    def clear(self) -> None:
        """Sweep the work."""
        if self.lying:
            self.lying.clear()
            self.plant.set_surface()

    def under_tool_um(self) -> float:
        """Height of the highest chip under the tool, 0 without one."""
        return max((chip.height_um for chip in self.lying if self._is_under(chip)), default=0.0)

    def next_tick(self, now: int) -> int | None:
        """The tick at which to look again; None while nothing can happen to a chip."""
        near = any(not chip.lifted or self._is_under(chip) for chip in self.lying)
        return now + LOOK_TICKS if near else None

    def look(self) -> None:
        """See what lifts and sparks have done since the last time."""
        if not self.lying:
            return
        changed = self._erode()
        for chip in list(self.lying):
            clear_um = self._clear_um()
            if not self._is_under(chip) or clear_um > LIFT_UM:
                if not chip.lifted and self._random.random() < chip.chance:
                    self.lying.remove(chip)
                    changed = True
                chip.lifted = True
            elif clear_um < LIFT_UM / 2.0:
                chip.lifted = False
        if changed:
            self.plant.set_surface()

    def _is_under(self, chip: Chip) -> bool:
        x, y = self.plant.position_um
        reach_um = self.plant.config.tool_diameter_um / 2.0 + chip.height_um / 2.0
        return math.hypot(chip.x_um - float(x), chip.y_um - float(y)) <= reach_um

    def _clear_um(self) -> float:
        """Height of the tool above what it would meet."""
        state = self.plant.state
        return state.surface_um + state.depth_um + state.wear_um - state.true_z_um

    def _erode(self) -> bool:
        """Take from the highest chip under the tool what the sparks have removed since the last look."""
        depth_um = self.plant.state.depth_um
        removed_um3 = (depth_um - self._depth_um) / self.plant.state.per_hole_area
        self._depth_um = depth_um
        under = [chip for chip in self.lying if self._is_under(chip)]
        if not under or not removed_um3 > 0.0 or not self.plant.drive.pulses_on:
            return False
        chip = max(under, key=lambda one: one.height_um)
        chip.height_um = max(0.0, chip.height_um**3 - removed_um3) ** (1.0 / 3.0)
        if chip.height_um < LEAST_UM:
            self.lying.remove(chip)
        return True
