"""What touches: contact circuit and mode switch."""

from __future__ import annotations

from tools.generate.circuits.common import (
    COMPARATOR_V,
    KOHM,
    VDDA_SPREAD,
    VDDA_V,
    Check,
    Circuit,
    Needs,
    parallel,
)
from tools.generate.circuits.gap_voltage import BOTTOM_OHM, TOP_OHM, TOPS

CONTACT_DIVIDER_OHM, CONTACT_SERIES_OHM, CONTACT_THRESHOLD_V = (30 * KOHM, 10 * KOHM), 30 * KOHM, 0.15
BATTERY_V, BATTERY_OHM = 9.0, 1 * KOHM


def contact(n: Needs) -> Circuit:
    """Tool and work as a switch, in measure mode."""
    source_v = VDDA_V * CONTACT_DIVIDER_OHM[1] / sum(CONTACT_DIVIDER_OHM)
    source_ohm = parallel(*CONTACT_DIVIDER_OHM) + CONTACT_SERIES_OHM
    sensor_ohm = TOPS * TOP_OHM + BOTTOM_OHM
    open_v = source_v * (1 + VDDA_SPREAD) * sensor_ohm / (sensor_ohm + source_ohm)
    closes = [
        source_ohm * volt / (source_v * (1 + spread) - volt)
        for spread in (-VDDA_SPREAD, VDDA_SPREAD)
        for volt in (CONTACT_THRESHOLD_V - COMPARATOR_V, CONTACT_THRESHOLD_V + COMPARATOR_V)
    ]
    battery_v = BATTERY_V - (BATTERY_V - source_v) * BATTERY_OHM / (BATTERY_OHM + source_ohm)
    fault_ma = 1e3 * n.limits["EDM_OPEN_V_MAX"] / CONTACT_SERIES_OHM
    fault_w = n.limits["EDM_OPEN_V_MAX"] ** 2 / CONTACT_SERIES_OHM
    return Circuit(
        "contact",
        (
            (
                "source",
                f"3.3 V through {CONTACT_DIVIDER_OHM[0] / KOHM:g} kΩ, {CONTACT_DIVIDER_OHM[1] / KOHM:g} "
                f"kΩ to ground; then {CONTACT_SERIES_OHM / KOHM:g} kΩ, 5 W, to the mode switch; clamp "
                "behind the 10 kΩ",
            ),
            (
                "comparator",
                "on the side of the source, through 100 kΩ with 1 nF and clamp: CONTACT high below "
                f"{CONTACT_THRESHOLD_V:g} V, hysteresis 30 mV",
            ),
        ),
        (
            Check(
                "voltage at an open gap",
                f"< {n.measure['LEAST_GAP_V']:g} V: more reads as a gap voltage",
                f"{open_v:.2f} V",
                open_v < n.measure["LEAST_GAP_V"],
            ),
            Check(
                "closes below",
                "1 to 20 kΩ [assumed]",
                f"{min(closes) / KOHM:.1f} to {max(closes) / KOHM:.1f} kΩ",
                min(closes) > 1 * KOHM and max(closes) < 20 * KOHM,
            ),
            Check(
                "current at contact",
                "< 1 mA",
                f"{1e6 * source_v / source_ohm:.0f} µA",
                source_v / source_ohm < 1e-3,
            ),
            Check(
                "a battery of 9 V behind 1 kΩ still reads within 10 % and 0.3 V",
                f"> {0.9 * BATTERY_V - 0.3:g} V",
                f"{battery_v:.2f} V",
                battery_v > 0.9 * BATTERY_V - 0.3,
            ),
            Check(
                "current into the source's clamp if the mode switch bridges",
                "< 20 mA and 5 W",
                f"{fault_ma:.1f} mA, {fault_w:.1f} W in the resistor",
                fault_ma < 20.0 and fault_w < 5.0,
            ),
        ),
    )


RELAY_S, FAST_S = 5e-3, 0.5e-3


def mode_switch(n: Needs) -> Circuit:
    """Generator or contact circuit at the gap."""
    pulses, period_s = n.params["misread_pulses"], 1e-9 * n.limits["EDM_PERIOD_NS_MIN"]
    relay_hz, fast_hz = pulses / RELAY_S, pulses / FAST_S
    return Circuit(
        "mode",
        (
            (
                "switch",
                "one changeover, break before make; from the gap's plus to the series resistors (MODE "
                "high) or to the contact circuit (MODE low)",
            ),
            ("drive", "10 kΩ from MODE to ground; without supply it is at the contact circuit"),
            (
                "guard",
                "force-guided second contact; where it contradicts MODE for 20 ms, the loop of HV_SUPPLY opens",
            ),
        ),
        (
            Check(
                f"relay of {1e3 * RELAY_S:g} ms with bounce: generator frequency at most",
                "> 2.3 kHz",
                f"{relay_hz / 1e3:g} kHz",
                relay_hz > 2300.0,
            ),
            Check(
                f"switch of {1e3 * FAST_S:g} ms, of semiconductors: frequency at most",
                f"> {1e-3 / period_s:g} kHz",
                f"{fast_hz / 1e3:g} kHz",
                fast_hz > 1 / period_s,
            ),
        ),
    )
