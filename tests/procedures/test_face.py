"""The face away from the pad: where tilt would limit a depth it is touched, and counted by the real distance."""

from __future__ import annotations

import math

import pytest

from edmctl.procedures.touch.surfaces import surface_spots
from edmctl.record.rows import RunEvent
from tests.procedures.conftest import Shop, refused
from tests.tiers import tiers

TILT_MRAD = 0.6
"""Twice the standard uncertainty that the setup states."""
SPOTS = 2
"""Touch-offs of one reading."""
ZR_TOUCH = 3
"""Which touch-off of a job begins the reading of the face."""


def tilted(*overrides: str, seed: int = 1) -> Shop:
    shop = Shop(overrides, seed=seed)
    shop.bench.plant._tilt_mrad[:] = TILT_MRAD, 0.0
    return shop


@pytest.mark.parametrize("away_um", tiers(5000.0, slow=(2000.0, 15000.0)))
def test_a_hole_far_from_the_pad_is_as_deep_as_is_stated(away_um: float) -> None:
    shop = tilted(f"measure.site_dx_um={away_um}")
    (site,) = shop.run_job().sites
    assert shop.holds(site, 1.6)
    assert site.face_um == pytest.approx(1e-3 * TILT_MRAD * away_um, abs=1.0)
    assert [touch.kind for touch in shop.seen.touches].count("Zr") == SPOTS


def test_one_touch_of_the_face_serves_the_places_about_it() -> None:
    far = 'sites=[{kind="grid",name="hole",x_um=6000,y_um=0,columns=2,rows=1,dx_um=400,dy_um=400}]'
    shop = tilted(far)
    shop.run_job()
    assert [touch.kind for touch in shop.seen.touches].count("Zr") == SPOTS
    assert all(shop.holds(site) for site in shop.tally.sites.values())


def test_a_ramp_ends_above_where_an_untouched_face_can_be() -> None:
    shop = tilted("measure.site_dx_um=15000", "target={kind='feed',feed_um=8}")
    shop.bench.plant._tilt_mrad[:] = -1.2, 0.0
    shop.run_job()
    assert RunEvent.APPROACHED in [event[1] for event in shop.seen.events]
    assert shop.bench.controller.fault == 0


@pytest.mark.parametrize("touch", tiers(ZR_TOUCH, slow=(ZR_TOUCH + 1,)))
@pytest.mark.parametrize("size_um", tiers(12.0, slow=(3.0, 20.0)))
@pytest.mark.parametrize("name", tiers("LOOSE_CHIP", slow=("CHIP",)))
def test_a_chip_on_the_face_costs_a_spot_and_no_accuracy(name: str, size_um: float, touch: int) -> None:
    shop = Shop(("measure.site_dx_um=5000",), seed=3101)
    shop.inject(f"{name}_{size_um:g}@touch{touch}+0")
    (site,) = shop.run_job().sites
    assert any("two spots of the face agree" in told for told in shop.seen.doubts)
    assert shop.holds(site, 1.6)
    assert shop.bench.controller.fault == 0


def test_spots_of_the_face_are_clear_of_each_other_and_of_machined_places() -> None:
    shop = Shop(('sites=[{kind="grid",name="hole",x_um=6000,y_um=0,columns=2,rows=1,dx_um=400,dy_um=400}]',))
    run = shop.run()
    first, second = shop.job.sites
    shop.tally.sites[first.name] = first  # type: ignore[assignment]
    spots = surface_spots(run, second).places
    tool_um = shop.profile.tool.diameter_um
    assert spots[0] == second
    assert len(spots) == 4
    for i, a in enumerate(spots):
        assert math.hypot(a.x_um - first.x_um, a.y_um - first.y_um) > tool_um
        for b in spots[i + 1 :]:
            assert math.hypot(a.x_um - b.x_um, a.y_um - b.y_um) > tool_um


def test_a_steep_face_is_touched_halfway_before_it_is_believed() -> None:
    shop = Shop(("measure.site_dx_um=5000",), seed=3102)
    shop.bench.plant._tilt_mrad[:] = 2.5, 0.0
    (site,) = shop.run_job().sites
    assert [touch.kind for touch in shop.seen.touches].count("Zr") == 2 * SPOTS
    assert shop.seen.doubts == []
    assert shop.holds(site, 1.6)


def move_the_far_face(shop: Shop, by_um: float, after_touches: int = 0, beyond_um: float = 4000.0) -> None:
    """Let the work lie lower beyond 4 mm or another place, from a number of touches of the face on."""
    plant = shop.bench.plant
    surface_um, arrive = plant._offset_um, plant.arrive

    def stepped() -> None:
        touched = [row.kind for row in shop.seen.touches].count("Zr")
        there = plant.position_um[0] > beyond_um and touched >= after_touches
        plant._offset_um = surface_um + (by_um if there else 0.0)
        arrive()

    plant.arrive = stepped  # type: ignore[method-assign]


def test_a_step_of_the_face_is_told_and_widens_what_counts_from_it() -> None:
    shop = Shop(("measure.site_dx_um=5000",), seed=3103)
    move_the_far_face(shop, 12.0)
    with refused("E7013"):
        shop.run_job()
    assert any("halfway to the pad" in told for told in shop.seen.doubts)
