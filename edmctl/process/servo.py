"""Limit cycle of the relay servo: does the loop hold the gap or swing through it?

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

    @property
    def rms_um(self) -> float:
        """RMS of the triangle, half-amplitude / sqrt(3)."""
        return self.half_amplitude_um / math.sqrt(3.0)


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
