"""The map of the work: what a footprint takes from it and gives back."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edmctl.simulator.work_under_tool import TILE, Footprint, Tip, Workpiece

CELL_UM = 5.0
ROUND = Tip(135.0, 143.0, 4.0)
FLAT = Tip(135.0, 143.0, 0.0)
DISC_UM2 = math.pi * 143.0**2
THICK = math.inf


def print_of(
    work: Workpiece, x_um: float, y_um: float, tip: Tip = FLAT, thickness_um: float = THICK
) -> Footprint:
    return Footprint(work, x_um, y_um, tip, thickness_um)


def volume_um3(work: Workpiece) -> float:
    return float(work.region()[2].sum()) * CELL_UM**2


def swept_um3(footprint: Footprint, to_um: float) -> float:
    """What the kernel removes when the level goes down to there: the sinking area over the levels of the table."""
    level, share, total = footprint.level_um, footprint.sinking, 0.0
    for next_level, next_share, _ in footprint.table.T:
        total += share * (min(next_level, to_um) - level)
        if next_level >= to_um:
            return float(total) * DISC_UM2
        level, share = next_level, next_share
    raise AssertionError("a table ends with an infinite level")


@pytest.mark.parametrize("place", [(0.0, 0.0), (1.3, -2.2), (333.3, 777.7), (-5.0, 2.5), (2.5, 2.5)])
def test_fresh_work_under_a_flat_tool_sinks_as_one_disc_of_the_exact_area(place: tuple[float, float]) -> None:
    work = Workpiece(CELL_UM)
    footprint = print_of(work, *place)
    assert (footprint.level_um, footprint.sinking, footprint.rarity) == (0.0, 1.0, 1.0)
    assert footprint.table.tolist() == [[math.inf], [1.0], [1.0]]
    footprint.settle(10.0)
    assert volume_um3(work) == pytest.approx(10.0 * DISC_UM2, rel=1e-12)
    for _ in range(50):
        again = print_of(work, *place)
        assert again.sinking == 1.0
        again.settle(again.level_um + 1.0)
    assert print_of(work, *place).level_um == 60.0


def test_a_tool_that_moves_loses_no_volume() -> None:
    chance = np.random.default_rng(3)
    work, removed, place = Workpiece(CELL_UM), 0.0, np.zeros(2)
    for _ in range(60):
        footprint = print_of(work, float(place[0]), float(place[1]), ROUND)
        to_um = footprint.level_um + float(chance.exponential(1.0))
        removed += swept_um3(footprint, to_um)
        footprint.settle(to_um)
        place += chance.normal(0.0, 40.0, 2)
    assert volume_um3(work) == pytest.approx(removed, rel=1e-9)


def test_the_level_is_that_of_the_shallowest_place_under_the_face() -> None:
    work = Workpiece(CELL_UM)
    print_of(work, 0.0, 0.0).settle(20.0)
    beside = print_of(work, 100.0, 0.0)
    assert beside.level_um == 0.0
    assert 0.1 < beside.sinking < 0.6
    assert beside.table[0, -2] == 20.0
    assert beside.table[1, -2] == 1.0


def test_a_rounded_tip_begins_with_its_tip_and_leaves_its_shape() -> None:
    work = Workpiece(CELL_UM)
    footprint = print_of(work, 2.5, 2.5, ROUND)
    assert footprint.level_um == 0.0
    assert footprint.sinking < 0.01
    footprint.settle(10.0)
    x_um, y_um, depth_um = work.region()
    row = depth_um[int(np.argmin(abs(y_um - 2.5)))]
    at = {round(x): float(d) for x, d in zip(x_um - 2.5, row, strict=True)}
    assert at[0] == 10.0
    for away_um in (50, 100):
        assert at[away_um] == pytest.approx(10.0 - 4.0 * (away_um / 135.0) ** 2, abs=1e-9)


def test_a_sheet_gives_way_from_the_middle_outwards_under_a_rounded_tip() -> None:
    work = Workpiece(CELL_UM)
    whole = print_of(work, 0.0, 0.0, ROUND, 50.0)
    whole.settle(52.0)
    part = print_of(work, 0.0, 0.0, ROUND, 50.0)
    assert part.level_um == pytest.approx(52.0, abs=0.1)
    assert part.rarity == pytest.approx(2.0, rel=0.05)
    part.settle(54.0 + 1e-6)
    gone = print_of(work, 0.0, 0.0, ROUND, 50.0)
    assert (gone.level_um, gone.rarity) == (math.inf, math.inf)
    assert work.region()[2].max() == 50.0


def test_the_rim_of_a_through_hole_is_met_from_beside_it() -> None:
    work = Workpiece(CELL_UM)
    print_of(work, 0.0, 0.0, FLAT, 50.0).settle(50.0)
    assert print_of(work, 3.0, 0.0, FLAT, 50.0).level_um == math.inf
    beside = print_of(work, 60.0, 0.0, FLAT, 50.0)
    assert beside.level_um == 0.0
    assert beside.rarity > 1.5


def test_the_map_is_kept_only_where_something_was_cut() -> None:
    work = Workpiece(CELL_UM)
    print_of(work, 40_000.0, -30_000.0).settle(1.0)
    assert 1 <= len(work.tiles) <= 4
    x_um, y_um, depth_um = work.region()
    assert depth_um.shape == (len(y_um), len(x_um))
    assert abs(x_um.mean() - 40_000.0) < CELL_UM
    assert abs(y_um.mean() + 30_000.0) < CELL_UM
    assert len(x_um) <= 2 * 143.0 / CELL_UM + 2


def test_a_patch_across_tiles_comes_back_as_it_was_put() -> None:
    work = Workpiece(CELL_UM)
    cells = np.random.default_rng(1).random((90, 90))
    work.put(TILE - 20, -TILE - 50, cells)
    np.testing.assert_array_equal(work.patch(TILE - 20, -TILE - 50, 90), cells)
    assert not work.patch(3 * TILE, 3 * TILE, 90).any()
