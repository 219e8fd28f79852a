"""Gap voltage: divider, corner, clamp, buffer."""

from __future__ import annotations

from math import exp

from tools.generate.circuits.common import (
    KOHM,
    PF,
    STRAY_F,
    VDDA_SPREAD,
    VDDA_V,
    Check,
    Circuit,
    Needs,
    corner_hz,
    parallel,
    within,
)
from tools.generate.circuits.generator import series_ohm

TOP_OHM, TOPS, BOTTOM_OHM, TAP_F = 330 * KOHM, 3, 10 * KOHM, 39 * PF
RESISTOR_SPREAD = 0.001
CLAMP_LEAK_A, SCHOTTKY_LEAK_A = 5e-9, 2e-6
BUFFER_V = 1e-3
PULSES_SPIKE_V = 1000.0
SUPPLY_SPREAD = 0.005
"""Of the open voltage about what is set, by the supply and its scaling amplifier, after trimming."""


def gap_divider(n: Needs) -> Circuit:
    """Gap voltage to 0 to 3.3 V, at 1 MS/s."""
    full_v, open_v = n.scale["EDM_GAP_FULL_V"], n.limits["EDM_OPEN_V_MAX"]
    top, source = TOPS * TOP_OHM, parallel(TOPS * TOP_OHM, BOTTOM_OHM)
    ratio = (top + BOTTOM_OHM) / BOTTOM_OHM
    spread = 2.0 * RESISTOR_SPREAD * top / (top + BOTTOM_OHM)
    corner, tau_us = corner_hz(source, TAP_F), 1e6 * source * TAP_F
    settled = exp(-n.settle_us / tau_us)
    series = series_ohm(n, open_v, 0.1)
    loaded = series / (series + top + BOTTOM_OHM)
    apart = spread + loaded + SUPPLY_SPREAD
    offset_v = ratio * (BUFFER_V + CLAMP_LEAK_A * source)
    schottky_v = ratio * SCHOTTKY_LEAK_A * source
    test_v = n.params["test_error"] * 0.3 * 40.0
    stray_s = STRAY_F * (top + BOTTOM_OHM)
    stray_a = STRAY_F * open_v / (n.measure["SAMPLES_MOST"] * 1e-6)
    clamp_ma = 1e3 * PULSES_SPIKE_V / top
    return Circuit(
        "divider",
        (
            ("top leg", f"{TOPS} × {TOP_OHM / KOHM:g} kΩ in series, 0.1 %, 1206, rated 200 V each"),
            ("bottom leg", f"{BOTTOM_OHM / KOHM:g} kΩ, 0.1 %"),
            ("at the tap", f"{TAP_F / PF:g} pF in all, C0G: 33 pF and what the amplifier's input has"),
            (
                "clamp",
                "two silicon diodes of low leakage to 3.3 V and ground (BAV199 class); no Schottky diodes",
            ),
            ("buffer", "50 MHz, 25 V/µs, rail to rail (OPA365 class), from 3.3 V and −0.23 V (LM7705 class)"),
            ("to the pin", "100 Ω, 1 nF at the pin"),
        ),
        (
            Check(
                "full scale at 3.3 V",
                f"{full_v:g} V",
                f"{ratio * VDDA_V:.1f} V",
                within(ratio * VDDA_V, full_v, 1e-6),
            ),
            Check(
                "room above the greatest open voltage",
                f"> {open_v:g} V",
                f"{ratio * VDDA_V * (1 - VDDA_SPREAD) / (1 + spread):.0f} V at the least 3.3 V",
                ratio * VDDA_V * (1 - VDDA_SPREAD) / (1 + spread) > open_v,
            ),
            Check("corner, below half of 1 MS/s", "< 500 kHz", f"{corner / 1e3:.0f} kHz", corner < 500e3),
            Check(
                f"rest of a step {n.settle_us:g} µs after the gate has opened",
                "< 0.1 %",
                f"{100 * settled:.2f} %",
                settled < 0.001,
            ),
            Check(
                "open voltage told against set: resistors, loading of the generator's resistor, supply",
                f"< {100 * n.measure['SAME_OPEN']:g} %",
                f"{100 * apart:.2f} %",
                apart < n.measure["SAME_OPEN"],
            ),
            Check(
                "reads nothing without a voltage: buffer of 1 mV, leakage of 5 nA",
                f"< {min(n.measure['LEAST_GAP_V'], test_v):g} V",
                f"{offset_v:.2f} V; a Schottky clamp that leaks 2 µA alone: {schottky_v:.1f} V",
                offset_v < min(n.measure["LEAST_GAP_V"], test_v),
            ),
            Check(
                f"voltage of each top resistor at {full_v:g} V",
                "< 200 V",
                f"{full_v / TOPS:.0f} V, and {full_v / (TOPS - 1):.0f} V where one of the others is shorted",
                full_v / (TOPS - 1) < 200.0,
            ),
            Check(
                f"current of the clamp in a spike of {PULSES_SPIKE_V:g} V",
                "< 5 mA",
                f"{clamp_ma:.1f} mA",
                clamp_ma < 5.0,
            ),
            Check(
                f"gap of {STRAY_F / PF:g} pF after the gate has closed",
                f"off-time current < {1e3 * n.measure['LEAST_A']:g} mA if it breaks down",
                f"falls in {1e6 * stray_s:.0f} µs; {1e6 * 0.5 * STRAY_F * open_v**2:.0f} µJ at {open_v:g} V, "
                f"{1e3 * stray_a:.1f} mA over {n.measure['SAMPLES_MOST']:g} samples",
                stray_a < n.measure["LEAST_A"],
            ),
            Check("one count", "–", f"{1e3 * full_v / n.top:.0f} mV", True),
        ),
    )
