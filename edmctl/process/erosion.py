"""Pulse energy and what it removes: from the electrical settings to a feed rate."""

from __future__ import annotations

import math


def pulse_energy_uj(discharge_voltage_v: float, current_a: float, on_time_us: float) -> float:
    """Energy in µJ of a pulse that burns for its whole on-time, `u_e * I * t_on`."""
    return discharge_voltage_v * current_a * on_time_us


def average_power_uj_s(frequency_hz: float, energy_uj: float, burning_share: float) -> float:
    """Mean discharge power in µJ/s: pulses per second, energy of a full on-time, mean share that burns."""
    return frequency_hz * energy_uj * burning_share


def tool_area_um2(diameter_um: float) -> float:
    """Face of a round tool, µm²."""
    return math.pi / 4.0 * diameter_um**2


def hole_area_um2(diameter_um: float, side_gap_um: float) -> float:
    """Cross-section of the hole that a round tool makes, µm²: the tool plus the side gap all round."""
    return tool_area_um2(diameter_um + 2.0 * side_gap_um)


def removal_rate_um3_s(power_uj_s: float, removal_um3_per_uj: float) -> float:
    """Work removal in µm³/s."""
    return removal_um3_per_uj * power_uj_s


def mrr_mm3_min(removal_um3_s: float) -> float:
    """Material removal rate (MRR) in the trade's unit, mm³/min."""
    return removal_um3_s * 60.0 / 1e9


def depth_rate_um_s(
    removal_um3_s: float, *, diameter_um: float, side_gap_um: float, side_share: float
) -> float:
    """Rate in µm/s at which the bottom sinks; `side_share` of the discharges burn at the wall."""
    return removal_um3_s * (1.0 - side_share) / hole_area_um2(diameter_um, side_gap_um)


def linear_wear_ratio(volumetric_ratio: float, *, diameter_um: float, side_gap_um: float) -> float:
    """Wear length per depth from the volumetric relative wear: the hole is wider than the tool."""
    return volumetric_ratio * hole_area_um2(diameter_um, side_gap_um) / tool_area_um2(diameter_um)


def feed_rate_um_s(
    removal_um3_s: float, *, diameter_um: float, side_gap_um: float, side_share: float, wear_ratio: float
) -> float:
    """Tool feed in µm/s while sparking: the bottom sinks and the tool shortens by `wear_ratio` of that."""
    sinking = depth_rate_um_s(
        removal_um3_s, diameter_um=diameter_um, side_gap_um=side_gap_um, side_share=side_share
    )
    return sinking * (1.0 + wear_ratio)
