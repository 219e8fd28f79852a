"""The generator: gate driver, reservoir, series resistors, set points."""

from __future__ import annotations

from math import log

from tools.generate.board_source import numbers
from tools.generate.circuits.common import (
    KOHM,
    LEAKAGE_A,
    LOW_V,
    SAFE_S,
    SAFE_V,
    UF,
    VDDA_V,
    Check,
    Circuit,
    Needs,
)

GATE_PULL_OHM, FET_V, GATE_CHARGE_C, DRIVER_A = 10 * KOHM, 650.0, 40e-9, 1.0
SHORT_S = 5e-6
"""What the transistor has to bear of a short behind it, at the full voltage."""
CREEPAGE_MM = 6.5
"""Between 300 V and the controller's side; 6.3 mm for 400 V, pollution degree 3 (IEC 60664-1) [assumed]."""


def gate_driver(n: Needs) -> Circuit:
    """Gate signal to a switch on the high side."""
    open_v = n.limits["EDM_OPEN_V_MAX"]
    float_v = LEAKAGE_A * GATE_PULL_OHM
    swing_ns = 1e9 * GATE_CHARGE_C / DRIVER_A
    return Circuit(
        "gate",
        (
            (
                "pull-down",
                f"{GATE_PULL_OHM / KOHM:g} kΩ at GATE, {GATE_PULL_OHM / KOHM:g} kΩ between gate and "
                "source of the transistor; 4.7 Ω before the gate",
            ),
            ("enable", "74HCT AND of GATE and the high-voltage enable, 5 V, before the driver"),
            (
                "driver",
                "isolated, output low without supply on either side, 1 A at least, 100 V/ns, in a wide package "
                f"of {CREEPAGE_MM:g} mm creepage or more (UCC5350 class)",
            ),
            (
                "its supply",
                "isolated converter 5 V to 12 V, below 10 pF across; a driver whose under-voltage lock-out is "
                "below 10 V",
            ),
            (
                "transistor",
                f"{FET_V:g} V, bears a short at {n.scale['EDM_OPEN_FULL_V']:g} V for {1e6 * SHORT_S:g} µs; on the "
                "high side between reservoir and series resistor; a diode from ground to its source, 600 V, 3 A, "
                "35 ns (ES3J class)",
            ),
            (
                "GATE_SENSE",
                "output of the driver, by 1.5 kΩ and 1 kΩ from 12 to 4.8 V, back by a second isolator channel whose "
                "output is low without supply; 5 V for that side by a small regulator (78L05 class)",
            ),
        ),
        (
            Check(
                "gate while the chip is in reset or not there",
                f"< {LOW_V} V",
                f"{1e3 * float_v:.0f} mV",
                float_v < LOW_V,
            ),
            Check(
                "voltage of the transistor over the greatest open voltage",
                "> 2",
                f"{FET_V / open_v:.2f}",
                FET_V / open_v > 2,
            ),
            Check("charge of the gate, at 1 A", "< 100 ns", f"{swing_ns:.0f} ns", swing_ns < 100),
        ),
    )


SETTINGS = ((40.0, 0.12), (60.0, 0.2), (80.0, 0.5), (100.0, 1.0), (100.0, 0.1))
MOST_DUTY = 0.5
RESERVOIR_F, BLEEDER_OHM, CAPACITOR_SPREAD = 22 * UF, 47 * KOHM, 0.1
LONGEST_US = 130.0
SUPPLY_A = 0.1


def series_ohm(n: Needs, open_v: float, peak_a: float) -> float:
    """Resistance, all in a row, by which a normal discharge has the peak current that is set."""
    return (open_v - n.scale["EDM_NORMAL_PLATEAU_V"]) / peak_a


def load_ohm(n: Needs, peak_a: float) -> float:
    """Resistor that takes a peak current at the plateau of a normal discharge."""
    return n.scale["EDM_NORMAL_PLATEAU_V"] / peak_a


def settings(n: Needs) -> list[tuple[str, ...]]:
    """Open voltage, peak current, resistance in a row, a lasting short, and a load like a discharge."""
    found: list[tuple[str, ...]] = []
    for open_v, peak_a in SETTINGS:
        ohm = series_ohm(n, open_v, peak_a)
        short_a = open_v / ohm
        found.append(
            (
                f"{open_v:g}",
                f"{peak_a:g}",
                f"{ohm:.0f}",
                f"{short_a:.2f}",
                f"{MOST_DUTY * open_v * short_a:.1f}",
                f"{load_ohm(n, peak_a):.0f}",
                f"{MOST_DUTY * load_ohm(n, peak_a) * peak_a**2:.1f}",
            )
        )
    return found


def plateau_limit_v(n: Needs, open_v: float) -> float:
    """Plateau above which a constant current would look like over-current (fault 3004)."""
    return open_v - (open_v - n.scale["EDM_NORMAL_PLATEAU_V"]) / n.params["over_current"]


def discharge_s(volt: float, farad: float, ohm: float, down_to_v: float = SAFE_V) -> float:
    """Time down to a voltage, that which may be touched unless another one is asked for."""
    return farad * ohm * log(volt / down_to_v)


def pulse_generator(n: Needs) -> Circuit:
    """Supply, reservoir, series resistor."""
    open_v, full_v = n.limits["EDM_OPEN_V_MAX"], n.scale["EDM_OPEN_FULL_V"]
    droop = 0.12 * LONGEST_US * 1e-6 / (RESERVOIR_F * (1 - CAPACITOR_SPREAD)) / 40.0
    safe_s = discharge_s(full_v, RESERVOIR_F * (1 + CAPACITOR_SPREAD), BLEEDER_OHM * 1.05)
    settle_s = 1e-3 * numbers("core", "motion.c")["SETTLE_TICKS"]
    charging_a = RESERVOIR_F * (1 + CAPACITOR_SPREAD) * open_v / settle_s + open_v / BLEEDER_OHM
    energy_j = 0.5 * RESERVOIR_F * full_v**2
    bleeder_w = full_v**2 / BLEEDER_OHM
    return Circuit(
        "generator",
        (
            (
                "supply",
                f"0 to {open_v:g} V, isolated, set by 0 to 3.3 V for 0 to {full_v:g} V; current limit "
                f"{SUPPLY_A:g} A or more, above the mean current of the profile; remote enable, good signal",
            ),
            ("reservoir", f"{RESERVOIR_F / UF:g} µF, film, {1.5 * open_v:g} V"),
            (
                "bleeder",
                f"{BLEEDER_OHM / KOHM:g} kΩ, 5 W, screwed to the reservoir, without a switch or fuse between",
            ),
            (
                "series resistors",
                "by the table below, less shunt and transistor; non-inductive, on a heat sink, chosen by "
                "hand with the high voltage off",
            ),
        ),
        (
            Check(
                f"droop in a pulse of {LONGEST_US:g} µs and 0.12 A at 40 V, without the supply",
                "< 2 %",
                f"{100 * droop:.2f} %",
                droop < n.measure["SAME_OPEN"],
            ),
            Check(
                f"from {full_v:g} V to {SAFE_V:g} V", f"< {SAFE_S:g} s", f"{safe_s:.2f} s", safe_s < SAFE_S
            ),
            Check(
                f"charging to {open_v:g} V while the tool waits at the begin of an approach, {1e3 * settle_s:g} ms",
                f"< {SUPPLY_A:g} A",
                f"{charging_a:.3f} A",
                charging_a < SUPPLY_A,
            ),
            Check(
                f"power of the bleeder at {full_v:g} V",
                "< half of 5 W",
                f"{bleeder_w:.2f} W",
                bleeder_w < 2.5,
            ),
            Check(f"energy in the reservoir at {full_v:g} V", "–", f"{energy_j:.2f} J", True),
        ),
    )


BUFFERED_DAC_V = 0.2
DAC_OFFSET_V, DAC_GAIN = 10e-3, 0.005
"""Errors of the chip's DAC (data sheet of the STM32F427/429, DAC characteristics)."""


def dac_error_v(n: Needs, open_v: float) -> float:
    """Error of an open voltage that is set, by the DAC alone, before trimming."""
    return DAC_OFFSET_V / VDDA_V * n.scale["EDM_OPEN_FULL_V"] + DAC_GAIN * open_v


def set_points(n: Needs) -> Circuit:
    """OPEN_VOLTAGE and PEAK_CURRENT: the buffer in the chip cannot go near the rails."""
    full_v, full_a = n.scale["EDM_OPEN_FULL_V"], n.scale["EDM_PEAK_FULL_A"]
    least_v, most_v = BUFFERED_DAC_V / VDDA_V * full_v, (1 - BUFFERED_DAC_V / VDDA_V) * full_v
    least_a = BUFFERED_DAC_V / VDDA_V * full_a
    return Circuit(
        "setpoints",
        (
            (
                "outputs",
                "not inverting scaling amplifier to the supply's own input range, 1 MΩ, with the pull-down at its "
                "input, less than 20 cm from the pin (the DAC's buffer bears 50 pF); an isolation amplifier where "
                "the supply's ground is not the star point; offset and gain trimmed",
            ),
        ),
        (
            Check(
                "open voltage that can be set",
                f"{n.limits['EDM_OPEN_V_MAX']:g} V; 40 V of the first start",
                f"{least_v:.0f} to {most_v:.0f} V",
                least_v < 40.0 and most_v > n.limits["EDM_OPEN_V_MAX"],
            ),
            Check(
                "error of the DAC at 40 V: 10 mV and 0.5 %",
                f"trimmed to < {100 * n.measure['SAME_OPEN']:g} %",
                f"{dac_error_v(n, 40.0):.1f} V, {100 * dac_error_v(n, 40.0) / 40.0:.0f} %, before trimming",
                True,
            ),
            Check(
                f"peak current that can be set at {full_a:g} A full scale",
                "no use below it",
                f"{least_a:.2f} A and more",
                True,
            ),
            Check(
                "the same at 1.2 A full scale",
                "< 0.12 A",
                f"{least_a * 1.2 / full_a:.3f} A and more",
                least_a * 1.2 / full_a < 0.12,
            ),
        ),
    )
