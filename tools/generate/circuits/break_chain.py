"""Over-current, e-stop and door to the break input of the gate timer."""

from __future__ import annotations

from tools.generate.circuits.common import (
    HIGH_SHARE,
    INNER_PULL_OHM,
    KOHM,
    LOW_V,
    VDDA_SPREAD,
    VDDA_V,
    Check,
    Circuit,
    Needs,
    parallel,
)

CHAIN_OHM, CHAIN_PULL_OHM, OPTO_V, OPTO_DARK_A = 680.0, 10 * KOHM, 0.3, 10e-6
OFF_NS = {
    "comparator": 50.0,
    "chain": 20.0,
    "timer": 30.0,
    "isolator": 60.0,
    "driver": 60.0,
    "transistor": 60.0,
}
SEEN_OFF_US = 10.0


def hardware_break(n: Needs) -> Circuit:
    """Over-current, e-stop and door to the break input."""
    del n
    pulled = parallel(CHAIN_PULL_OHM, INNER_PULL_OHM[0])
    supply = VDDA_V * (1 - VDDA_SPREAD)
    high_v = (supply - OPTO_V) * pulled / (pulled + CHAIN_OHM)
    low_v = OPTO_DARK_A * parallel(CHAIN_PULL_OHM, INNER_PULL_OHM[1])
    ns = sum(OFF_NS.values())
    return Circuit(
        "chain",
        (
            (
                "contacts",
                "e-stop and door in series in a loop of 24 V, 4.7 kΩ and the LED of an optocoupler: 5 mA",
            ),
            ("to the node", f"transistor of the optocoupler from 3.3 V, then {CHAIN_OHM:g} Ω"),
            (
                "node",
                f"{CHAIN_PULL_OHM / KOHM:g} kΩ to ground; the MOSFET of the over-current comparator to "
                "ground; BREAK_CHAIN",
            ),
        ),
        (
            Check(
                "healthy is high",
                f"> {HIGH_SHARE * supply:.2f} V",
                f"{high_v:.2f} V",
                high_v > HIGH_SHARE * supply,
            ),
            Check("contacts open, the optocoupler hot", f"< {LOW_V} V", f"{low_v:.2f} V", low_v < LOW_V),
            Check(
                "over-current to gate off, all parts in a row",
                f"< {SEEN_OFF_US:g} µs",
                f"{ns / 1e3:.2f} µs",
                ns / 1e3 < SEEN_OFF_US,
            ),
        ),
    )
