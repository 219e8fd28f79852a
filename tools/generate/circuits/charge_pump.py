"""The charge pump that makes the high-voltage enable of ALIVE."""

from __future__ import annotations

from math import exp, log
from typing import TYPE_CHECKING

from tools.generate.circuits.common import KOHM, NF, Check, Circuit, Needs
from tools.generate.circuits.generator import CAPACITOR_SPREAD

if TYPE_CHECKING:
    from collections.abc import Iterator


PUMP_SWING_V, PUMP_DIODE_V, PUMP_F, STORE_F, STORE_OHM, PUMP_THRESHOLD_V = (
    5.0,
    0.3,
    220 * NF,
    470 * NF,
    47 * KOHM,
    2.5,
)
EDGE_S = 2e-3
"""From rise to rise of ALIVE, which toggles every millisecond."""
LATCH_OHM, LATCH_F = 33 * KOHM, 100 * NF
SCHMITT_SHARES = (0.22, 0.28, 0.38)
"""Rising threshold of a 74HCT14 over its supply: least, usual, most."""
HOLD_S = (4e-3, 20e-3)


def pump(swing_v: float, diode_v: float, pump_f: float, store_f: float, ohm: float) -> Iterator[float]:
    """Voltages of the store just after each rising edge, from 0 on."""
    volt, share, rest = 0.0, pump_f / (pump_f + store_f), exp(-EDGE_S / (store_f * ohm))
    while True:
        volt += share * max(0.0, swing_v - 2.0 * diode_v - volt)
        yield volt
        volt *= rest


def hold_s(
    swing_v: float, diode_v: float, pump_f: float, store_f: float, ohm: float, threshold_v: float
) -> tuple[float, int]:
    """Time from the last rising edge until the enable falls, and how many edges it takes; 0 if it never rises."""
    edges, volt = 0, 0.0
    for count, volt in zip(range(1, 500), pump(swing_v, diode_v, pump_f, store_f, ohm), strict=False):
        edges = edges or (count if volt > threshold_v else 0)
    return (store_f * ohm * log(volt / threshold_v) if edges else 0.0), edges


def pump_corners() -> list[tuple[float, int]]:
    """Return hold time and edges at all corners of the tolerances."""
    wide = (1 - CAPACITOR_SPREAD, 1 + CAPACITOR_SPREAD)
    return [
        hold_s(PUMP_SWING_V * supply, diode, PUMP_F * c1, STORE_F * c2, STORE_OHM * r, PUMP_THRESHOLD_V * t)
        for supply in (0.95, 1.05)
        for diode in (0.2, 0.4)
        for c1 in wide
        for c2 in wide
        for r in (0.99, 1.01)
        for t in (0.98, 1.02)
    ]


def latch_s(share: float) -> float:
    """How long a current without a gate lasts until the latch falls, by the trigger's threshold over its supply."""
    return -LATCH_OHM * LATCH_F * log(1.0 - share)


def high_voltage_enable(n: Needs) -> Circuit:
    """ALIVE to the enable of the high voltage."""
    del n
    middle, edges = hold_s(PUMP_SWING_V, PUMP_DIODE_V, PUMP_F, STORE_F, STORE_OHM, PUMP_THRESHOLD_V)
    corners = pump_corners()
    least, most = min(hold for hold, _ in corners), max(hold for hold, _ in corners)
    fewest, last = min(count for _, count in corners), max(count for _, count in corners)
    return Circuit(
        "pump",
        (
            (
                "driver",
                "one gate that takes 3.3 V at an input and swings 0 to 5 V (74HCT)",
            ),
            ("pump", f"{PUMP_F / NF:g} nF, two Schottky diodes (BAT54S class)"),
            ("store", f"{STORE_F / NF:g} nF (film or X7R, 10 %), {STORE_OHM / KOHM:g} kΩ in parallel"),
            ("threshold", f"comparator against a reference of {PUMP_THRESHOLD_V:g} V"),
            (
                "behind it",
                "AND with the e-stop's own contact (24 V loop, optocoupler) and the latch: remote enable of "
                "the supply, and enable of the gate driver",
            ),
            (
                "latch of a transistor that does not switch off",
                "comparator of the ignition high while GATE_SENSE is low, for about 1 ms by "
                f"{LATCH_OHM / KOHM:g} kΩ and {LATCH_F / NF:g} nF before a Schmitt trigger (74HCT14): clears a "
                "flip-flop (74HCT74), and the enable is gone until a button sets it again",
            ),
        ),
        (
            Check(
                "holds after the last rising edge",
                f"{1e3 * HOLD_S[0]:g} to {1e3 * HOLD_S[1]:g} ms [assumed]",
                f"{1e3 * middle:.1f} ms, worst case {1e3 * least:.1f} to {1e3 * most:.1f} ms",
                HOLD_S[0] < least and most < HOLD_S[1],
            ),
            Check(
                "rising edges until it enables: one is none",
                "> 1, at all corners",
                f"{edges}, worst case {fewest} to {last}",
                fewest > 1,
            ),
            Check(
                "current without a gate until the latch falls",
                "0.5 to 3 ms [assumed]",
                f"{1e3 * latch_s(SCHMITT_SHARES[1]):.1f} ms, worst case {1e3 * latch_s(SCHMITT_SHARES[0]):.1f} to "
                f"{1e3 * latch_s(SCHMITT_SHARES[2]):.1f} ms",
                latch_s(SCHMITT_SHARES[0]) > 0.5e-3 and latch_s(SCHMITT_SHARES[2]) < 3e-3,
            ),
        ),
    )
