"""The gap beside its voltage law: deionisation, arcs, bridges of debris, clearance, and the gap at the wall.

No source gives these as numbers for a gap of micrometres in kerosene, so the constants are [assumed], within the
ranges stated; what they rest on is said with each function. Lengths in µm, times in µs, energies in µJ.
"""

from __future__ import annotations

import math

from edmctl.dataclasses import dataclass
from edmctl.process.erosion import USUAL_PULSE_UJ, Power


@dataclass(frozen=True, slots=True)
class GapLaw:
    """Constants of the gap's condition; debris is a fraction of the gap's volume."""

    gap_reference_um: float = 2.5
    """Gap of the next delay at 40 V: 13 to 20 V/µm, near the strength of clean oil [assumed]."""
    tau_reference_us: float = 60.0  # mean statistical ignition delay there [assumed]
    gap_exponent: float = 4.0
    """Power of the gap by which that delay grows; ETH has 2 for water, oil is steeper [assumed]."""
    debris_gap_factor: float = 1.5  # narrowing of the gap per debris [assumed]
    flush_time_s: float = 0.5
    """Clearance of a shallow working gap under a tool of 270 µm; it grows with the tool's area [assumed]."""
    flush_depth_ratio: float = 1.1
    """Depth over diameter at which clearance takes twice as long [fitted]: a tool of 270 µm takes 2.9 times as
    long as one of 150 µm for the same feed (Muralidhara et al. 2009, section 3.2)."""
    redeposition: float = 0.19
    """Debris at which half of the removal is lost on debris or deposited again (0.12 to 0.4)."""
    side_base: float = 0.03
    """Share of discharges at the wall in a clean gap, and what is added per debris in a deep hole [assumed]."""
    side_debris: float = 0.6
    arc_base: float = 0.01
    arc_debris: float = 0.16  # debris at which a discharge arcs that follows another without delay [assumed]
    arc_delay_us: float = 20.0  # delay in which that fades [assumed]
    arc_pause_us: float = 800.0  # off-time that halves it [assumed]
    arc_work: float = 0.15
    """Work that an arc removes over that of a discharge of its energy, and tool [assumed]."""
    arc_tool: float = 0.9
    deionisation_us: float = 15.0
    """Time constant of a channel's conductivity after a usual pulse in clean oil (6 to 25): 6 µs are known of water,
    and 15 µs are the least off-time that kept a published pulser from arcing."""
    deionisation_exponent: float = 0.3
    deionisation_debris: float = 4.0  # how much longer per debris [assumed]
    deionisation_after_arc: float = 1.5
    bridge_base: float = 0.2
    """Chance of a chain of particles across half a particle's gap packed full (0.1 to 1)."""
    particle_um: float = 0.9  # diameter of the particles of a usual pulse, about half a crater (0.7 to 1.2)
    side_per_voltage_um: float = 4.0
    """Gap at the wall by voltage, at 40 V; with the next, 7.3 to 7.5 µm were measured at similar energies (Chiou,
    Tsao & Hsu, Int. J. Adv. Manuf. Technol. 78, 2015)."""
    side_per_energy_um: float = 4.0  # gap at the wall by the size of craters, at a usual pulse


GAP_LAW = GapLaw()
USUAL_OPEN_V = 40.0
ARC_V = 17.0  # plateau of an arc
SHORT_V = 1.0  # voltage of a shorted gap
BRIDGE_CLEAR = 0.02  # chance per pulse that a bridge burns off [assumed]
FLUSH_DIAMETER_UM = 270.0  # diameter of the tool that the flush time holds for
CLEARING = (0.0625, 4.0)  # least and most that clearance changes with the gap [assumed]
MOST_DEBRIS = 0.6  # a gap packed full: about the densest random packing of spheres


def crater_scale(full_pulse_uj: float, power: Power = math.pow) -> float:
    """Linear size of craters and particles of a full pulse over that of the usual one: the energy's cube root."""
    return power(full_pulse_uj / USUAL_PULSE_UJ, 1.0 / 3.0)


def deionisation_us(law: GapLaw, energy_uj: float, power: Power = math.pow) -> float:
    """Time constant in which a discharge's channel loses its conductivity in clean oil, µs."""
    return law.deionisation_us * power(energy_uj / USUAL_PULSE_UJ, law.deionisation_exponent)


def working_gap_um(law: GapLaw, open_voltage_v: float) -> float:
    """Gap for which the flush time holds, µm: where a servo usually keeps it."""
    return 1.3 * law.gap_reference_um * open_voltage_v / USUAL_OPEN_V


def flush_time_s(law: GapLaw, diameter_um: float, depth_um: float) -> float:
    """Time constant in which debris leaves a working gap at the bottom of a hole, s."""
    deep = depth_um / (law.flush_depth_ratio * diameter_um)
    return law.flush_time_s * (diameter_um / FLUSH_DIAMETER_UM) ** 2 * (1.0 + deep * deep)


def side_gap_um(law: GapLaw, open_voltage_v: float, full_pulse_uj: float, power: Power = math.pow) -> float:
    """Gap between tool and wall, µm: what the voltage breaks through, and what a crater takes out beyond."""
    by_voltage = law.side_per_voltage_um * open_voltage_v / USUAL_OPEN_V
    return by_voltage + law.side_per_energy_um * crater_scale(full_pulse_uj, power)
