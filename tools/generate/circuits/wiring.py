"""Which part of a reference circuit goes from where to where: netlists in words.

Nodes are nets of the board, supplies (3.3 V, 5 V, 12 V), GND (the star point) and names of the circuit's own.
Resistors carry their ohms, so that the tests solve the circuits and hold them against the checks.
"""

from __future__ import annotations

from dataclasses import dataclass

from tools.generate.circuits import actuator, break_chain, charge_pump, gap_voltage, references, touching
from tools.generate.circuits.common import KOHM, NF, PF, UF


@dataclass(frozen=True, slots=True)
class Wired:
    """A part and its nodes, in words; `ends` and `ohm` of a resistor, for the tests."""

    part: str
    nodes: str
    ends: tuple[str, str] = ("", "")
    ohm: float = 0.0


def _r(name: str, ohm: float, a: str, b: str, note: str = "") -> Wired:
    value = f"{ohm / KOHM:g} kΩ" if ohm >= KOHM else f"{ohm:g} Ω"
    return Wired(f"{name}, {note or value}", f"{a} – {b}", (a, b), ohm)


def _c(name: str, farad: float, a: str, b: str = "GND") -> Wired:
    size, unit = next(
        (size, unit) for size, unit in ((UF, "µF"), (NF, "nF"), (PF, "pF")) if farad >= 0.999 * size
    )
    return Wired(f"{name}, {farad / size:g} {unit}", f"{a} – {b}")


def _clamp(name: str, node: str) -> Wired:
    return Wired(f"{name}, BAV199", f"anode GND, middle {node}, cathode 3.3 V")


def wirings() -> dict[str, tuple[Wired, ...]]:
    """Return the netlist of each circuit that has one."""
    gap, mon, con = gap_voltage, actuator.MONITOR_OHM, touching.CONTACT_DIVIDER_OHM
    return {
        "divider": (
            _r(
                "R1",
                gap.TOPS * gap.TOP_OHM,
                "GAP+",
                "TAP",
                f"{gap.TOPS} × {gap.TOP_OHM / KOHM:g} kΩ in series",
            ),
            _r("R2", gap.BOTTOM_OHM, "TAP", "GND"),
            _c("C1", 33 * PF, "TAP"),
            _clamp("D1", "TAP"),
            Wired("U1, buffer", "+ TAP; − and output BUF; supplies 3.3 V and −0.23 V"),
            _r("R3", 100.0, "BUF", "GAP_VOLTAGE"),
            _c("C2", 1 * NF, "GAP_VOLTAGE"),
        ),
        "chain": (
            Wired(
                f"e-stop, door, R1 {break_chain.LOOP_OHM / KOHM:g} kΩ, {break_chain.LOOP_W:g} W, LED of U1",
                "in series: 24 V – e-stop – door – R1 – LED – minus of the 24 V",
            ),
            Wired("U1, optocoupler", "collector 3.3 V, emitter LOOP"),
            _r("R2", break_chain.CHAIN_OHM, "LOOP", "NODE"),
            _r("R3", break_chain.CHAIN_PULL_OHM, "NODE", "GND"),
            Wired("U2, over-current comparator", "+ the gap current's amplifier, − 3.025 V; output OVER"),
            _r("R4", break_chain.GATE_OHM, "OVER", "G"),
            Wired("Q1, BSS138", "gate G, drain NODE, source GND"),
            _r("R5", break_chain.FILTER_OHM, "NODE", "BREAK_CHAIN"),
            _c("C1", break_chain.FILTER_F, "BREAK_CHAIN"),
        ),
        "gate": (
            Wired("R1, 10 kΩ", "GATE – GND"),
            Wired("U1, 74HCT AND, 5 V", "inputs GATE and ENABLE (charge pump); output DRIVE"),
            Wired(
                "U2, driver",
                "input DRIVE; supply on the board's side 5 V and GND; other side 12 V and SOURCE; output OUT",
            ),
            Wired("isolated converter", "in 5 V and GND; out plus 12 V, minus SOURCE"),
            Wired("R2, 4.7 Ω", "OUT – gate of Q1"),
            Wired("R3, 10 kΩ", "gate of Q1 – SOURCE"),
            Wired("Q1, transistor", "drain RESERVOIR+, source SOURCE"),
            Wired("D1, ES3J", "anode GND, cathode SOURCE"),
            Wired("series resistors", "SOURCE – GENERATOR, a contact of the mode switch"),
            _r("R4", 1.5 * KOHM, "OUT", "SENSE"),
            _r("R5", 1 * KOHM, "SENSE", "SOURCE"),
            Wired(
                "U3, isolator",
                "input SENSE, that side from 12 V by a regulator to 5 V over SOURCE; output GATE_SENSE, 3.3 V",
            ),
        ),
        "pump": (
            Wired("U1, 74HCT gate, 5 V", "input ALIVE, output DRIVE"),
            _c("C1", charge_pump.PUMP_F, "DRIVE", "MIDDLE"),
            Wired("D1, BAT54S", "anode GND, middle MIDDLE, cathode STORE"),
            _c("C2", charge_pump.STORE_F, "STORE"),
            _r("R1", charge_pump.STORE_OHM, "STORE", "GND"),
            Wired("U2, comparator, 5 V", "+ STORE, − 2.5 V; output RUNS"),
            Wired(
                "U3, optocoupler of the enable's loop",
                "collector 5 V, emitter RELEASED; 10 kΩ and 100 nF from there to GND",
            ),
            Wired("U4a, b, 74HCT14, one behind the other", "RELEASED to RELEASED2"),
            Wired("U4c, 74HCT14", "GATE_SENSE to CLOSED"),
            Wired("U5, 74HCT AND", "inputs IGNITION and CLOSED; output STUCK"),
            _r("R2", charge_pump.LATCH_OHM, "STUCK", "LATE"),
            _c("C3", charge_pump.LATCH_F, "LATE"),
            Wired("U4d, 74HCT14", "LATE to CLEAR (low clears)"),
            Wired("R3, 10 kΩ; C4, 100 nF; reset button", "5 V – BUTTON; BUTTON – GND; BUTTON – GND"),
            Wired("U4e, 74HCT14", "BUTTON to CLOCK (rises when it is pressed)"),
            Wired("U6, 74HCT74", "D 5 V, preset 5 V, clock CLOCK, clear CLEAR; Q is WELL"),
            Wired(
                "U7, 74HCT11",
                "inputs RUNS, RELEASED2, WELL; output ENABLE: the supply's remote enable and the gate driver",
            ),
        ),
        "monitor": (
            _r("R1", mon[0], "PLUG+", "SUM", "3 × 330 kΩ in series"),
            _r("R2", mon[1], "3.3 V", "SUM", "2 × 330 kΩ in series"),
            _r("R3", mon[2], "SUM", "GND", "20 kΩ and 200 Ω in series"),
            _c("C1", actuator.MONITOR_F, "SUM"),
            _clamp("D1", "SUM"),
            Wired("U1, buffer", "+ SUM; − and output BUF; supplies 3.3 V and −0.23 V"),
            _r("R4", 100.0, "BUF", "MONITOR"),
            _c("C2", 1 * NF, "MONITOR"),
        ),
        "contact": (
            _r("R1", con[0], "3.3 V", "SOURCE"),
            _r("R2", con[1], "SOURCE", "GND"),
            _clamp("D1", "SOURCE"),
            _r(
                "R3",
                touching.CONTACT_SERIES_OHM,
                "SOURCE",
                "TOUCH",
                f"{touching.CONTACT_SERIES_OHM / KOHM:g} kΩ, 5 W",
            ),
            Wired("TOUCH", "the mode switch's contact at rest, see there; nothing else"),
            _r("R4", touching.INPUT_OHM, "TOUCH", "IN", f"{touching.INPUT_OHM / KOHM:g} kΩ, 2 W, 350 V"),
            _c("C1", 1 * NF, "IN"),
            _clamp("D2", "IN"),
            _r("R5", references.FROM_REFERENCE_OHM, "2.5 V", "LEVEL"),
            _r("R6", references.CONTACT_OHM, "LEVEL", "GND"),
            Wired("U1, comparator, 3.3 V", "− IN, + LEVEL; output CONTACT"),
            _r("R7", references.HYSTERESIS_OHM, "CONTACT", "LEVEL"),
        ),
        "mode": (
            Wired(
                "K1, changeover",
                "common GAP+; working contact GENERATOR (series resistors); contact at rest TOUCH",
            ),
            Wired("R1, 10 kΩ", "MODE – GND"),
            Wired("Q1, BSS138", "gate MODE, source GND, drain the coil's minus"),
            Wired("coil of K1; D1, 1N4148", "5 V – drain of Q1; anode at the drain, cathode 5 V"),
            Wired("K1, guided contact, closed at rest", "5 V – REST"),
            Wired("R2, 10 kΩ", "REST – GND"),
            Wired(
                "U1, 74HCT86 (XOR), 5 V",
                "inputs MODE and REST; output RIGHT: high while they differ, as they should",
            ),
            Wired("D2, BAT54; R3, 1 kΩ", "anode RIGHT, R3 behind its cathode to WAIT"),
            _r("R4", touching.GUARD_OHM, "WAIT", "GND"),
            _c("C1", touching.GUARD_F, "WAIT"),
            Wired("U2, 74HCT14, 5 V", "WAIT to WRONG"),
            Wired("Q2, BSS138", "gate WRONG, source GND, drain HV_SUPPLY"),
        ),
    }
