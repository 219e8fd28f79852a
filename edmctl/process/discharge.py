"""Discharges: energy of a pulse, the share that burns at a servo level, and the gap that the servo keeps.

The servo regulates the normalised level `s = mean gap voltage / (duty x open voltage)`: 1 means every pulse
stays open, `rho = discharge voltage / open voltage` means every pulse ignites at once. The ignition delay has
an exponential tail (Laue 1925), so its mean time constant against the on-time fixes the level.

A wider gap breaks down at a higher voltage, so what is believed of the working gap before any was measured grows in
proportion to the open voltage. Proportion is a belief [assumed], so its uncertainty grows alike, and the first gap
that a job measures takes its place.
"""

from __future__ import annotations

import math

USUAL_VOLTAGE_V = 40.0  # open voltage that the figures below hold for
FIRST_GAP_U_UM = 0.8
"""Standard uncertainty of a working gap that was not measured, at that voltage or below [assumed]."""
FIRST_SPARKS_UM = 1.2
"""First sparks come this much before the working gap, because they are judged by the first discharges."""
FIRST_SPARKS_U_UM = 1.5  # standard uncertainty of that, at that voltage or below [assumed]


def pulse_energy_uj(discharge_voltage_v: float, current_a: float, on_time_us: float) -> float:
    """Energy in µJ of a pulse that burns for its whole on-time, `u_e * I * t_on`."""
    return discharge_voltage_v * current_a * on_time_us


def tool_area_um2(diameter_um: float) -> float:
    """Face of a round tool, µm²."""
    return math.pi / 4.0 * diameter_um**2


def hole_area_um2(diameter_um: float, side_gap_um: float) -> float:
    """Cross-section of the hole that a round tool makes, µm²: the tool plus the side gap all round."""
    return tool_area_um2(diameter_um + 2.0 * side_gap_um)


def mrr_mm3_min(removal_um3_s: float) -> float:
    """Material removal rate (MRR) in the trade's unit, mm³/min."""
    return removal_um3_s * 60.0 / 1e9


def open_share(tau_over_on_time: float) -> float:
    """Mean share of the on-time before ignition, `phi = E[min(t_d, t_on)] / t_on`, for exponential delay."""
    x = tau_over_on_time
    return -x * math.expm1(-1.0 / x) if x > 0.0 else 0.0


def delay_over_on_time(level_s: float, rho: float, longest_share: float = 1.0) -> float:
    """Time constant of the ignition delay over the on-time at a servo level, where discharges end after a set share.

    Solves `s = phi + rho * E[min(t_set, t_on - t_d)] / t_on` by bisection; the level rises with it from
    `rho * longest_share` to 1.
    """
    low, high, exp, expm1 = -6.0, 6.0, math.exp, math.expm1
    for _ in range(60):
        middle = 0.5 * (low + high)
        x = 10.0**middle
        # `open_share` is written out: forecasts solve this sixteen times.
        burning = longest_share - x * (exp(-(1.0 - longest_share) / x) - exp(-1.0 / x))
        if -x * expm1(-1.0 / x) + rho * burning < level_s:
            low = middle
        else:
            high = middle
    return float(10.0**low)


def first_gap_u_um(open_voltage_v: float) -> float:
    """Standard uncertainty of a working gap that is only believed, µm."""
    return FIRST_GAP_U_UM * max(1.0, open_voltage_v / USUAL_VOLTAGE_V)


def first_sparks_um(open_voltage_v: float) -> tuple[float, float]:
    """How much before the working gap the first sparks come, and the standard uncertainty of that, µm."""
    factor = open_voltage_v / USUAL_VOLTAGE_V
    return FIRST_SPARKS_UM * factor, FIRST_SPARKS_U_UM * max(1.0, factor)
