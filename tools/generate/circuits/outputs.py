"""Resistors that hold the outputs of the chip while it does not drive them: in reset, flashed, unplugged."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tools.generate.board_source import pins
from tools.generate.circuits.common import KOHM, LEAKAGE_A, LOW_V, VDDA_V, Check, Circuit, Needs, parallel

if TYPE_CHECKING:
    from collections.abc import Iterable

    from tools.generate.board_source import Pin

PULL_OHM, PULL_SPREAD = 10 * KOHM, 0.01
INPUT_A = 1e-6
"""Of the input that an output goes to."""
NO_PULL = {
    "DISCHARGE_TIMER": "it ends pulses of GATE, which is held low",
    "DAC_CLOCK": "DAC_SELECT is high",
    "DAC_DATA": "DAC_SELECT is high",
    "LINE_OUT": "the host checks every frame",
}
"""Outputs that may float, and why."""
DAC_LOAD_OHM, AMPLIFIER_INPUT_OHM = 5 * KOHM, 1000 * KOHM
"""Least load of the DAC's buffer (data sheet of the STM32F427/429, DAC characteristics); input of what follows."""


def pulled(rows: Iterable[Pin], way: str) -> list[str]:
    """Return the nets that a resistor outside the chip pulls that way."""
    return [pin.net for pin in rows if pin.external == way]


def unnamed(rows: Iterable[Pin]) -> list[str]:
    """Return the outputs that float in a reset: neither an external pull nor a reason for none."""
    return [pin.net for pin in rows if pin.drives and not pin.external and pin.net not in NO_PULL]


def load_ohm() -> float:
    """Least load of a set point: its pull-down and the amplifier that follows."""
    return parallel(PULL_OHM * (1 - PULL_SPREAD), AMPLIFIER_INPUT_OHM)


def output_pulls(n: Needs) -> Circuit:
    """Pull resistors of what the chip drives."""
    rows = pins()
    down, up = pulled(rows, "down"), pulled(rows, "up")
    bare, driven = unnamed(rows), [pin for pin in rows if pin.drives]
    ohm = PULL_OHM * (1 + PULL_SPREAD)
    low_v = (LEAKAGE_A + INPUT_A) * ohm
    open_v = low_v / VDDA_V * n.scale["EDM_OPEN_FULL_V"]
    peak_a = low_v / VDDA_V * n.scale["EDM_PEAK_FULL_A"]
    free = ", ".join(f"{net} ({why})" for net, why in NO_PULL.items())
    value = f"{PULL_OHM / KOHM:g} kΩ, {100 * PULL_SPREAD:g} %,"
    return Circuit(
        "outputs",
        (
            (f"{value} to ground, {len(down)} of them", ", ".join(down)),
            (f"{value} to the supply of the isolator, on both sides of it", ", ".join(up)),
            ("none", free),
        ),
        (
            Check(
                "outputs of the chip that float in a reset, without a resistor and without a reason",
                "none",
                f"{len(bare)} of {len(driven)}" if bare else f"none of {len(driven)}",
                not bare,
            ),
            Check(
                "a logic input behind such a resistor: 1 µA of the pin and 1 µA of the input",
                f"< {LOW_V} V (74HCT)",
                f"{1e3 * low_v:.0f} mV",
                low_v < LOW_V,
            ),
            Check(
                "what the set points ask for then",
                "less than the DAC's own least, 0.2 V",
                f"{open_v:.0f} V, {1e3 * peak_a:.0f} mA",
                low_v < 0.2,
            ),
            Check(
                f"load of the DAC's buffer: the resistor beside {AMPLIFIER_INPUT_OHM / KOHM / 1e3:g} MΩ of the "
                "amplifier",
                f"> {DAC_LOAD_OHM / KOHM:g} kΩ",
                f"{load_ohm() / KOHM:.1f} kΩ",
                load_ohm() > DAC_LOAD_OHM,
            ),
        ),
    )
