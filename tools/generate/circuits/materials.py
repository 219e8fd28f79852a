"""The bill of materials: what each part of the reference circuits asks for, with the values that they have.

Every row names the parts of circuits that it is for; none is left out (tests/tools/test_build_the_machine.py).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from tools.generate.board_source import pins
from tools.generate.circuits import (
    actuator,
    break_chain,
    circuits,
    gap_current,
    gap_voltage,
    generator,
    outputs,
    references,
    touching,
)
from tools.generate.circuits.common import KOHM, UF, VDDA_V, Needs

if TYPE_CHECKING:
    from collections.abc import Iterable

    from tools.generate.circuits.common import Circuit

TITLES = {
    "outputs": "outputs",
    "divider": "gap divider",
    "current": "gap current",
    "references": "references",
    "chain": "break chain",
    "gate": "gate driver",
    "generator": "generator",
    "pump": "charge pump",
    "setpoints": "set points",
    "actuator": "actuator drive",
    "monitor": "actuator monitor",
    "displacement": "displacement",
    "contact": "contact circuit",
    "mode": "mode switch",
    "stages": "stages",
}
"""What the bill calls each circuit."""
NO_PART = ("outputs: none", "mode: settled, bounce included")
"""Rows of circuits that ask for nothing."""
_VALUE = re.compile(r"(?<!below )(?<!bears )(?<!at most )(?<![\d.])(\d[\d.]*) (MΩ|kΩ|Ω|pF|nF|µF)(?!\w)")
_SCALE = {"MΩ": 1e6, "kΩ": 1e3, "Ω": 1.0, "pF": 1e-12, "nF": 1e-9, "µF": 1e-6}


@dataclass(frozen=True, slots=True)
class Material:
    """A row of the bill; `places`: parts of circuits that it is for, as `circuit: part`."""

    part: str
    requirement: str
    places: tuple[str, ...] = ()

    @property
    def circuits(self) -> str:
        """The circuits that it is for."""
        return ", ".join(dict.fromkeys(TITLES[place.partition(": ")[0]] for place in self.places))


def rows_of(bill: Iterable[Material]) -> list[tuple[str, str, str]]:
    """Return the rows of the page."""
    return [(material.part, material.requirement, material.circuits) for material in bill]


def values(every: Iterable[Circuit], unit: str) -> list[tuple[str, list[str]]]:
    """Return each value of resistors (`Ω`) or capacitors (`F`) that the parts of circuits name, and in which."""
    found: dict[str, list[str]] = {}
    for circuit in every:
        for number, scale in _VALUE.findall(" ".join(" ".join(row) for row in circuit.parts)):
            if scale.endswith(unit):
                where = found.setdefault(f"{float(number):g} {scale}", [])
                if TITLES[circuit.name] not in where:
                    where.append(TITLES[circuit.name])
    return sorted(found.items(), key=lambda item: _size(item[0]))


def _size(value: str) -> float:
    number, unit = value.split()
    return float(number) * _SCALE[unit]


def _listed(every: Iterable[Circuit], unit: str) -> str:
    return "; ".join(f"{value} ({', '.join(where)})" for value, where in values(every, unit))


def materials(n: Needs) -> list[Material]:
    """Return parts and what is required of them."""
    rows = pins()
    down, up = (len(outputs.pulled(rows, way)) for way in ("down", "up"))
    open_v, full_v = n.limits["EDM_OPEN_V_MAX"], n.scale["EDM_OPEN_FULL_V"]
    estop, door = break_chain.contacts()
    coarse, fine = (ohm for ohm, _, _ in gap_current.SHUNTS.values())
    creepage = f"{generator.CREEPAGE_MM:g} mm of creepage"
    slow_s, fast_s = touching.SWITCHES[0][1], touching.SWITCHES[-1][1]
    loop = f"{break_chain.LOOP_OHM / KOHM:g} kΩ, {break_chain.LOOP_W:g} W"
    every = circuits(n)
    pulls = tuple(f"outputs: {part}" for part, _ in every[0].parts if part != "none")
    peaks = sorted({peak_a for _, peak_a in generator.SETTINGS})
    loads = ", ".join(
        f"{generator.load_ohm(n, peak_a):.0f} Ω ({peak_a:g} A, "
        f"{generator.MOST_DUTY * generator.load_ohm(n, peak_a) * peak_a**2:.1f} W)"
        for peak_a in peaks
    )
    return [
        Material("controller", "NUCLEO-F429ZI"),
        Material(
            "cell at VBAT, with holder",
            "3 V, lithium (CR2032 class). A NUCLEO as delivered has none: the latched fault and the count of boots "
            "are lost with the supply then",
        ),
        Material(
            "supply of 5 V",
            "0.5 A at least, 5 %, isolated from mains (reinforced), for board, converter and 5 V logic",
            ("actuator: supply of both",),
        ),
        Material("analogue supplies", "±5 V, 3.3 V; 12 to 15 V for the actuator's buffer; linear"),
        Material(
            "supply of −0.23 V",
            "charge pump without noise (LM7705 class), with the capacitors of its data sheet",
            ("divider: buffer", "current: amplifier", "monitor: behind it"),
        ),
        Material("USB isolator", "full speed, 12 Mb/s"),
        Material(
            "pull resistors of the outputs",
            f"{down} + {2 * up} of {outputs.PULL_OHM / KOHM:g} kΩ, {100 * outputs.PULL_SPREAD:g} %",
            (*pulls, "gate: pull-down", "actuator: converter", "setpoints: outputs"),
        ),
        Material(
            "resistors",
            "0.1 % at dividers and amplifiers, 1 % elsewhere, 0.1 W unless a circuit says more: "
            + _listed(every, "Ω"),
        ),
        Material(
            "capacitors",
            "C0G below 10 nF, film or X7R of 10 % above, and 100 nF at each supply pin: "
            + _listed(every, "F"),
        ),
        Material(
            "resistors of dividers",
            f"{2 * gap_voltage.TOPS} of {gap_voltage.TOP_OHM / KOHM:g} kΩ for 200 V each, 2 more for "
            "the monitor's offset; 0.1 %",
            (
                "divider: top leg",
                "divider: bottom leg",
                "divider: at the tap",
                "monitor: from the actuator's plug",
                "monitor: from 3.3 V (the converter's own)",
                "monitor: to ground",
            ),
        ),
        Material(
            "clamps",
            "two silicon diodes of low leakage (BAV199 class), one each for gap voltage, gap current, monitor and "
            "displacement, two for the contact circuit",
            (
                "divider: clamp",
                "monitor: behind it",
                "displacement: conditioning",
                "contact: source",
                "contact: comparator",
            ),
        ),
        Material(
            "buffers of step and direction, gates and latch of the enable",
            "74HCT, 5 V: 04 or 14, 08, 11, 74, 86; a reset button; RS-422 drivers for differential drives",
            (
                "stages: outputs",
                "pump: driver",
                "gate: enable",
                "pump: behind it",
                "pump: latch of a transistor that does not switch off",
            ),
        ),
        Material(
            "pump",
            "two Schottky diodes (BAT54S class), capacitors of 10 %",
            ("pump: pump", "pump: store"),
        ),
        Material(
            "actuator",
            "amplified piezo, about 445 µm at 150 V (APA400M class), −20 to 150 V",
            ("actuator: at the actuator",),
        ),
        Material(
            "resistor across the actuator",
            f"{actuator.PIEZO_BLEEDER_OHM / KOHM:g} kΩ, 0.5 W, 250 V, on the actuator's side of the plug",
            ("actuator: at the actuator",),
        ),
        Material(
            "amplifier of the actuator",
            "0 to 10 V or 0 to 7.5 V in, 0 to 150 V out, limited, 20 mA, stable with 8 µF, own isolated supply",
            ("actuator: amplifier",),
        ),
        Material("displacement sensor", "0.5 mm, 1 kHz, 0.15 µm rms", ("displacement: sensor",)),
        Material(
            "converter",
            "16 bits by SPI, 0 at power-on (AD5541A class)",
            ("actuator: converter",),
        ),
        Material("reference of the converter", "4.096 V, 0.05 %, 5 ppm/K", ("actuator: reference",)),
        Material(
            "reference of the comparators",
            f"{references.REFERENCE_V:g} V, {100 * references.SPREAD:g} % (REF3025 class)",
            (
                "references: reference",
                "references: over-current",
                "references: ignition",
                "references: contact",
                "pump: threshold",
            ),
        ),
        Material(
            "fast operational amplifiers",
            "50 MHz, rail to rail, 0.25 mV (OPA365 class)",
            (
                "divider: buffer",
                "divider: to the pin",
                "current: amplifier",
                "current: corner of the converter's path",
            ),
        ),
        Material(
            "slow, exact operational amplifiers",
            "offset below 0.25 mV, for the rail that they work at",
            (
                "actuator: buffer",
                "monitor: behind it",
                "displacement: conditioning",
                "references: over-current",
                "setpoints: outputs",
            ),
        ),
        Material(
            "isolation amplifiers of the set points",
            "0 to 3.3 V, 0.5 %, isolation by the supply's own; where the supply's ground is not the star point",
            ("setpoints: outputs",),
        ),
        Material(
            "fast comparators",
            "push-pull, 50 ns, 5 mV (TLV3501 class)",
            ("current: ignition comparator", "current: over-current comparator"),
        ),
        Material(
            "slow comparators",
            "push-pull, 5 mV; 3.3 V for the contact, 5 V for the pump",
            ("contact: comparator", "pump: threshold"),
        ),
        Material(
            "monoflop and AND of the blanking",
            f"{1e6 * gap_current.BLANK_S:g} µs by its R and C (74LVC1G123 class), gate of 3.3 V (74LVC1G08 class)",
            ("current: ignition comparator",),
        ),
        Material(
            "gate driver",
            f"isolated, 1 A, 100 V/ns, {creepage}, under-voltage lock-out below 10 V, with isolated converter "
            "5 V to 12 V",
            ("gate: driver", "gate: its supply"),
        ),
        Material(
            "digital isolators",
            f"25 Mb/s, 3 channels for the converter; 1 for GATE_SENSE with {creepage}, and its 5 V (78L05 class)",
            ("actuator: converter", "gate: GATE_SENSE"),
        ),
        Material(
            "transistor",
            f"{generator.FET_V:g} V, {1e9 * generator.GATE_CHARGE_C:g} nC, bears a short at {full_v:g} V for "
            f"{1e6 * generator.SHORT_S:g} µs, on a heat sink",
            ("gate: transistor",),
        ),
        Material("diode at its source", "600 V, 3 A, 35 ns (ES3J class)", ("gate: transistor",)),
        Material(
            "high-voltage supply",
            f"0 to {open_v:g} V, isolated from mains (reinforced), programmable, current limit "
            f"{generator.SUPPLY_A:g} A or more, cannot give more than {full_v:g} V, remote enable, good signal",
            ("generator: supply",),
        ),
        Material(
            "reservoir, bleeder",
            f"{generator.RESERVOIR_F / UF:g} µF film, {1.5 * open_v:g} V; {generator.BLEEDER_OHM / KOHM:g} kΩ, 5 W",
            ("generator: reservoir", "generator: bleeder"),
        ),
        Material(
            "series resistors",
            "non-inductive, power by the table, on a heat sink",
            ("generator: series resistors",),
        ),
        Material("shunt", f"{1e3 * coarse:g} mΩ or {fine:g} Ω, 1 %, four terminals", ("current: shunt",)),
        Material(
            "mode switch",
            f"changeover, 600 V across open contacts, makes at {open_v:g} V of direct current; settled within "
            f"{1e3 * slow_s:g} ms for {touching.LEAST_HZ / 1e3:g} kHz (relay with a force-guided second contact), "
            f"within {1e3 * fast_s:g} ms for {1e6 / n.limits['EDM_PERIOD_NS_MIN']:g} kHz (semiconductors)",
            ("mode: switch", "mode: guard"),
        ),
        Material(
            "drive and guard of the mode switch",
            "2 MOSFETs (BSS138 class), diode at the coil (1N4148), diode BAT54, XOR (74HCT86), Schmitt trigger "
            "(74HCT14)",
            ("mode: drive", "mode: guard"),
        ),
        Material(
            "series resistor of the contact circuit",
            f"{touching.CONTACT_SERIES_OHM / KOHM:g} kΩ, 5 W, {1.5 * open_v:g} V",
            ("contact: source",),
        ),
        Material(
            "e-stop", f"{estop} contacts of forced opening, latching", ("chain: contacts", "pump: behind it")
        ),
        Material("door switch", f"{door} contacts of forced opening", ("chain: contacts",)),
        Material(
            "loops of 24 V",
            f"{len(break_chain.LOOPS)} optocouplers, each with {loop}: {', '.join(break_chain.LOOPS)}; behind "
            "each but the first 10 kΩ and 100 nF",
            ("chain: contacts", "chain: to the node", "pump: behind it"),
        ),
        Material(
            "break chain",
            f"MOSFET (BSS138 class), {break_chain.FILTER_OHM / KOHM:g} kΩ, {break_chain.FILTER_F * 1e9:g} nF C0G",
            ("chain: node", "chain: filter", "current: over-current comparator"),
        ),
        Material(
            "contactor with start button, fuse, residual-current device, 24 V supply",
            "by the rules of the country; safety extra-low voltage",
        ),
        Material(
            "stages",
            "step and direction, 0.1 µm and 0.001 degrees a step, enable, limit switches that open",
            ("stages: drives",),
        ),
        Material(
            "dielectric",
            "EDM oil with a flash point above 100 °C; pump, filter, float switch, flow and temperature sensors with "
            "100 kΩ and 1 MΩ at their inputs",
        ),
        Material("enclosure", "metal, earthed, with door, suction, drip tray, extinguisher beside it"),
        Material(
            "instruments",
            "multimeter (CAT III, 600 V), insulation tester of 500 V, oscilloscope with a 100:1 probe for 1 kV and "
            "a differential probe for 1 kV",
        ),
        Material(
            "sources for the work",
            "laboratory supply of 3 to 30 V, limited to 0.5 A; function generator with two channels of 0 to "
            f"{VDDA_V:g} V; two potentiometers of 10 kΩ; 9 V block and a battery of 3 to 6 V",
        ),
        Material(
            "loads for the work",
            "1 kΩ, 5 W, on insulated leads, to short the reservoir; 1 kΩ, 10 W, non-inductive, for step 9; for step "
            f"12 {loads}, non-inductive, on a heat sink",
        ),
    ]
