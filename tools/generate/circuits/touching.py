"""What touches: contact circuit and mode switch."""

from __future__ import annotations

from math import log

from tools.generate.circuits.common import (
    COMPARATOR_V,
    KOHM,
    NF,
    VDDA_SPREAD,
    VDDA_V,
    Check,
    Circuit,
    Needs,
    parallel,
)
from tools.generate.circuits.gap_voltage import BOTTOM_OHM, TOP_OHM, TOPS

CONTACT_DIVIDER_OHM, CONTACT_SERIES_OHM, CONTACT_THRESHOLD_V = (30 * KOHM, 10 * KOHM), 30 * KOHM, 0.15
INPUT_OHM = 100 * KOHM
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
                "on the source's side of the mode switch, through 100 kΩ, 2 W, 350 V, with 1 nF and clamp: "
                "CONTACT high below "
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


SWITCHES = (("relay", 5e-3), ("reed relay", 1e-3), ("semiconductors", 0.1e-3))
"""Kinds of mode switch, and how long each takes until it has settled, bounce included."""
MODE_SHARE = 0.5
"""Of `misread_pulses`, that a switch may take."""
LEAST_HZ = 2300.0
"""Of the checklist and the shipped profiles."""


GUARD_OHM, GUARD_F = 120 * KOHM, 100 * NF
GUARD_SHARES = (0.27, 0.18, 0.10)
"""Falling threshold of a 74HCT14 over its supply: most, usual, least."""
GUARD_START = 0.94
"""Of the supply, behind the diode."""


def guard_s(share: float) -> float:
    """How long the contact may contradict MODE, by the trigger's threshold over its supply."""
    return GUARD_OHM * GUARD_F * log(GUARD_START / share)


def settled_s(n: Needs, hertz: float) -> float:
    """Within which time the mode switch has to have settled at a frequency of the generator."""
    return MODE_SHARE * n.params["misread_pulses"] / hertz


def mode_switch(n: Needs) -> Circuit:
    """Generator or contact circuit at the gap."""
    most_hz = 1e9 / n.limits["EDM_PERIOD_NS_MIN"]
    (_, slowest_s), (_, fastest_s) = SWITCHES[0], SWITCHES[-1]
    return Circuit(
        "mode",
        (
            (
                "switch",
                "one changeover, break before make; from the gap's plus to the series resistors (MODE "
                "high) or to the contact circuit (MODE low)",
            ),
            (
                "drive",
                "MOSFET (BSS138 class) at a coil of 5 V with its diode; without supply it is at the contact circuit",
            ),
            (
                "settled, bounce included",
                "; ".join(
                    f"{kind} {1e3 * time_s:g} ms: up to {settled_s(n, 1.0) / time_s / 1e3:g} kHz"
                    for kind, time_s in SWITCHES
                ),
            ),
            (
                "guard",
                f"force-guided second contact; where it contradicts MODE for 20 ms (XOR, {GUARD_OHM / KOHM:g} kΩ "
                f"and {GUARD_F / NF:g} nF, Schmitt trigger), a MOSFET pulls HV_SUPPLY low; a diode "
                "(BAT54 class) and 1 kΩ begin the wait anew",
            ),
        ),
        (
            Check(
                f"settled after MODE has gone high, at {LEAST_HZ / 1e3:g} kHz",
                f"< {1e3 * settled_s(n, LEAST_HZ):.1f} ms",
                f"{1e3 * slowest_s:g} ms, {SWITCHES[0][0]}",
                slowest_s < settled_s(n, LEAST_HZ),
            ),
            Check(
                f"the same at the greatest frequency, {most_hz / 1e3:g} kHz",
                f"< {1e3 * settled_s(n, most_hz):.1f} ms",
                f"{1e3 * fastest_s:g} ms, {SWITCHES[-1][0]}",
                fastest_s < settled_s(n, most_hz),
            ),
            Check(
                "the guard waits for the relay",
                f"> {2e3 * slowest_s:g} ms; < 50 ms [assumed]",
                f"{1e3 * guard_s(GUARD_SHARES[1]):.0f} ms, worst case {1e3 * guard_s(GUARD_SHARES[0]):.0f} to "
                f"{1e3 * guard_s(GUARD_SHARES[2]):.0f} ms",
                guard_s(GUARD_SHARES[0]) > 2 * slowest_s and guard_s(GUARD_SHARES[2]) < 50e-3,
            ),
        ),
    )
