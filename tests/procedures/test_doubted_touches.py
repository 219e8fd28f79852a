"""Chips under the tool and touches that cannot be true, in whole quick jobs."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import pytest

from edmctl.errors import ObjectiveNotReached
from edmctl.machine.interface import Touch, TouchRequest
from edmctl.procedures.session import condition
from edmctl.procedures.touch.surfaces import pad_spots, read_pad
from tests.tiers import tiers

from .conftest import Shop, armed, refused

Z1_TOUCH, Z2_TOUCH, Z3_TOUCH = 1, 3, 4
"""Which touch-off of a quick job begins the reading."""


@pytest.mark.parametrize("size_um", tiers(8.0, slow=(2.0, 18.0)))
@pytest.mark.parametrize("touch", tiers(Z3_TOUCH, slow=(Z1_TOUCH, Z1_TOUCH + 1, Z3_TOUCH + 1)))
def test_a_chip_on_the_pad_costs_a_spot_and_no_accuracy(touch: int, size_um: float) -> None:
    shop = Shop(seed=3001)
    shop.inject(f"CHIP_{size_um:g}@touch{touch}+0")
    (site,) = shop.run_job().sites
    told = shop.seen.doubts
    touched_before = 1 if touch < Z2_TOUCH else 0
    assert len(told) == touched_before + site.measuring_stops  # the chip stays where it is
    assert all("two spots of the pad agree" in one for one in told)
    refused = [row.kind for row in shop.seen.touches if not row.accepted]
    assert refused == ["Z1"] * touched_before + ["Z3"] * site.measuring_stops
    assert shop.holds(site)
    assert shop.holds_wear(site)


@pytest.mark.parametrize("size_um", tiers(8.0, slow=(3.0, 14.0)))
def test_a_chip_that_stays_on_the_bottom_widens_the_interval(size_um: float) -> None:
    shop = Shop(("wear.max_cuts=1",), seed=3002)
    shop.inject(f"CHIP_{size_um:g}@touch{Z2_TOUCH}+0")
    with suppress(ObjectiveNotReached):
        shop.run_job()
    (site,) = shop.tally.sites.values()
    assert any("is taken to be at" in told for told in shop.seen.doubts)
    assert site.in_doubt
    assert shop.holds(site)


def test_a_loose_chip_on_the_bottom_is_washed_away() -> None:
    shop = Shop(seed=3003)
    shop.inject(f"LOOSE_CHIP_8@touch{Z2_TOUCH}+0")
    (site,) = shop.run_job().sites
    assert shop.seen.doubts
    assert not any("is taken to be at" in told for told in shop.seen.doubts)
    assert {row.kind for row in shop.seen.touches if not row.accepted} == {"Z2"}
    assert shop.holds(site)


@pytest.mark.parametrize(("sets", "believed"), [(2, True), (100, False)])
def test_touches_that_are_equal_by_chance_are_touched_again(
    sets: int, believed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Three touches with a scatter of 40 digits are equal now and then; a controller that always says so lies."""
    shop = Shop(("measure.touches=3",), seed=3007)
    run = armed(shop, conditioned=True)
    touch = shop.machine.touch
    said: list[tuple[Touch, ...]] = []

    def equal(request: TouchRequest) -> tuple[Touch, ...]:
        said.append(touch(request))
        if len(said) > sets:
            return said[-1]
        return tuple(replace(one, displacement_um=said[0][0].displacement_um) for one in said[-1])

    monkeypatch.setattr(shop.machine, "touch", equal)
    if believed:
        found = read_pad(run, "Z1", "hole", 50.0, 3.0)
        assert found.reading.touches == 3
        assert ["touched again" in told for told in shop.seen.doubts] == [True]
        assert [row.accepted for row in shop.seen.touches] == [True, False, True]
    else:
        with refused("E7021", "to the last digit"):
            read_pad(run, "Z1", "hole", 50.0, 3.0)
        assert not any(row.accepted for row in shop.seen.touches)
    assert len(said) == 3


def test_spots_of_the_pad_lie_away_from_the_holes_and_apart_by_more_than_the_tool() -> None:
    shop = Shop()
    run = shop.run()
    spots = pad_spots(run)
    site = shop.job.sites[0]
    assert shop.job.spot_distance_um > shop.profile.tool.diameter_um
    for i, a in enumerate(spots):
        assert abs(site.x_um - a.x_um) >= abs(site.x_um - spots[0].x_um)
        for b in spots[i + 1 :]:
            apart_um = ((a.x_um - b.x_um) ** 2 + (a.y_um - b.y_um) ** 2) ** 0.5
            assert apart_um > shop.profile.tool.diameter_um


def test_a_pad_on_which_no_two_spots_agree_is_refused() -> None:
    shop = Shop(seed=3005)
    run = armed(shop, conditioned=True)
    for number, size_um in enumerate((20.0, 15.0, 10.0, 5.0), 1):
        shop.inject(f"CHIP_{size_um:g}@touch{number}+0")
    with refused("E7022") as caught:
        read_pad(run, "Z1", "hole", 50.0, 3.0)
    assert "4 spots" in caught.value.message


def test_a_pad_reading_has_as_many_touches_as_the_recipe_says() -> None:
    for touches in (1, 5):
        shop = Shop((f"measure.touches={touches}",), seed=3006)
        run = armed(shop)
        condition(run)
        found = read_pad(run, "Z1", "hole", 50.0, 3.0)
        assert found.reading.touches == max(2, touches)
        assert found.doubt_u_um == 0.0
