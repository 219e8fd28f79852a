"""The bill of materials, with the values that the reference circuits have."""

from __future__ import annotations

from tools.generate.board_source import pins
from tools.generate.circuits import actuator, break_chain, gap_current, generator, outputs, touching
from tools.generate.circuits.common import KOHM, UF, VDDA_V, Needs


def materials(n: Needs) -> list[tuple[str, str]]:
    """Return parts and what is required of them."""
    rows = pins()
    down, up = (len(outputs.pulled(rows, way)) for way in ("down", "up"))
    open_v, full_v = n.limits["EDM_OPEN_V_MAX"], n.scale["EDM_OPEN_FULL_V"]
    estop, door = break_chain.contacts()
    coarse, fine = (ohm for ohm, _, _ in gap_current.SHUNTS.values())
    creepage = f"{generator.CREEPAGE_MM:g} mm of creepage"
    slow_s, fast_s = touching.SWITCHES[0][1], touching.SWITCHES[-1][1]
    return [
        ("controller", "NUCLEO-F429ZI"),
        (
            "supply of 5 V",
            "0.5 A at least, 5 %, isolated from mains (reinforced), for board, converter and 5 V logic",
        ),
        ("analogue supplies", "±5 V, 3.3 V; 12 to 15 V for the actuator's buffer; linear"),
        ("USB isolator", "full speed, 12 Mb/s"),
        (
            "pull resistors of the outputs",
            f"{down} + {2 * up} of {outputs.PULL_OHM / KOHM:g} kΩ, {100 * outputs.PULL_SPREAD:g} %",
        ),
        (
            "buffers of step and direction, gates and latch of the enable",
            "74HCT, 5 V; RS-422 drivers for differential drives",
        ),
        ("actuator", "amplified piezo, about 445 µm at 150 V (APA400M class), −20 to 150 V"),
        (
            "resistor across the actuator",
            f"{actuator.PIEZO_BLEEDER_OHM / KOHM:g} kΩ, 0.5 W, 250 V, on the actuator's side of the plug",
        ),
        (
            "amplifier of the actuator",
            "0 to 10 V or 0 to 7.5 V in, 0 to 150 V out, limited, 20 mA, stable with 8 µF, own isolated supply",
        ),
        ("displacement sensor", "0.5 mm, 1 kHz, 0.15 µm rms"),
        ("converter, reference", "16 bits by SPI, 0 at power-on (AD5541A class); 4.096 V, 0.05 %, 5 ppm/K"),
        (
            "operational amplifiers",
            "50 MHz, rail to rail, 0.25 mV (OPA365 class) for gap voltage and current; slow and exact ones "
            "elsewhere",
        ),
        (
            "comparators",
            "push-pull, 50 ns, 5 mV (TLV3501 class) for ignition and over-current; a slow one for contact and "
            "charge pump",
        ),
        (
            "gate driver",
            f"isolated, 1 A, 100 V/ns, {creepage}, under-voltage lock-out below 10 V, with isolated converter "
            "5 V to 12 V",
        ),
        (
            "digital isolators",
            f"25 Mb/s, 3 channels for the converter; 1 for GATE_SENSE with {creepage}",
        ),
        (
            "transistor",
            f"{generator.FET_V:g} V, {1e9 * generator.GATE_CHARGE_C:g} nC, bears a short at {full_v:g} V for "
            f"{1e6 * generator.SHORT_S:g} µs, on a heat sink",
        ),
        (
            "high-voltage supply",
            f"0 to {open_v:g} V, isolated from mains (reinforced), programmable, current limit "
            f"{generator.SUPPLY_A:g} A or more, cannot give more than {full_v:g} V, remote enable, good signal",
        ),
        (
            "reservoir, bleeder",
            f"{generator.RESERVOIR_F / UF:g} µF film, {1.5 * open_v:g} V; {generator.BLEEDER_OHM / KOHM:g} kΩ, 5 W",
        ),
        ("series resistors", "non-inductive, power by the table, on a heat sink"),
        ("shunt", f"{1e3 * coarse:g} mΩ or {fine:g} Ω, 1 %, four terminals"),
        ("resistors of dividers", "0.1 %, 200 V each"),
        ("clamps", "low leakage (BAV199 class)"),
        (
            "mode switch",
            f"changeover, 600 V across open contacts, makes at {open_v:g} V of direct current; settled within "
            f"{1e3 * slow_s:g} ms for {touching.LEAST_HZ / 1e3:g} kHz (relay with a force-guided second contact), "
            f"within {1e3 * fast_s:g} ms for {1e6 / n.limits['EDM_PERIOD_NS_MIN']:g} kHz (semiconductors)",
        ),
        ("e-stop", f"{estop} contacts of forced opening, latching"),
        ("door switch", f"{door} contacts of forced opening"),
        (
            "loops of 24 V",
            f"{len(break_chain.LOOPS)} optocouplers with 4.7 kΩ: {', '.join(break_chain.LOOPS)}",
        ),
        (
            "break chain",
            f"MOSFET (BSS138 class), {break_chain.FILTER_OHM / KOHM:g} kΩ, {break_chain.FILTER_F * 1e9:g} nF C0G",
        ),
        (
            "contactor with start button, fuse, residual-current device, 24 V supply",
            "by the rules of the country; safety extra-low voltage",
        ),
        ("stages", "step and direction, 0.1 µm and 0.001 degrees a step, enable, limit switches that open"),
        (
            "dielectric",
            "EDM oil with a flash point above 100 °C; pump, filter, float switch, flow and temperature sensors",
        ),
        ("enclosure", "metal, earthed, with door, suction, drip tray, extinguisher beside it"),
        (
            "for the work",
            "multimeter (CAT III, 600 V), insulation tester of 500 V, oscilloscope with a 100:1 probe for 1 kV and "
            "a differential probe for 1 kV, 9 V block and a battery of 3 to 6 V, 1 kΩ (5 W), function generator of "
            f"{VDDA_V:g} V",
        ),
    ]
