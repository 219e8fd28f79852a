"""Loop stability and jumps."""

from __future__ import annotations

import math

import pytest

from edmctl.planning.removal import LimitCycle, least_jump_um, servo_swing
from edmctl.planning.rules.load import load_profile
from edmctl.profile.setup import Controller, Setup


def swing(slope_um_s: float, period_us: int) -> LimitCycle:
    profile = load_profile("cu270").profile
    servo = profile.servo.model_copy(update={"forward_um_s": slope_um_s, "filter_hz": 20.0})
    setup = Setup(controller=Controller(servo_period_us=period_us))
    return servo_swing(profile.model_copy(update={"servo": servo}), setup)


@pytest.mark.parametrize(
    ("slope_um_s", "period_us", "frequency_hz", "rms_um"),
    [(20.0, 50_000, 2.9, 0.98), (5.0, 100_000, 1.56, 0.46), (50.0, 1000, 21.8, 0.33)],
)
def test_the_limit_cycle_is_a_triangle_of_period_four_delays(
    slope_um_s: float, period_us: int, frequency_hz: float, rms_um: float
) -> None:
    cycle = swing(slope_um_s, period_us)
    assert 1.0 / cycle.period_s == pytest.approx(frequency_hz, rel=0.02)
    assert cycle.half_amplitude_um == pytest.approx(math.sqrt(3.0) * rms_um, rel=0.02)
    assert cycle.half_amplitude_um == pytest.approx(slope_um_s * cycle.period_s / 4.0)


def test_the_default_loop_swings_far_less_than_the_gap() -> None:
    assert swing(5.0, 1000).half_amplitude_um == pytest.approx(0.057, abs=0.001)


@pytest.mark.parametrize(
    ("diameter_um", "depth_um", "height_um"), [(270, 180, 22), (150, 180, 40), (252, 240, 31)]
)
def test_a_jump_must_refill_the_annulus(diameter_um: float, depth_um: float, height_um: float) -> None:
    assert least_jump_um(depth_um, diameter_um, 8.0) == pytest.approx(height_um, abs=0.6)
