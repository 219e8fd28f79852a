"""The estimate of removal and wear that a job works with: its start from the recipe, and energies from counts."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.process.discharge import hole_area_um2
from edmctl.process.live_erosion import Energy, ErosionEstimate

if TYPE_CHECKING:
    from edmctl.profile.model import Profile, Pulse

ARC_SHARE_OF_DISCHARGE_VOLTAGE = 0.77
"""An arc burns at 17 V where a normal discharge stands at 22 V."""
WALL_SHARE = 0.05
"""Discharges at the wall of the hole, until a depth was measured [assumed]."""


def estimate_of(profile: Profile) -> ErosionEstimate:
    """What the recipe knows before anything was machined."""
    work, wear = profile.work, profile.wear
    return ErosionEstimate(
        removal_um3_per_uj=work.removal_um3_per_uj * (1.0 - WALL_SHARE),
        removal_u_rel=work.removal_u_rel,
        wear_ratio=wear.expected_ratio,
        ratio_u_rel=wear.ratio_u_rel,
        hole_area_um2=hole_area_um2(profile.tool.diameter_um, work.side_gap_um),
    )


def energy_of(pulse: Pulse, counts: tuple[int, int, int, int] | list[int], energy_j: float) -> Energy:
    """Divide the energy of a cut among its classes of pulses (open, normal, arc, short).

    `energy_j` is all charge times the plateau voltage of a normal discharge. Arcs and shorts burn from the start of
    the pulse through the generator's resistance, so their charge follows from their number; the rest is normal.
    """
    _, _, arcs, shorts = counts
    plateau_v = pulse.discharge_voltage_v
    arc_v = ARC_SHARE_OF_DISCHARGE_VOLTAGE * plateau_v
    siemens = pulse.current_a / max(pulse.open_voltage_v - plateau_v, 0.1)
    arc_uc = arcs * siemens * (pulse.open_voltage_v - arc_v) * pulse.burning_time_us
    short_uc = shorts * siemens * pulse.open_voltage_v * pulse.burning_time_us
    normal_uc = max(0.0, 1e6 * energy_j / plateau_v - arc_uc - short_uc)
    return Energy(normal_uc * plateau_v, arc_uc * arc_v)
