"""A sensor whose zero walks: what may move goes by the tool's home, and intervals say how far it may be off."""

from __future__ import annotations

import math

import pytest

from edmctl.errors import PreconditionError
from edmctl.machine.port import Axis
from edmctl.procedures.drift import LEAST_SPAN_S, SHARE_OF_REST, Rests, first_home_um, uncertainty_now
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


def stand_out(shop: Shop, by_um: float) -> None:
    """Let the actuator hold the tool that far out although its voltage is 0; the sensor shows it."""
    shop.bench.plant.par[k.ACTUATOR_ZERO] -= by_um


@pytest.mark.parametrize("out_um", [35.0, 60.0])
def test_a_tool_that_stands_out_at_the_start_is_not_moved(out_um: float) -> None:
    shop = Shop()
    stand_out(shop, out_um)
    before = shop.bench.plant.position_um.copy()
    with pytest.raises(PreconditionError) as caught:
        shop.run_job()
    assert caught.value.code == "E8020"
    assert (shop.bench.plant.position_um == before).all()


def test_a_tool_that_comes_out_little_by_little_is_not_followed() -> None:
    shop = Shop()
    run = armed(shop)
    run.machine.rest(0.5)
    move_to(run, run.job.parking)
    run.watch.rests.note(run.machine.time_s, 0.0)
    zeros_um = [2.0, 6.0, 10.0, 14.0]
    told_um: list[float] = []
    run.machine.set_zero = told_um.append  # type: ignore[method-assign,assignment]

    def rest_at(zero_um: float) -> None:
        run.watch.zero_um = lambda: zero_um  # type: ignore[method-assign]
        retract(run)
        run.watch.rests.note(run.machine.time_s, zero_um)

    for zero_um in zeros_um[:3]:
        rest_at(zero_um)
    with pytest.raises(PreconditionError) as caught:
        rest_at(zeros_um[3])
    assert caught.value.code == "E8020"
    assert max(told_um) < 12.0


def test_home_that_was_known_minutes_ago_bounds_what_may_be_drift() -> None:
    assert first_home_um(60.0, 50.0, 0.0017, 600.0) == pytest.approx(54.08)
    assert first_home_um(52.0, 50.0, 0.0017, 600.0) == 52.0
    assert first_home_um(-80.0, 50.0, 0.0017, 600.0) == -80.0


def test_a_tool_that_touches_something_at_rest_is_not_moved() -> None:
    shop = Shop()
    run = armed(shop)
    run.machine.rest(0.5)
    shop.bench.plant.obstacle_um = -1.0
    shop.bench.plant.set_surface()
    run.machine.rest(0.5)
    with pytest.raises(PreconditionError) as caught:
        move_to(run, run.job.parking)
    assert caught.value.code == "E8021"
