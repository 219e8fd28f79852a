"""What converters sample of a pulse: firmware/plant/pulse_shape.c, compiled into the emulator's loops."""

from __future__ import annotations

import math

from .compiling import compiled

RISE_US = 0.5  # of the open voltage: series resistor and capacitance of gap and leads [assumed]
BREAKDOWN_US = 0.1  # of the voltage at ignition [assumed]
CURRENT_US = 0.3  # of the current, both ways: inductance of the leads [assumed]
DECAY_US = 2.0  # of the voltage once the switch is open [assumed]

_SETTLED = 40.0
"""Time constants after which nothing is left to be seen in a double."""


@compiled
def _risen(t_us: float, tau_us: float) -> float:
    return 1.0 if t_us > _SETTLED * tau_us else -math.expm1(-t_us / tau_us)


@compiled
def _left(t_us: float, tau_us: float) -> float:
    return 0.0 if t_us > _SETTLED * tau_us else math.exp(-t_us / tau_us)


@compiled
def pulse_ends(
    open_v: float, delay_us: float, opens_us: float, plateau_v: float, current_a: float
) -> tuple[float, float, float]:
    """Voltage at ignition; voltage and current when the switch opens, `opens_us` after the pulse's begin."""
    lit_v = open_v * _risen(delay_us, RISE_US)
    burning_us = opens_us - delay_us
    if burning_us <= 0.0:
        return lit_v, lit_v, 0.0
    last_v = plateau_v + (lit_v - plateau_v) * _left(burning_us, BREAKDOWN_US)
    return lit_v, last_v, current_a * _risen(burning_us, CURRENT_US)


@compiled
def pulse_at(
    t_us: float,
    open_v: float,
    delay_us: float,
    opens_us: float,
    plateau_v: float,
    current_a: float,
    ends: tuple[float, float, float],
) -> tuple[float, float]:
    """Voltage and current of a pulse at a time since its begin; `ends` are its `pulse_ends`."""
    if t_us < delay_us:
        return open_v * _risen(t_us, RISE_US), 0.0
    if t_us < opens_us:
        lit_t_us = t_us - delay_us
        v = plateau_v + (ends[0] - plateau_v) * _left(lit_t_us, BREAKDOWN_US)
        return v, current_a * _risen(lit_t_us, CURRENT_US)
    off_t_us = t_us - opens_us
    return ends[1] * _left(off_t_us, DECAY_US), ends[2] * _left(off_t_us, CURRENT_US)
