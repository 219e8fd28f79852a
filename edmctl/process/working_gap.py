"""What is believed of the working gap before any was measured: it grows in proportion to the open voltage.

A wider gap breaks down at a higher voltage. Proportion is a belief [assumed], so its uncertainty grows alike, and
the first gap that a job measures takes its place.
"""

from __future__ import annotations

USUAL_VOLTAGE_V = 40.0
"""Open voltage that the figures below hold for."""
USUAL_GAP_UM = 3.4
"""Working gap at that voltage."""
FIRST_GAP_U_UM = 0.8
"""Standard uncertainty of a working gap that nobody has measured, at that voltage or below [assumed]."""
FIRST_SPARKS_UM = 1.2
"""First sparks come this much before the working gap, because they are judged by the first discharges."""
FIRST_SPARKS_U_UM = 1.5
"""Standard uncertainty of that, at that voltage or below [assumed]."""


def usual_gap_um(open_voltage_v: float) -> float:
    """Working gap that is believed where the recipe states none, µm."""
    return USUAL_GAP_UM * (open_voltage_v / USUAL_VOLTAGE_V)


def first_gap_u_um(open_voltage_v: float) -> float:
    """Standard uncertainty of a working gap that is only believed, µm."""
    return FIRST_GAP_U_UM * max(1.0, open_voltage_v / USUAL_VOLTAGE_V)


def first_sparks_um(open_voltage_v: float) -> tuple[float, float]:
    """How much before the working gap the first sparks come, and the standard uncertainty of that, µm."""
    factor = open_voltage_v / USUAL_VOLTAGE_V
    return FIRST_SPARKS_UM * factor, FIRST_SPARKS_U_UM * max(1.0, factor)
