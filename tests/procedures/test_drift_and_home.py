"""A sensor whose zero walks: what may move goes by the tool's home, and intervals say how far it may be off."""

from __future__ import annotations

import math

import pytest

from edmctl.errors import PreconditionError
from edmctl.machine.port import Axis
from edmctl.procedures.drift import LEAST_SPAN_S, SHARE_OF_REST, Rests, uncertainty_now
from edmctl.procedures.stages import move_to, retract
from edmctl.simulator import kernel as k
from tests.procedures.conftest import Shop, armed

FAST_UM_S = 0.005
"""Three times what the setup believes of its sensor: the worst of some hundred machines."""


def drifting(rate_um_s: float, hours: float = 0.0, overrides: tuple[str, ...] = ()) -> Shop:
    """A shop whose sensor drifts, and has done so for some hours."""
    shop = Shop(overrides)
    shop.bench.plant.par[k.SENSOR_DRIFT] = rate_um_s
    shop.bench.controller.advance(round(3.6e6 * hours) + 1)
    return shop


@pytest.mark.parametrize("rate_um_s", [FAST_UM_S, -FAST_UM_S])
def test_a_sensor_that_has_drifted_for_eight_hours_ends_no_job(rate_um_s: float) -> None:
    shop = drifting(rate_um_s, hours=8.0)
    (site,) = shop.run_job().sites
    (hole,) = shop.bench.truth()
    assert abs(site.z1_um - 50.0 - rate_um_s * 8.0 * 3600.0) < 15.0
    assert abs(site.depth_um - hole.depth_um) <= site.depth_u95_um
    assert shop.ledger.home_um == pytest.approx(rate_um_s * 8.0 * 3600.0, abs=5.0)


def test_the_controller_is_told_where_home_is() -> None:
    shop = drifting(FAST_UM_S, hours=3.0)
    run = armed(shop)
    run.machine.rest(0.5)
    move_to(run, run.job.parking)
    assert shop.bench.controller.zero_um == pytest.approx(FAST_UM_S * 3.0 * 3600.0, abs=1.0)
    assert run.machine.status().x_um == pytest.approx(run.job.parking.x_um)


def test_without_drift_the_controller_is_told_nothing() -> None:
    shop = Shop()
    run = armed(shop)
    run.machine.rest(0.5)
    move_to(run, run.job.parking)
    assert shop.bench.controller.zero_um == 0.0


def test_a_rest_that_jumps_is_a_tool_that_is_held() -> None:
    shop = Shop()
    run = armed(shop)
    move_to(run, run.job.parking)
    run.watch.rests.note(run.machine.time_s, 0.0)
    run.watch.zero_um = lambda: 25.0  # type: ignore[method-assign]
    with pytest.raises(PreconditionError, match=r"has moved by 25\.0 µm") as caught:
        retract(run)
    assert caught.value.code == "E8020"
    assert run.machine.status().displacement_um < 10.0


def test_rests_tell_how_fast_the_zero_may_drift() -> None:
    rests = Rests()
    assert rests.rate_um_s() == 0.0
    rests.note(0.0, 2.0)
    rests.note(1000.0, 7.0)
    assert rests.rate_um_s() == pytest.approx(0.005)
    rests.note(2000.0, 7.0)
    assert rests.rate_um_s() == pytest.approx(0.0025)
    rests.note(2600.0, 13.0)
    assert rests.rate_um_s() == pytest.approx(0.01)


def test_two_rests_soon_after_each_other_are_no_drift() -> None:
    rests = Rests()
    rests.note(0.0, 0.0)
    rests.note(1.0, 0.5)
    assert rests.rate_um_s() == pytest.approx(0.5 / LEAST_SPAN_S)


def test_a_drift_that_was_seen_widens_what_the_setup_believes_and_never_narrows_it() -> None:
    run = Shop().run()
    believed = uncertainty_now(run).drift_u_um_per_s
    assert believed == run.setup.sensor.drift_um_per_s
    run.watch.rests.note(0.0, 0.0)
    run.watch.rests.note(1000.0, 1.0)
    assert uncertainty_now(run).drift_u_um_per_s == believed
    run.watch.rests.note(2000.0, 20.0)
    assert uncertainty_now(run).drift_u_um_per_s == pytest.approx(SHARE_OF_REST * 13.0 / 1000.0, rel=0.5)


def test_the_wear_of_a_long_array_holds_a_fast_drift() -> None:
    sites = 'sites=[{kind="grid",name="hole",x_um=600,y_um=-400,columns=4,rows=3,dx_um=400,dy_um=400}]'
    shop = drifting(FAST_UM_S, overrides=(sites, "target.tolerance_um=15.0", "limits.max_time_s=7200"))
    shop.run_job()
    holes = shop.bench.truth()
    for site in shop.ledger.sites.values():
        true_um = min(holes, key=lambda h: math.hypot(h.x_um - site.x_um, h.y_um - site.y_um)).depth_um
        assert abs(site.depth_um - true_um) <= site.depth_u95_um
    assert shop.bench.controller.fault == 0


def test_stages_stand_still_while_the_tool_is_low() -> None:
    shop = drifting(-FAST_UM_S, hours=3.0)
    run = armed(shop)
    run.machine.rest(0.5)
    move_to(run, run.job.parking)
    run.machine.ramp(40.0, 300.0)
    with pytest.raises(PreconditionError):
        run.machine.move_stage(Axis.X, 0.0, 1000.0)
