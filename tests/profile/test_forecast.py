"""The forecast against full per-pulse runs."""

from __future__ import annotations

import pytest

from edmctl.profile import load_profile
from edmctl.profile.forecast import Forecast, forecast
from edmctl.profile.setup import Setup


def forecast_of(name: str, *overrides: str) -> Forecast:
    return forecast(load_profile(name, overrides).profile, Setup())


@pytest.mark.parametrize(
    ("name", "time_s", "feed_um_s", "depth_um", "wear_um"),
    [
        ("cu270", 870.5, 0.287, 180.0, 70.0),
        ("cu150", 303.5, 0.824, 175.0, 75.0),
        ("w252", 1017.6, 0.246, 240.0, 10.0),
    ],
)
def test_time_and_feed_are_within_a_tenth_of_per_pulse_runs(
    name: str, time_s: float, feed_um_s: float, depth_um: float, wear_um: float
) -> None:
    f = forecast_of(name)
    assert f.machining_time_s == pytest.approx(time_s, rel=0.10)
    assert f.feed_rate_um_s == pytest.approx(feed_um_s, rel=0.10)
    assert f.depth_um == depth_um
    assert f.wear_um == pytest.approx(wear_um, rel=0.01)
    assert f.feed_um == f.depth_um + f.wear_um


@pytest.mark.parametrize(("reference", "time_s"), [(0.70, 615.0), (0.85, 1134.0), (0.90, 1663.0)])
def test_the_reference_sets_the_time(reference: float, time_s: float) -> None:
    f = forecast_of("cu270", f"servo.reference={reference}")
    assert f.machining_time_s == pytest.approx(time_s, rel=0.10)


def test_twice_the_current_halves_the_time() -> None:
    once, twice = forecast_of("cu150"), forecast_of("cu150", "pulse.current_a=0.24")
    assert twice.machining_time_s == pytest.approx(once.machining_time_s / 2.0, rel=1e-6)
    assert twice.spark_energy_uj == pytest.approx(2.0 * 344.3, abs=0.2)


def test_the_stroke_holds_offset_feed_and_reserve() -> None:
    f = forecast_of("cu270")
    assert f.stroke_um == pytest.approx(50.0 + 250.0 + 15.0, abs=0.1)
    assert f.stroke_available_um == pytest.approx(356.0, abs=0.1)


def test_the_servo_is_forecast_from_the_real_loop() -> None:
    f = forecast_of("cu270")
    assert f.loop_delay_s == pytest.approx(1.5e-3 + 7.958e-3 + 2e-3, abs=1e-6)
    assert f.limit_cycle_um == pytest.approx(5.0 * f.loop_delay_s)
    assert f.limit_cycle_period_s == pytest.approx(4.0 * f.loop_delay_s)


def test_jumps_cost_their_share() -> None:
    without, with_jumps = forecast_of("cu270", "jump.mode=off"), forecast_of("cu270", "jump.period_s=1.5")
    assert without.jump_share == 0.0
    assert with_jumps.jump_share == pytest.approx(0.08 / 1.5)
    assert with_jumps.machining_time_s * (1.0 - with_jumps.jump_share) == pytest.approx(
        without.machining_time_s
    )


def test_a_short_isopulse_removes_less() -> None:
    iso = forecast_of("cu270", "pulse.mode=isopulse", "pulse.discharge_us=40")
    assert iso.machining_time_s > 1.3 * forecast_of("cu270").machining_time_s
    assert iso.spark_energy_uj == pytest.approx(22.0 * 0.12 * 40.0)


@pytest.mark.parametrize(
    ("overrides", "cuts"),
    [((), 3), (("wear.remeasure=never",), 1), (("wear.remeasure=1",), 2), (("wear.max_cuts=2",), 2)],
)
def test_cuts_and_measuring_time_follow_the_remeasuring(overrides: tuple[str, ...], cuts: int) -> None:
    f = forecast_of("cu270", *overrides)
    assert f.cuts == cuts
    assert f.time_s == f.machining_time_s + f.measuring_time_s


def test_measuring_takes_longer_the_more_cuts() -> None:
    assert (
        forecast_of("cu270").measuring_time_s
        > forecast_of("cu270", "wear.remeasure=never").measuring_time_s + 60.0
    )
