"""What one discharge removes of workpiece and tool, the gap that the servo keeps, and how materials erode.

The laws take their shapes from what is known and their numbers mostly from no source: those marked [assumed] are
chosen so that the holes of Muralidhara et al. 2009 come out and the trends do. Sources:

* removal has an optimum of the on-time, long pulses spare a positive tool, which carbon from the oil covers: POCO,
  EDM Technical Manual, 2013, ch. 3; Juvkam-Wold, thesis, MIT 1967 (72 µs at 35 A; the exponent here gives
  220);
* the plasma of a longer discharge wears the cathode more in proportion to the anode: shares of energy change with
  the burning time (Maradia et al., J. Phys. D 48, 2015, 055202);
* craters of 1 to 17 A scatter by about 20 % and grow slower than the current first, faster later (ETH,
  WEDM-Learning-Environment).

The servo regulates the normalised level `s = mean gap voltage / (duty x open voltage)`: 1 means every pulse
stays open, `rho = discharge voltage / open voltage` means every pulse ignites at once. The ignition delay has
an exponential tail (Laue 1925), so its mean time constant against the on-time fixes the level.

A wider gap breaks down at a higher voltage, so what is believed of the working gap before any was measured grows in
proportion to the open voltage. Proportion is a belief [assumed], so its uncertainty grows alike, and the first gap
that a job measures takes its place.

Lengths in µm, times in µs, energies in µJ.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable
from functools import cache
from importlib.resources import files

from edmctl.dataclasses import dataclass

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


USUAL_CURRENT_A = 0.12  # peak current that the figures below hold for
USUAL_PULSE_UJ = pulse_energy_uj(22.0, USUAL_CURRENT_A, 1e6 * 0.30 / 2300.0)
"""Energy of a full pulse of Muralidhara et al. 2009, 344 µJ, by which gaps and deionisation are scaled."""


@dataclass(frozen=True, slots=True)
class ErosionLaw:
    """Constants of removal and wear of copper by copper."""

    removal_um3_per_uj: float = 0.0811
    """Work that a discharge of the best burning time removes if it were the anode alone [fitted]."""
    tool_share: float = 0.827  # wear of the same volume on the tool's side [fitted]
    peak_us: float = 40.0
    """Burning time of the most removal per energy at the usual current [assumed, 10 to 100]."""
    peak_exponent: float = 0.75  # how sharp that optimum is [assumed, 0.5 to 1]
    peak_per_current: float = 0.3  # power of the current by which the optimum moves [assumed, 0 to 1.35]
    threshold_uj: float = 1.0  # energy below which nothing is molten [assumed]
    cathode_least: float = 0.15
    """Erosion of the cathode over that of the anode in the shortest pulse [assumed]."""
    cathode_us: float = 568.0
    """Burning time that adds as much as the anode loses [fitted]: copper wears 70 µm in 180 µm of copper."""
    cathode_exponent: float = 0.8
    carbon_us: float = 60.0
    """Burning time after which carbon halves the wear of a positive tool at the usual current [assumed]."""
    carbon_per_current: float = -0.3


LAW = ErosionLaw()

Power = Callable[[float, float], float]
"""A power of a base. `math.pow` has other last digits on other computers; the virtual machine passes its own."""


def efficiency(law: ErosionLaw, burning_us: float, current_a: float, power: Power = math.pow) -> float:
    """Removal per energy over that of the best burning time, `2 x / (1 + x²)`: less on both sides of it."""
    best_us = law.peak_us * power(current_a / USUAL_CURRENT_A, law.peak_per_current)
    x = power(max(burning_us, 1e-9) / best_us, law.peak_exponent)
    return 2.0 * x / (1.0 + x * x)


def carbon_shield(law: ErosionLaw, burning_us: float, current_a: float, power: Power = math.pow) -> float:
    """Share of its wear that carbon leaves a positive tool in a hydrocarbon oil; long pulses deposit more."""
    half_us = law.carbon_us * power(current_a / USUAL_CURRENT_A, law.carbon_per_current)
    return 1.0 / (1.0 + (burning_us / half_us) ** 2)


def molten_uj(law: ErosionLaw, energy_uj: float) -> float:
    """Energy of a discharge that removes something."""
    return max(energy_uj - law.threshold_uj, 0.0)


def removal_um3_per_uj(
    law: ErosionLaw, burning_us: float, current_a: float, power: Power = math.pow, *, tool_negative: bool
) -> tuple[float, float]:
    """Work and tool removed per molten energy in clean oil, µm³/µJ, where both erode like copper."""
    r = law.cathode_least + power(burning_us / law.cathode_us, law.cathode_exponent)  # cathode's over anode's
    most = law.removal_um3_per_uj, law.removal_um3_per_uj * law.tool_share
    shares = 1.0 / (1.0 + r), r / (1.0 + r)
    if not tool_negative:
        shares = r / (1.0 + r), carbon_shield(law, burning_us, current_a, power) / (1.0 + r)
    best = efficiency(law, burning_us, current_a, power)
    return most[0] * best * shares[0], most[1] * best * shares[1]


SURFACE_UM = 3.0  # depth in which a floor's craters are others, some craters deep [assumed]


def roughness_ra_um(crater_um3: float, arc_share: float = 0.0, power: Power = math.pow) -> float:
    """Arithmetic mean roughness Ra of a surface of craters, µm: the cube root of their volume-weighted mean volume.

    Craters of one shape; 0.1 of that cube root, half as much again where all were arcs [assumed].
    """
    return 0.1 * power(crater_um3, 1.0 / 3.0) * (1.0 + 0.5 * arc_share)


def roughness_rz_um(ra_um: float) -> float:
    """Mean peak to valley height Rz of such a surface, µm: six times Ra [assumed]."""
    return 6.0 * ra_um


def corner_radius_um(wear_um: float, diameter_um: float) -> float:
    """Radius of a round tool's corner after so much wear of its length, µm.

    A corner wears faster than the face until it is so round that both wear alike: half as much as the length at
    first, and 0.15 of the diameter in the end [assumed].
    """
    last_um = 0.15 * diameter_um
    return -last_um * math.expm1(-0.5 * max(wear_um, 0.0) / last_um)


def widening_um(unhindered_um: float, side_gap_um: float, power: Power = math.pow) -> float:
    """How much wider a hole is at its mouth than at its bottom, on the radius, µm.

    `unhindered_um` is the volume that discharges took from the wall over the wall's area at that time, summed up.
    The wider the gap already, the later they ignite there, by its fourth power as at the face:
    `dr = (1 + r/s)^-4 dX` [assumed]. That straight tools make conical holes, by wear and by particles,
    is known (J. JSPE 65, 1999, 1793).
    """
    return side_gap_um * (power(1.0 + 5.0 * unhindered_um / side_gap_um, 0.2) - 1.0)


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


ASSUMED_U_REL = 0.3  # relative standard uncertainty of a figure that no measurement stands behind [assumed]


@dataclass(frozen=True, slots=True)
class Material:
    """Erosion of a material over that of copper in the same discharge: of work, and of a tool; None where unknown.

    `u_rel` is the relative standard uncertainty of both.
    """

    symbol: str
    name: str
    source: str
    removal: float | None = None
    wear: float | None = None
    u_rel: float = ASSUMED_U_REL


@cache
def materials() -> dict[str, Material]:
    """Every material of the table by its symbol."""
    text = files("edmctl.process").joinpath("materials.toml").read_text(encoding="utf-8")
    return {symbol: Material(symbol, **row) for symbol, row in tomllib.loads(text).items()}


def material(written: str) -> Material | None:
    """The material of a symbol or a name, in capitals or not; None where the table has none."""
    wanted = written.strip().casefold()
    return next((m for m in materials().values() if wanted in (m.symbol.casefold(), m.name.casefold())), None)
