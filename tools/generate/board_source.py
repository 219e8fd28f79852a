"""What the guide to build a machine takes from the sources of the board: pins, ends of ranges, limits."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

FIRMWARE = Path(__file__).parents[2] / "firmware"

_PIN = re.compile(r'PIN\((\w+), *(\w), *(\d+), (\w+), *(\d+), (\w+), *(\d), "([^"]*)"\)')
_EXTERNAL = re.compile(r"(?:; )?external pull-(up|down)")
_NUMBER = re.compile(r"^#define (\w+) +\(?(?:R\()?(-?\d+(?:\.\d+)?)u?\b", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class Pin:
    """A row of `pins.h`."""

    net: str
    port: str
    number: int
    mode: str
    pull: str
    level: int
    note: str

    @property
    def name(self) -> str:
        """The pin as the data sheet calls it."""
        return f"P{self.port}{self.number}"

    @property
    def function(self) -> str:
        """The peripheral, else the direction."""
        if self.mode in ("ALTERNATE", "ANALOG"):
            return self.note.partition("; ")[0]
        return self.mode.lower()

    @property
    def meaning(self) -> str:
        """What the note says besides the peripheral and the external pull."""
        note = _EXTERNAL.sub("", self.note)
        return note.partition("; ")[2] if self.function in note else note

    @property
    def external(self) -> str:
        """Where a resistor outside the chip pulls the net: `up`, `down`, or nowhere."""
        found = _EXTERNAL.search(self.note)
        return found[1] if found else ""

    @property
    def drives(self) -> bool:
        """Whether the chip drives the pin: inputs of peripherals have a pull of the chip's own."""
        if self.mode == "ANALOG":
            return self.function.startswith("DAC_OUT")
        return self.mode == "OUTPUT" or (self.mode == "ALTERNATE" and self.pull == "NONE")


def pins() -> list[Pin]:
    """Return every pin of the board in the order of `pins.h`."""
    text = (FIRMWARE / "board" / "stm32f4" / "pins.h").read_text(encoding="utf-8")
    return [
        Pin(net, port, int(number), mode, pull, int(level), note)
        for net, port, number, mode, _, pull, level, note in _PIN.findall(text)
    ]


def numbers(*path: str) -> dict[str, float]:
    """Return the plain numbers that a source defines, by their names; the first definition counts."""
    text = FIRMWARE.joinpath(*path).read_text(encoding="utf-8")
    return {name: float(value) for name, value in reversed(_NUMBER.findall(text))}


def wired_together(rows: list[Pin]) -> dict[str, list[str]]:
    """Return, for each net that shares its wire with other pins, those pins."""
    by_net = {pin.net: pin for pin in rows}
    pairs = set()
    for pin in rows:
        for other in re.findall(r"(?:wired to|the same net as) (\w+)", pin.note):
            pairs |= {(pin.net, other), (other, pin.net)}
    return {net: sorted(by_net[b].name for a, b in pairs if a == net) for net, _ in pairs}
