"""What the comparators compare with: one reference, and what is made of it."""

from __future__ import annotations

from tools.generate.circuits.charge_pump import PUMP_THRESHOLD_V
from tools.generate.circuits.common import KOHM, VDDA_V, Check, Circuit, Needs, within
from tools.generate.circuits.gap_current import (
    GAIN_BOTTOM_OHM,
    GAIN_TOP_OHM,
    OVER_SHARE,
    REFERENCE_SPREAD,
    SHUNTS,
)
from tools.generate.circuits.touching import CONTACT_THRESHOLD_V

REFERENCE_V, SPREAD = 2.5, 0.002
"""Of a series reference (REF3025 class)."""
RESISTOR_SPREAD = 0.001
OVER_OHM = (2.1 * KOHM, 10 * KOHM)
"""Of the amplifier that makes the over-current threshold: feedback, and to ground."""
FROM_REFERENCE_OHM, IGNITION_OHM, CONTACT_OHM = 100 * KOHM, (549.0, 1.69 * KOHM), 6.34 * KOHM
HYSTERESIS_OHM = 649 * KOHM
"""Dividers: from the reference; to ground for the ignition, in the order of SHUNTS, and for the contact,
whose comparator has that resistor from its output."""


def over_v() -> float:
    """Threshold of the over-current comparator."""
    return REFERENCE_V * (1 + OVER_OHM[0] / OVER_OHM[1])


def divided_v(ohm: float) -> float:
    """Threshold behind a divider with that resistor to ground."""
    return REFERENCE_V * ohm / (ohm + FROM_REFERENCE_OHM)


def ignition_v(name: str) -> float:
    """Threshold of the ignition comparator that a range of the current wants."""
    shunt_ohm, _, threshold_a = SHUNTS[name]
    return threshold_a * shunt_ohm * (1 + GAIN_TOP_OHM / GAIN_BOTTOM_OHM)


def thresholds(n: Needs) -> Circuit:
    """Thresholds of all comparators."""
    del n
    wanted_v = OVER_SHARE * VDDA_V
    over_spread = SPREAD + 2 * RESISTOR_SPREAD * OVER_OHM[0] / sum(OVER_OHM)
    fine = tuple(zip(SHUNTS, IGNITION_OHM, strict=True))
    return Circuit(
        "references",
        (
            (
                "reference",
                f"{REFERENCE_V:g} V, {100 * SPREAD:g} %, from 5 V (REF3025 class), 100 nF at its output; the pump's "
                "threshold as it is",
            ),
            (
                "over-current",
                f"amplifier from 5 V, 1 + {OVER_OHM[0] / KOHM:g} kΩ / {OVER_OHM[1] / KOHM:g} kΩ, 0.1 %",
            ),
            (
                "ignition",
                f"{FROM_REFERENCE_OHM / KOHM:g} kΩ from the reference, to ground "
                + ", ".join(f"{_ohm(ohm)} ({name})" for name, ohm in fine)
                + "; 100 nF",
            ),
            (
                "contact",
                f"{FROM_REFERENCE_OHM / KOHM:g} kΩ from the reference, {_ohm(CONTACT_OHM)} to ground; "
                f"{_ohm(HYSTERESIS_OHM)} from the comparator's output, no capacitor",
            ),
        ),
        (
            Check(
                "threshold of the over-current",
                f"{wanted_v:.3f} V within {100 * REFERENCE_SPREAD:g} %",
                f"{over_v():.3f} V within {100 * over_spread:.1f} %",
                within(over_v(), wanted_v, REFERENCE_SPREAD - over_spread),
            ),
            *(
                Check(
                    f"threshold of the ignition, {name}",
                    f"{1e3 * ignition_v(name):.1f} mV within 2 %",
                    f"{1e3 * divided_v(ohm):.1f} mV",
                    within(divided_v(ohm), ignition_v(name), 0.02 - SPREAD - 2 * RESISTOR_SPREAD),
                )
                for name, ohm in fine
            ),
            Check(
                "threshold of the contact",
                f"{1e3 * CONTACT_THRESHOLD_V:g} mV within 2 %",
                f"{1e3 * divided_v(CONTACT_OHM):.1f} mV",
                within(divided_v(CONTACT_OHM), CONTACT_THRESHOLD_V, 0.02 - SPREAD - 2 * RESISTOR_SPREAD),
            ),
            Check(
                "threshold of the charge pump",
                f"{PUMP_THRESHOLD_V:g} V within 2 %",
                f"{REFERENCE_V:g} V within {100 * SPREAD:g} %",
                within(REFERENCE_V, PUMP_THRESHOLD_V, 0.02 - SPREAD),
            ),
        ),
    )


def _ohm(ohm: float) -> str:
    return f"{ohm / KOHM:g} kΩ" if ohm >= KOHM else f"{ohm:g} Ω"
