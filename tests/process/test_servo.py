"""Loop stability and jumps."""

from __future__ import annotations

import math

import pytest

from edmctl.process.servo import least_jump_um, limit_cycle, loop_delay_s


def delay(loop_s: float) -> float:
    return loop_delay_s(servo_period_s=loop_s, latency_ticks=1, filter_hz=20.0, actuator_lag_s=0.002)


@pytest.mark.parametrize(
    ("slope_um_s", "loop_s", "frequency_hz", "rms_um"),
    [(20.0, 0.050, 2.9, 0.98), (5.0, 0.100, 1.56, 0.46), (50.0, 0.001, 21.8, 0.33)],
)
def test_the_limit_cycle_is_a_triangle_of_period_four_delays(
    slope_um_s: float, loop_s: float, frequency_hz: float, rms_um: float
) -> None:
    cycle = limit_cycle(slope_um_s, delay(loop_s))
    assert 1.0 / cycle.period_s == pytest.approx(frequency_hz, rel=0.02)
    assert cycle.half_amplitude_um == pytest.approx(math.sqrt(3.0) * rms_um, rel=0.02)
    assert cycle.half_amplitude_um == pytest.approx(slope_um_s * cycle.period_s / 4.0)


def test_the_default_loop_swings_far_less_than_the_gap() -> None:
    assert limit_cycle(5.0, delay(0.001)).half_amplitude_um == pytest.approx(0.057, abs=0.001)


@pytest.mark.parametrize(
    ("diameter_um", "depth_um", "height_um"), [(270, 180, 22), (150, 180, 40), (252, 240, 31)]
)
def test_a_jump_must_refill_the_annulus(diameter_um: float, depth_um: float, height_um: float) -> None:
    assert least_jump_um(depth_um, diameter_um, 8.0) == pytest.approx(height_um, abs=0.6)
