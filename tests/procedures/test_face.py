"""The face away from the pad: where tilt would limit a depth it is touched, and counted by the real distance."""

from __future__ import annotations

import math

import pytest

from edmctl.procedures.codes import RunEvent
from edmctl.process.plane import fitted_plane, unknown_plane
from tests.procedures.conftest import Shop

TILT_MRAD = 0.6
"""Twice the standard uncertainty that the setup states."""


def tilted(*overrides: str, seed: int = 1) -> Shop:
    shop = Shop(overrides, seed=seed)
    shop.bench.plant._tilt_mrad[:] = TILT_MRAD, 0.0
    return shop


@pytest.mark.parametrize("away_um", [2000.0, 5000.0, 15000.0])
def test_a_hole_far_from_the_pad_is_as_deep_as_is_stated(away_um: float) -> None:
    shop = tilted(f"measure.site_dx_um={away_um}")
    (site,) = shop.run_job().sites
    (hole,) = shop.bench.truth()
    assert abs(site.depth_um - hole.depth_um) <= site.depth_u95_um < 1.6
    assert site.face_um == pytest.approx(1e-3 * TILT_MRAD * away_um, abs=1.0)
    assert [touch.kind for touch in shop.seen.touches].count("Zr") == 1


def test_beside_the_pad_no_touch_is_spent_on_the_face() -> None:
    shop = tilted()
    shop.run_job()
    assert "Zr" not in [touch.kind for touch in shop.seen.touches]


def test_one_touch_of_the_face_serves_the_places_about_it() -> None:
    far = 'sites=[{kind="grid",name="hole",x_um=6000,y_um=0,columns=2,rows=1,dx_um=400,dy_um=400}]'
    shop = tilted(far)
    shop.run_job()
    assert [touch.kind for touch in shop.seen.touches].count("Zr") == 1
    holes = shop.bench.truth()
    for site in shop.ledger.sites.values():
        true_um = min(holes, key=lambda h: math.hypot(h.x_um - site.x_um, h.y_um - site.y_um)).depth_um
        assert abs(site.depth_um - true_um) <= site.depth_u95_um


def test_a_ramp_ends_above_where_an_untouched_face_can_be() -> None:
    shop = tilted("measure.site_dx_um=15000", "target={kind='feed',feed_um=8}")
    shop.bench.plant._tilt_mrad[:] = -1.2, 0.0
    shop.run_job()
    assert RunEvent.APPROACHED in [event[1] for event in shop.seen.events]
    assert shop.bench.controller.fault == 0


def test_a_face_that_slopes_more_than_was_believed_is_believed() -> None:
    believed = unknown_plane((0.0, 0.0), 0.3)
    assert believed.height_u_um(10_000.0, 0.0) == pytest.approx(3.0)
    found = fitted_plane((0.0, 0.0), [(10_000.0, 0.0)], [20.0], 0.15, 0.3)
    assert found.height_um(10_000.0, 0.0) == pytest.approx(20.0, abs=0.05)
    assert found.height_u_um(0.0, 10_000.0) == pytest.approx(20.0, rel=0.05)
