"""The work as a height map: how deep each of its cells lies below the untouched face.

What lies under the tool is looked up as a footprint: cells, their weights and a table of levels. The plant
erodes with nothing but one level, the least effective depth under the tool's face, and the area that sinks with
it, which the table gives. The footprint then tells the map what became of its cells; no volume is lost.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from ctypes import byref

import numpy as np

from edmctl.array_types import Array
from edmctl.core.library import library
from edmctl.dataclasses import dataclass
from edmctl.simulator.plant_state import Cells

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
