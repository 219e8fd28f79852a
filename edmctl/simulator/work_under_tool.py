"""The work: a height map of how deep each cell lies below the untouched face, and what lies under the tool.

What lies under the tool is looked up as a footprint: cells, their weights and a table of levels. The plant's state
has one level, the least effective depth under the tool's face, and erodes the area that sinks with it, which the
table gives. The footprint then tells the map what became of its cells; no volume is lost.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Iterator
from ctypes import byref

import numpy as np

from edmctl.array_types import Array
from edmctl.core.library import library
from edmctl.dataclasses import dataclass, replace
from edmctl.process.erosion import roughness_ra_um, widening_um
from edmctl.simulator.config import BenchConfig
from edmctl.simulator.plant_records import Cells, Drive, PlantState, Unit

_Square = tuple[slice, slice]

TILE = 64  # cells along the side of a tile
MOST_CELLS = 1024  # under a tool, along a side
GONE_WITHIN_UM = 1e-3  # of the back face: what is left then is no sheet any more


class Workpiece:
    """Depths in cells of `cell_um`, kept in tiles that exist where something was removed."""

    def __init__(self, cell_um: float) -> None:
        self.cell_um = cell_um
        self.tiles: dict[tuple[int, int], Array] = {}

    def patch(self, column: int, row: int, size: int) -> Array:
        """Return a copy of a square of cells, shape (size, size), rows along y, from its first cell on."""
        cells = np.zeros((size, size))
        for key, here, there in _shared(column, row, size):
            tile = self.tiles.get(key)
            if tile is not None:
                cells[here] = tile[there]
        return cells

    def put(self, column: int, row: int, cells: Array) -> None:
        """Write a square of cells back."""
        for key, here, there in _shared(column, row, len(cells)):
            if key not in self.tiles:
                if not cells[here].any():
                    continue
                self.tiles[key] = np.zeros((TILE, TILE))
            self.tiles[key][there] = cells[here]

    def region(self) -> tuple[Array, Array, Array]:
        """Return the smallest rectangle with all that is cut: x (n,) and y (m,) of centres, depths (m, n), µm."""
        if not self.tiles:
            return np.zeros(0), np.zeros(0), np.zeros((0, 0))
        keys = np.array(list(self.tiles))
        first = keys.min(axis=0)
        across, down = (keys.max(axis=0) - first + 1) * TILE
        cells = np.zeros((down, across))
        for (column, row), tile in self.tiles.items():
            x, y = (column - first[0]) * TILE, (row - first[1]) * TILE
            cells[y : y + TILE, x : x + TILE] = tile
        columns, rows = np.flatnonzero(cells.any(axis=0)), np.flatnonzero(cells.any(axis=1))
        box = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
        x_um = (first[0] * TILE + np.arange(box[1].start, box[1].stop) + 0.5) * self.cell_um
        y_um = (first[1] * TILE + np.arange(box[0].start, box[0].stop) + 0.5) * self.cell_um
        return x_um, y_um, cells[box]


@dataclass(frozen=True, slots=True)
class Tip:
    """The working end of a tool, µm: radius of its face, reach of its discharges, rounding of its rim."""

    radius_um: float
    reach_um: float
    rounding_um: float


class Footprint:
    """What lies under a tool at one place.

    level_um : least effective depth under the face; infinite where nothing is left of the sheet there.
    sinking : share of the whole disc that sinks with the level now.
    table : shape (3, n), level from which on the sinking share and the rarity of ignition (face over what is left of
        it) are those of the column; ends with an infinite level. A share of zero says that nothing is left there
        to erode, and the place is to be looked at again.
    """

    def __init__(self, work: Workpiece, x_um: float, y_um: float, tip: Tip, thickness_um: float) -> None:
        cell = work.cell_um
        self._work = work
        self._column = math.floor((x_um - tip.reach_um) / cell) - 1
        self._row = math.floor((y_um - tip.reach_um) / cell) - 1
        self._thickness_um = thickness_um
        size = math.ceil(2.0 * tip.reach_um / cell) + 4
        if size > MOST_CELLS:
            raise ValueError(f"the tool is wider than {MOST_CELLS} cells of the work")
        self._cells = work.patch(self._column, self._row, size)
        self._effective, self._weights, self._under = (np.empty_like(self._cells) for _ in range(3))
        self.level_um = library().work_look(
            self._record(self._cells),
            x_um / cell - self._column - 0.5,
            y_um / cell - self._row - 0.5,
            tip.radius_um / cell,
            tip.reach_um / cell,
            tip.rounding_um,
            GONE_WITHIN_UM,
        )
        table, now, room = np.empty((3, 2 * size * size + 1)), np.empty(2), np.empty(8 * size * size)
        columns = library().work_tabulate(
            self._record(self._cells),
            self.level_um,
            table.ctypes.data,
            table.shape[1],
            now.ctypes.data,
            room.ctypes.data,
        )
        self.sinking, self.rarity = now.tolist()
        self.table = np.ascontiguousarray(table[:, :columns])

    def _record(self, cells: Array) -> object:
        """Return a pointer to a record of where the cells are, for the library in C."""
        arrays = (cells, self._effective, self._weights, self._under)
        return byref(Cells(len(cells), self._thickness_um, *(one.ctypes.data for one in arrays)))

    def settle(self, level_um: float, work: Workpiece | None = None) -> None:
        """Write into the map (or a copy of it) what is left of the cells after the level has sunk so far."""
        if not level_um > self.level_um:
            return
        cells = self._cells.copy()
        library().work_sink(self._record(cells), self.level_um, level_um)
        (work or self._work).put(self._column, self._row, cells)


def _shared(column: int, row: int, size: int) -> Iterator[tuple[tuple[int, int], _Square, _Square]]:
    """Yield each tile that a square of cells shares: its key, the place in the square, the place in the tile."""
    for tile_row in range(row // TILE, (row + size - 1) // TILE + 1):
        for tile_column in range(column // TILE, (column + size - 1) // TILE + 1):
            x, y = tile_column * TILE, tile_row * TILE
            left, right = max(column, x), min(column + size, x + TILE)
            low, high = max(row, y), min(row + size, y + TILE)
            here = slice(low - row, high - row), slice(left - column, right - column)
            there = slice(low - y, high - y), slice(left - x, right - x)
            yield (tile_column, tile_row), here, there


NO_LEVELS = np.array([[math.inf], [1.0], [1.0]])
EDGE_X_UM = -2000.0  # the work begins here; the parking place lies beyond

_SURFACE = ("wall_um", "crater_um3", "crater_um6", "arc_um3")
"""What the surface of a hole comes from (plant_records.py)."""
LOOK_TICKS = 10
"""Lifts and sparks are looked for this often while there is a chip; a jump takes longer."""
LIFT_UM = 20.0
"""A tool this far above a chip has lifted off: what is drawn in then may carry the chip away."""
WASHED_AWAY = 0.5
"""Chance of that at each lift, of a loose chip [assumed]."""
LEAST_UM = 0.05
"""What is left of a chip below this is dust."""


@dataclass(slots=True)
class Hole:
    """A hole in the work: where its axis is, how deep it is under the tool's face, and whether it is through.

    `side_gap_um` is the widest that its generator made, the rest what its surface comes from (plant_records.py).
    """

    x_um: float
    y_um: float
    depth_um: float
    through: bool = False
    side_gap_um: float = 0.0
    wall_um: float = 0.0
    crater_um3: float = 0.0
    crater_um6: float = 0.0
    arc_um3: float = 0.0

    def __deepcopy__(self, _: object) -> Hole:
        return replace(self)

    @property
    def ra_um(self) -> float:
        """Roughness of its floor."""
        if self.crater_um3 <= 0.0:
            return math.nan
        arc_share = self.arc_um3 / self.crater_um3
        return roughness_ra_um(self.crater_um6 / self.crater_um3, arc_share, library().pow)

    @property
    def taper_um(self) -> float:
        """How much wider its mouth is than its bottom, on the radius."""
        if self.side_gap_um <= 0.0:
            return math.nan
        return widening_um(self.wall_um, self.side_gap_um, library().pow)


class WorkUnderTool:
    """The work under one tool, which is that of `config` from the next place on.

    levels : table for the plant. solid : whether there is anything to meet. work : the height map.
    holes : what was cut by a tool that stood.
    """

    def __init__(self, config: BenchConfig, unit: Unit, state: PlantState) -> None:
        self.config = config
        self._unit, self._state = unit, state
        self.work = Workpiece(config.cell_um)
        self.holes: list[Hole] = []
        self.here: Hole | None = None
        self.levels = NO_LEVELS
        self.solid = False
        self.side_gap_um = 0.0  # that the generator makes
        self._place = (0.0, 0.0)
        self._footprint: Footprint | None = None
        self._found_um = 0.0
        self._stands = True

    def arrive(self, x_um: float, y_um: float) -> None:
        """Stand at a place: in a hole, on the face of the work, or beside it."""
        gap_um, self.here = self.side_gap_um, None
        for hole in reversed(self.holes):
            if math.hypot(hole.x_um - x_um, hole.y_um - y_um) <= max(hole.side_gap_um, gap_um):
                self.here = hole
        self._stands = True
        self._take_up(x_um, y_um)
        self._found_um = self._state.crater_depth_um = self._state.depth_um
        for name in _SURFACE:
            setattr(self._state, name, getattr(self.here, name, 0.0))

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
        self._note_hole()
        return tuple(self.holes)

    def true_map(self) -> tuple[Array, Array, Array]:
        """Centres x (n,) and y (m,) and depths (m, n) of all that is cut, the present cut included, µm."""
        work = Workpiece(self.work.cell_um)
        work.tiles = {key: tile.copy() for key, tile in self.work.tiles.items()}
        if self._footprint is not None:
            self._footprint.settle(self._state.depth_um, work)
        return work.region()

    def _take_up(self, x_um: float, y_um: float) -> None:
        c, state = self.config, self._state
        self._place = (x_um, y_um)
        state.per_hole_area, state.rarity = self._unit.per_disc_area, 1.0
        state.level_at, state.next_level_um = 0, math.inf
        if x_um < EDGE_X_UM:
            self._footprint, self.levels, self.solid = None, NO_LEVELS, False
            state.depth_um = 0.0
            return
        radius_um = c.tool_diameter_um / 2.0
        tip = Tip(radius_um, radius_um + self.side_gap_um, c.tip_rounding_um)
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
        self.here.depth_um = min(depth_um, self.config.thickness_um)
        self.here.through = not self.solid
        self.here.side_gap_um = max(self.here.side_gap_um, self.side_gap_um)
        for name in _SURFACE:
            setattr(self.here, name, getattr(self._state, name))


@dataclass(slots=True)
class Chip:
    """A chip at a point of the work, `height_um` high and as wide; `chance` is that of going at a lift."""

    x_um: float
    y_um: float
    height_um: float
    chance: float
    lifted: bool = True


class Chips:
    """Chips that lie on the work: where the tool comes over one, contact closes earlier by the chip's height.

    A chip is at a point, as wide as it is high. A loose one may be washed away whenever the tool lifts off it.
    Sparks strike the nearest point, so they erode the chip first. Chips have random numbers of their own.

    changed : called when another height is under the tool.
    """

    def __init__(
        self,
        serial: str,
        position_um: Array,
        state: PlantState,
        drive: Drive,
        changed: Callable[[], None],
    ) -> None:
        self._position_um, self._state, self._drive, self._changed = position_um, state, drive, changed
        self._random = np.random.default_rng([zlib.crc32(serial.encode()), zlib.crc32(b"chips")])
        self._depth_um = 0.0
        self.tool_diameter_um = 0.0
        self.lying: list[Chip] = []

    def drop(self, height_um: float, *, loose: bool) -> None:
        """Let a chip fall somewhere under the tool where it stands."""
        radius_um = self.tool_diameter_um / 2.0
        away_um = radius_um * math.sqrt(self._random.random())
        angle = 2.0 * math.pi * self._random.random()
        x, y = self._position_um
        place = float(x) + away_um * library().cos(angle), float(y) + away_um * library().sin(angle)
        self.lying.append(Chip(*place, height_um, WASHED_AWAY if loose else 0.0))
        self._depth_um = self._state.depth_um
        self._changed()

    def clear(self) -> None:
        """Sweep the work."""
        if self.lying:
            self.lying.clear()
            self._changed()

    def under_tool_um(self) -> float:
        """Height of the highest chip under the tool, 0 without one."""
        return max((chip.height_um for chip in self.lying if self._is_under(chip)), default=0.0)

    def next_tick(self, now: int) -> int | None:
        """Return the tick at which to look again; None without a chip."""
        return now + LOOK_TICKS if self.lying else None

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
            self._changed()

    def _is_under(self, chip: Chip) -> bool:
        x, y = self._position_um
        reach_um = self.tool_diameter_um / 2.0 + chip.height_um / 2.0
        return math.hypot(chip.x_um - float(x), chip.y_um - float(y)) <= reach_um

    def _clear_um(self) -> float:
        """Height of the tool above what it would meet."""
        state = self._state
        return state.surface_um + state.depth_um + state.wear_um - state.true_z_um

    def _erode(self) -> bool:
        """Take from the highest chip under the tool what the sparks have removed since the last look."""
        depth_um = self._state.depth_um
        removed_um3 = (depth_um - self._depth_um) / self._state.per_hole_area
        self._depth_um = depth_um
        under = [chip for chip in self.lying if self._is_under(chip)]
        if not under or not removed_um3 > 0.0 or not self._drive.pulses_on:
            return False
        chip = max(under, key=lambda one: one.height_um)
        chip.height_um = library().pow(max(0.0, chip.height_um**3 - removed_um3), 1.0 / 3.0)
        if chip.height_um < LEAST_UM:
            self.lying.remove(chip)
        return True
