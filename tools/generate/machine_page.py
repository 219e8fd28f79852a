"""The tables of docs/build-the-machine.md: pins of the board, parts and checks of the reference circuits."""

from __future__ import annotations

import re
from pathlib import Path

from edmctl.board.settings import settings_of
from tools.generate.board_source import FIRMWARE, Pin, numbers, pins, wired_together
from tools.generate.circuits import circuits
from tools.generate.circuits.break_chain import contact_rows
from tools.generate.circuits.common import Circuit, Needs
from tools.generate.circuits.generator import settings
from tools.generate.circuits.materials import materials, rows_of
from tools.generate.circuits.wiring import wirings
from tools.generate.nucleo import MORPHO, ON_THE_BOARD, ZIO
from tools.generate.text import table

_NEGATIVE = re.compile(r"(?<= )-(?=\d)")

RANGES = {
    "GAP_VOLTAGE": (None, "EDM_GAP_FULL_V", "V"),
    "GAP_CURRENT": (None, "EDM_GAP_FULL_A", "A"),
    "MONITOR": ("EDM_MONITOR_LEAST_V", "EDM_MONITOR_MOST_V", "V"),
    "DISPLACEMENT": ("EDM_SENSOR_LEAST_UM", "EDM_SENSOR_MOST_UM", "µm"),
    "FLOW": (None, "EDM_FLOW_FULL_LPM", "l/min"),
    "TEMPERATURE": (None, "EDM_TEMPERATURE_FULL_C", "°C"),
    "OPEN_VOLTAGE": (None, "EDM_OPEN_FULL_V", "V"),
    "PEAK_CURRENT": (None, "EDM_PEAK_FULL_A", "A"),
}
"""Names in `scale.h` of the ends of each analogue range, and its unit."""


def tables() -> dict[str, str]:
    """Return the marked parts of the page."""
    parts = {circuit.name: _circuit(circuit) for circuit in circuits()}
    head = (
        "open voltage, V",
        "peak current, A",
        "all in a row, Ω",
        "lasting short, A",
        "and at a duty of 0.5, W",
        "load of step 12, Ω",
        "and at that duty, W",
    )
    made = {
        "pins": _pins(),
        "ranges": _ranges(),
        "resistors": table(head, settings(Needs())),
        "contacts": table(("contact in", "what it does", "e-stop", "door"), contact_rows()),
        "materials": table(("part", "requirement", "for"), rows_of(materials(Needs()))),
        **{
            f"wiring_{name}": table(("part", "from – to"), [(wired.part, wired.nodes) for wired in wiring])
            for name, wiring in wirings().items()
        },
        **parts,
    }
    return {name: _NEGATIVE.sub("−", text) for name, text in made.items()}


def ends(net: str, scale: dict[str, float]) -> tuple[float, float, str]:
    """Return both ends of an analogue range, and its unit."""
    low, high, unit = RANGES[net]
    return scale[low] if low else 0.0, scale[high], unit


def _pins() -> str:
    rows = pins()
    together = wired_together(rows)
    head = ("net", "pin", "Zio", "morpho", "function", "pull", "what it is, and its sense", "wired to")
    return table(head, [_pin(pin, together) for pin in rows])


def _pin(pin: Pin, together: dict[str, list[str]]) -> tuple[str, ...]:
    scale = numbers("board", "scale.h")
    meaning = pin.meaning
    if pin.net in RANGES:
        low, high, unit = ends(pin.net, scale)
        what = meaning.partition(": ")[0] if ": " in meaning else pin.net.replace("_", " ").lower()
        meaning = f"{what}: 0 to 3.3 V = {low:g} to {high:g} {unit}"
    joined = "the ST-LINK, on the board" if pin.name in ON_THE_BOARD else ", ".join(together.get(pin.net, ()))
    pull = {"NONE": "", "UP": "up", "DOWN": "down"}[pin.pull]
    pull = f"{pin.external}, external" if pin.external else pull
    return pin.net, pin.name, ZIO.get(pin.name, "–"), MORPHO[pin.name], pin.function, pull, meaning, joined


def _ranges() -> str:
    rows = [
        (f"`{setting.name}`", f"{setting.value:g}", f"`{Path(setting.source).name}`")
        for setting in settings_of(FIRMWARE).values()
    ]
    return table(("name", "as it is", "in"), rows)


def _circuit(circuit: Circuit) -> str:
    wrong = [check.what for check in circuit.checks if not check.ok]
    if wrong:
        raise ValueError(
            f"the circuit {circuit.name} does not do what the firmware needs: {', '.join(wrong)}"
        )
    checks = [(check.what, check.need, check.reached) for check in circuit.checks]
    return table(("part", "value"), circuit.parts) + "\n" + table(("what", "needed", "reached"), checks)
