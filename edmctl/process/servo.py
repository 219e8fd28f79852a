"""Motion of the tool over the gap: the limit cycle of the relay servo, and electrode jumps that flush.

A relay that flips an integrator's slope after a dead time L makes a triangle of half-amplitude slope x L and
period 4 L (exact for an ideal integrator).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

HALF_AMPLITUDE_DESIGN_UM = 0.5
"""Swing (half-amplitude) below which shorts do not rise: 0.15 of the working gap, from a simulated sweep."""
HALF_AMPLITUDE_LIMIT_UM = 1.0
"""Swing beyond which shorts rise steeply: 0.3 of the working gap, from the same sweep."""


@dataclass(frozen=True, slots=True)
class LimitCycle:
    """The steady swing of the relay loop."""

    loop_delay_s: float
    half_amplitude_um: float
    period_s: float


def loop_delay_s(
    *, servo_period_s: float, latency_ticks: float, filter_hz: float, actuator_lag_s: float
) -> float:
    """Dead time of the loop in s: half a period of hold, the latency, the low-pass and the actuator lag.

    Lags count fully, so the swing is over-predicted when they dominate.
    """
    return (0.5 + latency_ticks) * servo_period_s + 1.0 / (2.0 * math.pi * filter_hz) + actuator_lag_s


def limit_cycle(slope_um_s: float, delay_s: float) -> LimitCycle:
    """Limit cycle of a relay loop with the given ramp slope (µm/s) and dead time (s)."""
    return LimitCycle(delay_s, slope_um_s * delay_s, 4.0 * delay_s)


def least_jump_um(depth_um: float, diameter_um: float, side_gap_um: float) -> float:
    """Least useful jump height in µm: the tool's stroke must refill the annulus beside it.

    `h_min = 4 s z / d * (1 + s / d)`: annulus volume of depth z over the tool's face.
    """
    return 4.0 * side_gap_um * depth_um / diameter_um * (1.0 + side_gap_um / diameter_um)


def jump_time_s(height_um: float, speed_um_s: float, dwell_s: float) -> float:
    """Time of one jump, up and down with a dwell at the top."""
    return 2.0 * height_um / speed_um_s + dwell_s
