"""What lies under the tool: its place on the work, the hole that it is in, and what the kernel must know of both.

The kernel's state holds one depth and the area that sinks with it. This looks them up in the height map when the
tool comes to a place, and writes them back when it leaves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from edmctl.simulator.workpiece import Footprint, Tip, Workpiece

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

    from edmctl.simulator.config import BenchConfig
    from edmctl.simulator.plant_state import PlantState, Unit

NO_LEVELS = np.array([[math.inf], [1.0], [1.0]])
EDGE_X_UM = -2000.0  # the work begins here; the parking place lies beyond


@dataclass(slots=True)
class Hole:
    """A hole in the work: where its axis is, how deep it is under the tool's face, and whether it is through."""

    x_um: float
    y_um: float
    depth_um: float
    through: bool = False


class Ground:
    """The work under one tool. `levels` is the table for the kernel, `solid` whether there is anything to meet.

    `work` is the height map, `holes` is what was cut by a tool that stood.
    """

    def __init__(self, config: BenchConfig, unit: Unit, state: PlantState) -> None:
        self._config = config
        self._unit, self._state = unit, state
        self.work = Workpiece(config.cell_um)
        self.holes: list[Hole] = []
        self.here: Hole | None = None
        self.levels = NO_LEVELS
        self.solid = False
        self._place = (0.0, 0.0)
        self._footprint: Footprint | None = None
        self._found_um = 0.0
        self._stands = True

    def set_tool(self, config: BenchConfig) -> None:
        """Let another tool be over the work from the next place on."""
        self._config = config

    def arrive(self, x_um: float, y_um: float) -> None:
        """Stand at a place: in a hole, on the face of the work, or beside it."""
        clearance = self._config.discharge.side_gap_um
        self.here = next(
            (h for h in self.holes if math.hypot(h.x_um - x_um, h.y_um - y_um) <= clearance), None
        )
        self._stands = True
        self._take_up(x_um, y_um)
        self._found_um = self._state.depth_um

    def leave(self) -> None:
        """Remember what became of the work here, before the stage moves."""
        self._note_hole()
        self.settle()
        self.here = None

    def set_moving(self) -> None:
        """The tool stands no longer: what it cuts from now on is no hole."""
        self._note_hole()
        self.here = None
        self._stands = False

    def look(self, x_um: float, y_um: float) -> None:
        """Take up what lies at a place near by, in the middle of a cut."""
        self.settle()
        self._take_up(x_um, y_um)

    def true_holes(self) -> tuple[Hole, ...]:
        """Every hole with its present depth."""
        self._note_hole()
        return tuple(self.holes)

    def true_map(self) -> tuple[Floats, Floats, Floats]:
        """Centres x (n,) and y (m,) and depths (m, n) of all that is cut, the present cut included, µm."""
        work = Workpiece(self.work.cell_um)
        work.tiles = {key: tile.copy() for key, tile in self.work.tiles.items()}
        if self._footprint is not None:
            self._footprint.settle(self._state.depth_um, work)
        return work.region()

    def _take_up(self, x_um: float, y_um: float) -> None:
        c, state = self._config, self._state
        self._place = (x_um, y_um)
        state.per_hole_area, state.rarity = self._unit.per_disc_area, 1.0
        state.level_at, state.next_level_um = 0, math.inf
        if x_um < EDGE_X_UM:
            self._footprint, self.levels, self.solid = None, NO_LEVELS, False
            state.depth_um = 0.0
            return
        radius_um = c.tool_diameter_um / 2.0
        tip = Tip(radius_um, radius_um + c.discharge.side_gap_um, c.tip_rounding_um)
        print_ = Footprint(self.work, x_um, y_um, tip, c.thickness_um)
        self._footprint, self.levels = print_, print_.table
        self.solid = print_.level_um < math.inf
        state.depth_um = print_.level_um if self.solid else c.thickness_um
        state.next_level_um = float(self.levels[0, 0])
        state.per_hole_area /= print_.sinking
        state.rarity = print_.rarity

    def settle(self) -> None:
        """Write into the map what was cut here so far."""
        if self._footprint is not None:
            self._footprint.settle(self._state.depth_um)

    def _note_hole(self) -> None:
        depth_um = self._state.depth_um
        if not self._stands or not depth_um > self._found_um:
            return
        if self.here is None:
            self.here = Hole(*self._place, depth_um)
            self.holes.append(self.here)
        self.here.depth_um = min(depth_um, self._config.thickness_um)
        self.here.through = not self.solid
