"""The work as a height map: how deep each of its cells lies below the untouched face.

What lies under the tool is looked up as a footprint: cells, their weights and a table of levels. The kernel
erodes with nothing but one level, the least effective depth under the tool's face, and the area that sinks with
it, which the table gives. The footprint then tells the map what became of its cells; no volume is lost.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from edmctl.actuator.compiling import cached
from edmctl.array_types import Array

_Square = tuple[slice, slice]

TILE = 64  # cells along the side of a tile
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
        self._cells = work.patch(self._column, self._row, size)
        self._effective = np.empty_like(self._cells)
        self._weights = np.empty_like(self._cells)
        under = np.empty_like(self._cells)
        self.level_um = look(
            self._cells,
            x_um / cell - self._column - 0.5,
            y_um / cell - self._row - 0.5,
            tip.radius_um / cell,
            tip.reach_um / cell,
            tip.rounding_um,
            thickness_um,
            self._effective,
            self._weights,
            under,
        )
        table = np.empty((3, 2 * size * size + 1))
        self.sinking, self.rarity, columns = tabulate(
            self._cells, self._effective, self._weights, under, self.level_um, thickness_um, table
        )
        self.table = np.ascontiguousarray(table[:, :columns])

    def settle(self, level_um: float, work: Workpiece | None = None) -> None:
        """Write into the map (or a copy of it) what is left of the cells after the level has sunk so far."""
        if not level_um > self.level_um:
            return
        cells = self._cells.copy()
        sink(cells, self._effective, self._weights, self.level_um, level_um, self._thickness_um)
        (work or self._work).put(self._column, self._row, cells)


def compile_loops() -> None:
    """Compile what a new place of the tool needs, or load it from the cache."""
    Footprint(Workpiece(1.0), 0.0, 0.0, Tip(1.0, 2.0, 0.0), math.inf).settle(1.0)


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


@cached
def look(
    cells: Array,
    x: float,
    y: float,
    radius: float,
    reach: float,
    rounding_um: float,
    thickness_um: float,
    effective: Array,
    weights: Array,
    under: Array,
) -> float:
    """Fill effective depths (infinite where the sheet is gone), weights and what is under the face; the level.

    `x`, `y`, `radius` and `reach` are in cells, from the centre of the first cell on. The effective depth of a cell
    is its depth and how far the rounded tip lies back there. A cell counts by the share of it that the disc covers,
    adjusted so that the disc has its exact area; under the face it counts whole.
    """
    total, partial, level = 0.0, 0.0, math.inf
    for i in range(cells.shape[0]):
        for j in range(cells.shape[1]):
            away = math.sqrt((j - x) * (j - x) + (i - y) * (i - y))
            covered = min(1.0, max(0.0, 0.5 + reach - away))
            under[i, j] = 1.0 if away <= radius else 0.0
            weights[i, j] = max(covered, under[i, j])
            effective[i, j] = math.inf
            total += weights[i, j]
            partial += weights[i, j] * (1.0 - weights[i, j])
            if weights[i, j] > 0.0 and cells[i, j] < thickness_um - GONE_WITHIN_UM:
                back = min(1.0, away / radius)
                effective[i, j] = cells[i, j] + rounding_um * back * back
                if under[i, j] == 1.0:
                    level = min(level, effective[i, j])
    missing = math.pi * reach * reach - total
    stretch = min(1.0, max(-1.0, missing / partial)) if partial > 0.0 else 0.0
    for i in range(cells.shape[0]):
        for j in range(cells.shape[1]):
            # A weight stays below one: no cell of the rim gets deeper than the floor.
            weights[i, j] += stretch * weights[i, j] * (1.0 - weights[i, j])
    return level


@cached
def tabulate(
    cells: Array,
    effective: Array,
    weights: Array,
    under: Array,
    level: float,
    thickness_um: float,
    table: Array,
) -> tuple[float, float, int]:
    """Write the table of a footprint; returns the share that sinks and the rarity of ignition now, columns used.

    Cells join what sinks at their effective depth, and fall out of a sheet one thickness below its face.
    """
    face, face_left, cells_left, sinking, sinking_cells, whole = 0, 0, 0, 0.0, 0, 0.0
    for i in range(cells.shape[0]):
        for j in range(cells.shape[1]):
            whole += weights[i, j]
            face += int(under[i, j])
            if effective[i, j] < math.inf:
                cells_left += 1
                face_left += int(under[i, j])
                if effective[i, j] <= level:
                    sinking += weights[i, j]
                    sinking_cells += 1
    table[0, 0], table[1, 0], table[2, 0] = math.inf, 1.0, 1.0
    if face_left == 0:
        return 1.0, math.inf, 1
    all_cells = cells_left if face_left == face else -1
    now = 1.0 if sinking_cells == all_cells else sinking / whole
    rarity = face / face_left
    size = 2 * cells_left
    levels, gains, falls = np.empty(size), np.empty(size), np.zeros(size)
    n = 0
    for i in range(cells.shape[0]):
        for j in range(cells.shape[1]):
            e = effective[i, j]
            if e == math.inf:
                continue
            if e > level:
                levels[n], gains[n] = e, weights[i, j]
                n += 1
            if thickness_um < math.inf:
                levels[n], gains[n] = thickness_um + (e - cells[i, j]), -weights[i, j]
                falls[n] = 1.0 + under[i, j]
                n += 1
    order = np.argsort(levels[:n])
    columns = 0
    for at in range(n):
        event = order[at]
        sinking += gains[event]
        if falls[event] == 0.0:
            sinking_cells += 1
        else:
            sinking_cells -= 1
            all_cells = -1
            face_left -= int(falls[event] - 1.0)
        if at + 1 < n and levels[order[at + 1]] == levels[event]:
            continue
        table[0, columns] = levels[event]
        share = sinking / whole if sinking_cells > 0 else 0.0
        table[1, columns] = 1.0 if sinking_cells == all_cells else share
        table[2, columns] = face / face_left if face_left > 0 else math.inf
        columns += 1
    table[0, columns], table[1, columns], table[2, columns] = math.inf, 1.0, 1.0
    return now, rarity, columns + 1


@cached
def sink(
    cells: Array, effective: Array, weights: Array, before: float, after: float, thickness_um: float
) -> None:
    """Lower the cells by what the level sank: those deeper than it from where it met them, those above with it."""
    for i in range(cells.shape[0]):
        for j in range(cells.shape[1]):
            e, weight = effective[i, j], weights[i, j]
            if weight == 0.0 or e >= after:
                continue
            if weight == 1.0 and e >= before:
                depth = after - (e - cells[i, j])  # exactly the level where the tip is flat
            else:
                depth = cells[i, j] + weight * (after - max(e, before))
            cells[i, j] = min(depth, thickness_um)
