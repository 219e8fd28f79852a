"""Units at the end of keys, and what a value in another unit is in the unit of its key.

The key of a value is the only declaration of its unit: `diameter_um`, `speed_um_s`, `removal_um3_per_uj`.
"""

from __future__ import annotations

import math
import re
from typing import NamedTuple


class Unit(NamedTuple):
    """A unit: how keys and people write it, its dimension, and its size in SI units."""

    ending: str
    symbol: str
    dimension: str
    scale: float


_PREFIXES = {"n": ("n", 1e-9), "u": ("µ", 1e-6), "m": ("m", 1e-3), "": ("", 1.0)}
_BASES = {"m": "m", "s": "s", "v": "V", "a": "A", "j": "J"}
_SIMPLE = {
    prefix + base: Unit(prefix + base, prefix_symbol + symbol, symbol, scale)
    for base, symbol in _BASES.items()
    for prefix, (prefix_symbol, scale) in _PREFIXES.items()
}
_SIMPLE |= {
    unit.ending: unit
    for unit in (
        Unit("cm", "cm", "m", 1e-2),
        Unit("kv", "kV", "V", 1e3),
        Unit("hz", "Hz", "Hz", 1.0),
        Unit("khz", "kHz", "Hz", 1e3),
        Unit("mhz", "MHz", "Hz", 1e6),
        Unit("h", "h", "s", 3600.0),
        Unit("days", "days", "s", 86_400.0),
        Unit("deg", "°", "angle", math.pi / 180.0),
        Unit("mrad", "mrad", "angle", 1e-3),
        Unit("rad", "rad", "angle", 1.0),
        Unit("lpm", "L/min", "flow", 1.0),
        Unit("c", "°C", "temperature", 1.0),
        Unit("pct", "%", "", 0.01),
    )
}
_DIVISORS = {**_SIMPLE, "min": Unit("min", "min", "s", 60.0)}
"""Minutes are no unit at the end of a key: `duty_min` is a least duty."""
NO_UNIT = Unit("", "", "", 1.0)
_USUAL = {_SIMPLE[ending].dimension: _SIMPLE[ending] for ending in ("um", "v", "a", "hz")}
_QUANTITY = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([A-Za-zµμ°%][\w/³²√]*)\s*")
_SPELLINGS = str.maketrans({"µ": "u", "μ": "u", "/": "_", "³": "3", "²": "2", "°": "deg", "√": "sqrt_"})


def unit_of(ending: str) -> Unit | None:
    """Return the unit that keys write as `um`, `um_s`, `um_per_v` or `um3_per_uj`; None if it is none."""
    if ending in _SIMPLE:
        return _SIMPLE[ending]
    for separator in ("_per_", "_"):
        top, found, bottom = ending.partition(separator)
        over, under = _power(top, _SIMPLE), _power(bottom, _DIVISORS)
        if found and over and under:
            dimension = f"{over.dimension}/{under.dimension}"
            return Unit(ending, f"{over.symbol}/{under.symbol}", dimension, over.scale / under.scale)
    return None


def _power(ending: str, known: dict[str, Unit]) -> Unit | None:
    if ending.startswith("sqrt_") and (root := known.get(ending.removeprefix("sqrt_"))):
        return Unit(ending, f"√{root.symbol}", f"√{root.dimension}", math.sqrt(root.scale))
    base = known.get(ending.rstrip("23"))
    power = ending[-1:] if ending[-1:] in ("2", "3") else ""
    if base is None or not power:
        return base
    symbol = f"{base.symbol}{'²' if power == '2' else '³'}"
    return Unit(ending, symbol, base.dimension + power, base.scale ** int(power))


def split(key: str) -> tuple[str, Unit]:
    """Return a key without its unit, and the unit: the last part of the key that is one, and the longest."""
    parts = key.split("_")
    for end in range(len(parts), 1, -1):
        for start in range(1, end):
            if unit := unit_of("_".join(parts[start:end])):
                return "_".join((*parts[:start], *parts[end:])), unit
    return key, NO_UNIT


def quantity(value: object) -> tuple[float, Unit | None] | None:
    """Return number and unit of a number, or of a text such as `20um`, `0.3 mm/min` or `55 %`; else None.

    The unit of a number is None.
    """
    if isinstance(value, int | float) and not isinstance(value, bool):
        return float(value), None
    match = _QUANTITY.fullmatch(value) if isinstance(value, str) else None
    if match is None:
        return None
    ending = "pct" if match[2] == "%" else match[2].lower().translate(_SPELLINGS)
    unit = unit_of(ending) or _DIVISORS.get(ending)
    return (float(match[1]), unit) if unit else None


def in_unit_of_key(key: str, number: float, unit: Unit) -> tuple[str, float] | None:
    """Return key and number of a quantity as a file writes them; None if the unit does not fit the key.

    A key without a unit gets the usual one of lengths, voltages, currents and frequencies.
    """
    own = split(key)[1]
    if own == NO_UNIT and (usual := _USUAL.get(unit.dimension)):
        own, key = usual, f"{key}_{usual.ending}"
    return (key, converted(number, unit, own)) if own.dimension == unit.dimension else None


def converted(number: float, unit: Unit, into: Unit) -> float:
    """Return a number in another unit, without the digits that the conversion adds; whole if it is whole."""
    rounded = float(f"{number * unit.scale / into.scale:.12g}")
    return int(rounded) if rounded.is_integer() else rounded
