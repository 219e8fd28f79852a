"""The forecast against full per-pulse runs."""

from __future__ import annotations

import math

import pytest

from edmctl.planning.forecast import Reached, forecast, working_order
from edmctl.planning.measuring import approach_time_s, jumps_time_s, touch_time_s
from edmctl.planning.removal import (
    LimitCycle,
    approach_speed_um_s,
    feed_rate_um_s,
    least_jump_um,
    servo_swing,
)
from edmctl.planning.rules.load import load_profile
from edmctl.profile.setup import Controller, Sensor, Setup
from edmctl.results.result import Forecast


def forecast_of(name: str, *overrides: str) -> Forecast:
    return forecast(load_profile(name, overrides).profile, Setup())


@pytest.mark.parametrize(
    ("name", "time_s", "feed_um_s", "depth_um", "wear_um"),
    [
        ("cu270", 864.0, 0.289, 180.0, 70.0),
        ("cu150", 317.0, 0.789, 175.0, 75.0),
        ("w252", 1000.0, 0.250, 240.0, 10.0),
    ],
)
def test_it_agrees_with_per_pulse_runs(
    name: str, time_s: float, feed_um_s: float, depth_um: float, wear_um: float
) -> None:
    f = forecast_of(name)
    assert f.machining_time_s == pytest.approx(time_s, rel=0.10)
    assert f.feed_rate_um_s == pytest.approx(feed_um_s, rel=0.10)
    assert f.depth_um == depth_um
    assert f.wear_um == pytest.approx(wear_um, rel=0.01)
    assert f.feed_um == f.depth_um + f.wear_um


def test_the_reference_sets_the_time() -> None:
    for reference, time_s in ((0.70, 772.0), (0.85, 1037.0), (0.90, 1458.0)):
        f = forecast_of("cu270", f"servo.reference={reference}")
        assert f.machining_time_s == pytest.approx(time_s, rel=0.10)


def test_twice_the_current_saves_35_to_50_percent_of_the_time() -> None:
    once, twice = forecast_of("cu150"), forecast_of("cu150", "pulse.current_a=0.24")
    assert 0.35 <= 1.0 - twice.machining_time_s / once.machining_time_s <= 0.50
    assert twice.spark_energy_uj == pytest.approx(2.0 * 344.3, abs=0.2)


def test_stroke_and_servo_are_forecast_from_offset_feed_reserve_and_the_real_loop() -> None:
    f = forecast_of("cu270")
    assert f.stroke_um == pytest.approx(50.0 + 250.0 + 15.0, abs=0.1)
    assert f.stroke_available_um == pytest.approx(356.0, abs=0.1)
    assert f.loop_delay_s == pytest.approx(1.5e-3 + 7.958e-3 + 2e-3, abs=1e-6)
    assert f.limit_cycle_um == pytest.approx(5.0 * f.loop_delay_s)
    assert f.limit_cycle_period_s == pytest.approx(4.0 * f.loop_delay_s)


def test_jumps_cost_their_share() -> None:
    without, with_jumps = forecast_of("cu270", "jump.mode=off"), forecast_of("cu270", "jump.period_s=2")
    assert without.jump_share == 0.0
    assert with_jumps.jump_share == pytest.approx(0.08 / 2.0)
    left = 1.0 - with_jumps.jump_share
    assert with_jumps.machining_time_s * left < without.machining_time_s  # the gap is cleaner, too
    assert forecast_of("cu270") == forecast_of("cu270", "jump.mode=fixed")  # adaptive: as if they kept to it


def test_a_short_isopulse_removes_less() -> None:
    iso = forecast_of("cu270", "pulse.mode=isopulse", "pulse.discharge_us=40")
    assert iso.machining_time_s > 1.3 * forecast_of("cu270").machining_time_s
    assert iso.spark_energy_uj == pytest.approx(22.0 * 0.12 * 40.0)


@pytest.mark.parametrize(
    ("overrides", "cuts"),
    [((), 2), (("wear.remeasure=never",), 1), (("wear.remeasure=1",), 2), (("wear.max_cuts=1",), 1)],
)
def test_cuts_and_measuring_time_follow_the_remeasuring(overrides: tuple[str, ...], cuts: int) -> None:
    f = forecast_of("cu270", *overrides)
    assert f.cuts == cuts
    assert f.time_s == f.machining_time_s + f.measuring_time_s
    once = forecast_of("cu270", "wear.remeasure=never").measuring_time_s
    assert (f.measuring_time_s > once + 40.0) == (cuts > 1)


def array_of(*overrides: str) -> Forecast:
    loaded = load_profile("array-3x3", overrides)
    return forecast(loaded.profile, Setup(), loaded.places)


def test_an_array_adds_up() -> None:
    one, nine = forecast_of("array-3x3"), array_of()
    assert (one.holes, nine.holes) == (1, 9)
    assert nine.machining_time_s == pytest.approx(9.0 * one.machining_time_s)
    assert nine.tool_wear_um == pytest.approx(9.0 * one.wear_um)
    assert (nine.depth_um, nine.feed_um) == (one.depth_um, one.feed_um)
    assert nine.stroke_um == pytest.approx(one.stroke_um + 8.0 * one.wear_um)


def test_what_one_hole_teaches_spares_the_others_their_stops() -> None:
    assert array_of().stops <= 9 * forecast_of("array-3x3").stops / 2
    assert array_of("wear.remeasure=never").stops == 9
    assert array_of("wear.ratio_u_rel=0.5", "target.tolerance_um=0.6").stops > array_of().stops


def test_the_end_of_a_single_hole_is_touched_and_not_that_of_every_hole_of_an_array() -> None:
    sparing = forecast_of("w252", "wear.remeasure=sparing")
    assert (sparing.cuts, sparing.stops) == (2, 1)
    assert (forecast_of("w252").cuts, forecast_of("w252").stops) == (2, 2)
    assert array_of().stops < array_of("wear.remeasure=1").stops
    assert array_of("wear.remeasure=sparing").stops == array_of().stops


def test_the_interval_of_the_depth_is_foretold() -> None:
    """Seed 2 of the profile ends with 180.00 ± 1.14 µm."""
    assert forecast_of("cu270").depth_u95_um == pytest.approx(1.14, abs=0.1)
    assert math.isnan(forecast_of("foil-through").depth_u95_um)


@pytest.mark.parametrize(("tolerance_um", "u95_um"), [(0.6, 0.53), (1.2, 1.04)])
def test_the_interval_of_holes_that_are_not_touched_is_foretold(tolerance_um: float, u95_um: float) -> None:
    """As a later touch of the pad leaves them: at a tolerance of 0.6 µm, seed 9 ends with at most ± 0.52 µm."""
    found = array_of(f"target.tolerance_um={tolerance_um}").depth_u95_um
    assert found == pytest.approx(u95_um, abs=0.15)
    assert found <= tolerance_um


def test_a_machine_without_a_sensor_knows_its_depths_by_the_gain_of_its_calibration() -> None:
    loaded = load_profile("cu270")
    bare = Setup(sensor=Sensor(fitted=False))
    assert forecast(loaded.profile, bare).depth_u95_um == pytest.approx(2.0 * 0.025 * 180.0, rel=0.1)


def test_the_way_between_places_takes_its_time() -> None:
    near = array_of()
    far = array_of("sites=[{kind='grid',x_um=500,columns=3,rows=3,dx_um=4000,dy_um=4000}]")
    assert far.measuring_time_s > near.measuring_time_s + 8 * 3.6
    crossing = "sites=[{x_um=500},{x_um=20000},{x_um=800},{x_um=19000}]"
    assert array_of(crossing).time_s < array_of(crossing, "array.order=given").time_s - 20.0
    crossed = load_profile("array-3x3", [crossing])
    ordered = working_order(crossed.profile, Setup(), crossed.places)
    assert [place.x_um for place in ordered] == [500.0, 800.0, 19000.0, 20000.0]
    straight = array_of("sites=[{x_um=500},{x_um=900}]")
    turned = array_of("sites=[{x_um=500},{x_um=900,theta_deg=90}]")
    assert turned.measuring_time_s == pytest.approx(straight.measuring_time_s + 2 * 9.0)


def test_a_deeper_place_counts_by_its_own_depth() -> None:
    f = array_of("sites=[{x_um=500},{x_um=900,depth_um=40}]")
    assert f.depth_um == 40.0
    assert f.tool_wear_um == pytest.approx(0.427 * 60.0)


def test_a_way_through_feeds_on_through_the_worn_tip() -> None:
    f = forecast_of("foil-through")
    assert f.depth_um == 50.0
    assert f.feed_um == pytest.approx(50.0 * 1.427 + 75.0)
    assert f.stroke_um == pytest.approx(f.feed_um + 65.0)
    short = forecast_of("foil-through", "target={kind='through',completion_um=10}")
    assert short.feed_um == pytest.approx(50.0 * 1.427 + 10.0)
    assert short.machining_time_s < f.machining_time_s


def test_approach_touch_and_jumps_take_their_time_alone() -> None:
    profile = load_profile("cu270").profile
    assert approach_time_s(profile, Setup()) > 47.0
    slow = load_profile("cu270", ["approach.speed_um_s=0.5"]).profile
    assert approach_time_s(slow, Setup()) > approach_time_s(profile, Setup()) + 46.0
    more = load_profile("cu270", ["measure.touches=5"]).profile
    assert touch_time_s(more, Setup()) == pytest.approx(touch_time_s(profile, Setup()) + 2 * 3.3)
    assert jumps_time_s(profile, 6, 10.0) == 60.0
    assert jumps_time_s(profile, 6, 0.01) == pytest.approx(6 * 0.08)


def test_the_approach_is_faster_where_sparks_erode_faster() -> None:
    weak, strong = (
        load_profile("cu150", (f"pulse.current_a={a}", "servo.forward_um_s=10", "servo.back_um_s=10")).profile
        for a in (0.12, 1.0)
    )
    assert approach_speed_um_s(weak) == weak.approach.speed_um_s
    assert approach_speed_um_s(strong) > feed_rate_um_s(strong, 0.0) > strong.approach.speed_um_s


@pytest.mark.parametrize(
    ("name", "overrides"),
    [
        ("cu270", ()),
        ("foil-through", ()),
        ("channel-circle", ()),
        ("array-3x3", ()),
        ("cu270", ("regimes=[{name='a',share=0.9},{name='b',share=0.1,current_a=0.06}]",)),
    ],
)
def test_what_remains_of_a_resumed_job_is_forecast(name: str, overrides: tuple[str, ...]) -> None:
    loaded = load_profile(name, overrides)
    whole, setup = loaded.forecast, Setup()
    site = loaded.places[0].name if loaded.places else "hole"
    rest = [
        forecast(loaded.profile, setup, loaded.places, Reached(site, share * whole.depth_um))
        for share in (0.0, 0.3, 0.6, 0.95)
    ]
    assert rest[0] == whole
    assert [one.machining_time_s for one in rest] == sorted(
        (one.machining_time_s for one in rest), reverse=True
    )
    assert [one.tool_wear_um for one in rest] == sorted((one.tool_wear_um for one in rest), reverse=True)
    assert [one.cuts for one in rest] == sorted((one.cuts for one in rest), reverse=True)
    # What earlier runs have machined and what remains are the whole job.
    done_s = [whole.machining_time_s - one.machining_time_s for one in rest]
    of_hole_s = whole.machining_time_s / max(1, whole.holes)
    assert 0.1 * of_hole_s < done_s[1] < 0.5 * of_hole_s
    assert 0.3 * of_hole_s < done_s[2] < 0.8 * of_hole_s
    assert done_s[3] < of_hole_s
    for one in rest[1:]:
        assert one.pulses == pytest.approx(
            whole.pulses * one.machining_time_s / whole.machining_time_s, rel=0.2
        )
        assert (one.depth_um, one.stroke_um, one.ra_um) == (whole.depth_um, whole.stroke_um, whole.ra_um)


def swing(slope_um_s: float, period_us: int) -> LimitCycle:
    profile = load_profile("cu270").profile
    servo = profile.servo.model_copy(update={"forward_um_s": slope_um_s, "filter_hz": 20.0})
    setup = Setup(controller=Controller(servo_period_us=period_us))
    return servo_swing(profile.model_copy(update={"servo": servo}), setup)


@pytest.mark.parametrize(
    ("slope_um_s", "period_us", "frequency_hz", "rms_um"),
    [(20.0, 50_000, 2.9, 0.98), (5.0, 100_000, 1.56, 0.46), (50.0, 1000, 21.8, 0.33)],
)
def test_a_relay_makes_a_triangle(
    slope_um_s: float, period_us: int, frequency_hz: float, rms_um: float
) -> None:
    cycle = swing(slope_um_s, period_us)
    assert 1.0 / cycle.period_s == pytest.approx(frequency_hz, rel=0.02)
    assert cycle.half_amplitude_um == pytest.approx(math.sqrt(3.0) * rms_um, rel=0.02)
    assert cycle.half_amplitude_um == pytest.approx(slope_um_s * cycle.period_s / 4.0)


@pytest.mark.parametrize(
    ("diameter_um", "depth_um", "height_um"), [(270, 180, 22), (150, 180, 40), (252, 240, 31)]
)
def test_a_jump_must_refill_the_annulus(diameter_um: float, depth_um: float, height_um: float) -> None:
    assert least_jump_um(depth_um, diameter_um, 8.0) == pytest.approx(height_um, abs=0.6)
