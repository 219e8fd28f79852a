"""Over-current, e-stop and door to the break input of the gate timer; the contacts of both switches."""

from __future__ import annotations

from math import log

from tools.generate.circuits.common import (
    HIGH_SHARE,
    INNER_PULL_OHM,
    KOHM,
    LOW_V,
    NF,
    VDDA_SPREAD,
    VDDA_V,
    Check,
    Circuit,
    Needs,
    parallel,
)
from tools.generate.circuits.generator import CAPACITOR_SPREAD, SHORT_S

CHAIN_OHM, CHAIN_PULL_OHM, OPTO_V, OPTO_DARK_A = 680.0, 10 * KOHM, 0.3, 10e-6
LOOP_V, LOOP_SPREAD, LOOP_OHM, LOOP_W = 24.0, 0.1, 4.7 * KOHM, 0.5
"""Loop of a contact: its supply, and the resistor, with the power that it is rated for."""
FILTER_OHM, FILTER_F, FILTER_SPREAD = 1 * KOHM, 1 * NF, 0.01
MOSFET_OHM, GATE_OHM = 10.0, 220.0
"""Of the over-current's MOSFET: closed, and the resistor at its gate."""
FILTER_MOST_S, GLITCH_S = 2e-6, 0.1e-6
"""How late the filter may make the break, and how long a glitch must do nothing [assumed]."""
OFF_NS = {
    "comparator": 50.0,
    "chain": 20.0,
    "timer": 30.0,
    "enable": 20.0,
    "isolator": 60.0,
    "driver": 60.0,
    "transistor": 60.0,
}

CONTACTS = (
    ("coil of the contactor", "mains of high voltage and amplifier off, without electronics", True, True),
    ("loop of the break chain", "pulses off, without the program", True, True),
    ("loop of ESTOP, of DOOR", "tells the controller: faults 4001 and 4002, the tool goes back", True, True),
    ("AND of the high-voltage enable", "high voltage and gate driver off, without the chip", True, False),
)
"""Where a contact of its own is, what it does, and which switch has one there: e-stop, door."""
LOOPS = ("break chain", "ESTOP", "DOOR", "enable", "LEVEL", "LIMITS", "HV_SUPPLY")
"""Loops of 24 V, each with an optocoupler."""


def contacts() -> tuple[int, int]:
    """How many opening contacts e-stop and door need."""
    return sum(estop for *_, estop, _ in CONTACTS), sum(door for *_, door in CONTACTS)


def contact_rows() -> list[tuple[str, str, str, str]]:
    """Return the list of contacts, and their sum."""
    rows = [
        (where, does, "1" if estop else "–", "1" if door else "–") for where, does, estop, door in CONTACTS
    ]
    estops, doors = contacts()
    return [*rows, ("all, opening", "", str(estops), str(doors))]


def filter_s() -> float:
    """Longest time from the MOSFET's closing until the pin is low."""
    tau_s = FILTER_OHM * (1 + FILTER_SPREAD) * FILTER_F * (1 + CAPACITOR_SPREAD)
    high_v = VDDA_V * (1 + VDDA_SPREAD)
    rest_v = high_v * MOSFET_OHM / (MOSFET_OHM + CHAIN_OHM)
    return tau_s * log((high_v - rest_v) / (LOW_V - rest_v))


def healthy_v() -> float:
    """Least voltage of the pin while the chain is closed."""
    pin_ohm = INNER_PULL_OHM[0] + FILTER_OHM
    pulled = parallel(CHAIN_PULL_OHM, pin_ohm)
    node_v = (VDDA_V * (1 - VDDA_SPREAD) - OPTO_V) * pulled / (pulled + CHAIN_OHM)
    return node_v * INNER_PULL_OHM[0] / pin_ohm


def glitch_s() -> float:
    """Shortest low of the node that may reach the pin: it falls from its least voltage to the highest threshold."""
    tau_s = FILTER_OHM * (1 - FILTER_SPREAD) * FILTER_F * (1 - CAPACITOR_SPREAD)
    return tau_s * log(healthy_v() / (HIGH_SHARE * VDDA_V * (1 - VDDA_SPREAD)))


def loop_w() -> float:
    """Greatest lasting power of a loop's resistor, as if the LED were a short."""
    return (LOOP_V * (1 + LOOP_SPREAD)) ** 2 / LOOP_OHM


def hardware_break(n: Needs) -> Circuit:
    """Over-current, e-stop and door to the break input."""
    del n
    least_high_v = HIGH_SHARE * VDDA_V * (1 - VDDA_SPREAD)
    low_v = OPTO_DARK_A * parallel(CHAIN_PULL_OHM, INNER_PULL_OHM[1] + FILTER_OHM)
    off_s = 1e-9 * sum(OFF_NS.values()) + filter_s()
    return Circuit(
        "chain",
        (
            (
                "contacts",
                f"e-stop and door in series in a loop of {LOOP_V:g} V, {LOOP_OHM / KOHM:g} kΩ, {LOOP_W:g} W, and "
                f"the LED of an optocoupler: {1e3 * LOOP_V / LOOP_OHM:.0f} mA",
            ),
            ("to the node", f"transistor of the optocoupler from 3.3 V, then {CHAIN_OHM:g} Ω"),
            (
                "node",
                f"{CHAIN_PULL_OHM / KOHM:g} kΩ to ground; the MOSFET of the over-current comparator to ground, "
                f"{GATE_OHM:g} Ω at its gate",
            ),
            (
                "filter",
                f"{FILTER_OHM / KOHM:g} kΩ from the node to BREAK_CHAIN, {FILTER_F / NF:g} nF (C0G) to ground at "
                f"the pin: {1e6 * FILTER_OHM * FILTER_F:g} µs",
            ),
        ),
        (
            Check(
                "healthy is high",
                f"> {least_high_v:.2f} V",
                f"{healthy_v():.2f} V",
                healthy_v() > least_high_v,
            ),
            Check("contacts open, the optocoupler hot", f"< {LOW_V} V", f"{low_v:.2f} V", low_v < LOW_V),
            Check(
                "the filter makes the break later by",
                f"< {1e6 * FILTER_MOST_S:g} µs",
                f"{1e6 * filter_s():.2f} µs",
                filter_s() < FILTER_MOST_S,
            ),
            Check(
                "low of the node that does nothing",
                f"> {1e6 * GLITCH_S:g} µs [assumed]",
                f"{1e6 * glitch_s():.2f} µs at the worst threshold, "
                f"{1e6 * FILTER_OHM * FILTER_F * log(2.0):.1f} µs at half of the supply",
                glitch_s() > GLITCH_S,
            ),
            Check(
                "over-current to gate off, all parts in a row",
                f"< {1e6 * SHORT_S:g} µs: what the transistor bears of a short",
                f"{1e6 * off_s:.2f} µs",
                off_s < SHORT_S,
            ),
            Check(
                f"power of a loop's {LOOP_OHM / KOHM:g} kΩ at {LOOP_V * (1 + LOOP_SPREAD):.1f} V, contacts closed",
                f"< half of {LOOP_W:g} W",
                f"{loop_w():.2f} W",
                loop_w() < LOOP_W / 2.0,
            ),
        ),
    )
