"""Gap current: shunt, amplifier, comparators of ignition and over-current."""

from __future__ import annotations

from math import e
from typing import TYPE_CHECKING

from tools.generate.circuits.common import (
    COMPARATOR_V,
    KOHM,
    PF,
    STRAY_F,
    VDDA_V,
    Check,
    Circuit,
    Needs,
    parallel,
    within,
)
from tools.generate.circuits.gap_voltage import BOTTOM_OHM, RESISTOR_SPREAD, TAP_F, TOP_OHM, TOPS

if TYPE_CHECKING:
    from collections.abc import Iterator


SHUNTS: dict[str, tuple[float, float | None, float]] = {
    "image as it is": (0.05, None, 0.05),
    "finer range": (0.5, 1.2, 0.015),
}
"""Shunt in ohms, full scale (None: that of the image) and ignition threshold in amperes."""
GAIN_TOP_OHM, GAIN_BOTTOM_OHM = 4.5 * KOHM, 1.0 * KOHM
AMPLIFIER_V, AMPLIFIER_HZ = 0.25e-3, 50e6
ADC_OFFSET_COUNTS = 2.5
OVER_SHARE = 11.0 / 12.0
SHUNT_SPREAD, REFERENCE_SPREAD = 0.01, 0.01
BLANK_S = 0.5e-6


def blank_s(open_v: float, threshold_a: float) -> float:
    """Longest time for which charging the gap's stray capacitance, by any resistor, looks like a discharge."""
    return open_v * STRAY_F / (e * threshold_a)


def shunt_checks(n: Needs, name: str) -> Iterator[Check]:
    """What one range of the current reaches."""
    ohm, own_a, threshold_a = SHUNTS[name]
    full_a = own_a or n.scale["EDM_GAP_FULL_A"]
    gain = 1.0 + GAIN_TOP_OHM / GAIN_BOTTOM_OHM
    volt_per_a = gain * ohm
    count_a = full_a / n.top
    offset_a = AMPLIFIER_V / ohm + ADC_OFFSET_COUNTS * count_a
    ignition_a = COMPARATOR_V / volt_per_a
    over_a = OVER_SHARE * full_a
    over_spread = SHUNT_SPREAD + 2 * RESISTOR_SPREAD + REFERENCE_SPREAD
    least_over_a = over_a * (1 - over_spread) - COMPARATOR_V / volt_per_a
    most_over_a = over_a * (1 + over_spread) + COMPARATOR_V / volt_per_a
    limit_a = full_a * n.limits["EDM_CURRENT_A_MAX"] / n.scale["EDM_GAP_FULL_A"]
    longest_v = BLANK_S * e * threshold_a / STRAY_F
    yield Check(
        f"{name}: full scale at 3.3 V",
        f"{full_a:g} A",
        f"{VDDA_V / volt_per_a:.3f} A",
        within(VDDA_V / volt_per_a, full_a, 1e-6),
    )
    yield Check(
        f"{name}: one count; 0.12 A in counts",
        "> 20 counts",
        f"{1e3 * count_a:.2f} mA; {0.12 / count_a:.0f}",
        0.12 / count_a > 20,
    )
    yield Check(
        f"{name}: offset of amplifier and converter",
        f"< {1e3 * n.measure['LEAST_A']:g} mA",
        f"{1e3 * offset_a:.1f} mA",
        offset_a < n.measure["LEAST_A"],
    )
    yield Check(
        f"{name}: ignition threshold",
        "< half of the peak current; > twice its error",
        f"{1e3 * threshold_a:g} ± {1e3 * ignition_a:.1f} mA",
        threshold_a > 2 * ignition_a,
    )
    yield Check(
        f"{name}: charging {STRAY_F / PF:g} pF is over within the blanking of {1e6 * BLANK_S:g} µs",
        "open voltage used",
        f"up to {min(longest_v, n.limits['EDM_OPEN_V_MAX']):.0f} V",
        longest_v > 80.0,
    )
    yield Check(
        f"{name}: over-current threshold",
        f"{limit_a:g} to {full_a:g} A",
        f"{least_over_a:.3g} to {most_over_a:.3g} A",
        limit_a < least_over_a and most_over_a < full_a,
    )


def current_sense(n: Needs) -> Circuit:
    """Gap current to 0 to 3.3 V, ignition and over-current."""
    gain = 1.0 + GAIN_TOP_OHM / GAIN_BOTTOM_OHM
    return Circuit(
        "current",
        (
            (
                "shunt",
                ", ".join(
                    f"{ohm * 1e3:g} mΩ ({name}, {full or n.scale['EDM_GAP_FULL_A']:g} A)"
                    for name, (ohm, full, _) in SHUNTS.items()
                )
                + "; 1 %, four terminals, low inductance",
            ),
            (
                "amplifier",
                f"not inverting, 1 + {GAIN_TOP_OHM / KOHM:g} kΩ / {GAIN_BOTTOM_OHM / KOHM:g} kΩ = "
                f"{gain:g}; 50 MHz, offset below {AMPLIFIER_V * 1e3:g} mV (OPA365 class), "
                "supplied as the buffer of the gap voltage",
            ),
            (
                "corner of the converter's path",
                f"{parallel(TOPS * TOP_OHM, BOTTOM_OHM) / KOHM:.1f} kΩ, {TAP_F / PF:g} pF and a buffer, "
                "as that of the voltage: both are of the same instant",
            ),
            (
                "ignition comparator",
                "push-pull, below 50 ns, hysteresis a fifth of the threshold, from the amplifier before "
                f"the corner; held low for {1e6 * BLANK_S:g} µs from the rise of GATE_SENSE "
                "(monoflop and AND)",
            ),
            (
                "over-current comparator",
                f"at {OVER_SHARE * VDDA_V:.3f} V from the amplifier; drives the gate of a small MOSFET "
                "(BSS138 class) that pulls the break chain down",
            ),
        ),
        (
            *(check for name in SHUNTS for check in shunt_checks(n, name)),
            Check(
                "bandwidth of the amplifier",
                "> 4 MHz",
                f"{AMPLIFIER_HZ / gain / 1e6:.1f} MHz",
                AMPLIFIER_HZ / gain > 4e6,
            ),
        ),
    )
