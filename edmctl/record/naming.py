"""Names of the columns of a measured record, and what a column of another name most likely holds.

A column is called by its quantity and unit: t_s, u_V, y_um. Upper and lower case and the two Unicode letters µ
make no difference; everything else does, because a wrong unit would be fitted without complaint.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

TIME, VOLTAGE, DISPLACEMENT = "t_s", "u_V", "y_um"
STACK, TOOL = "x_um", "z_um"


@dataclass(frozen=True, slots=True)
class _Quantity:
    """A column that is needed, what others call it, and the factor from other units."""

    meaning: str
    also_called: frozenset[str]
    factors: Mapping[str, float]


WANTED: Mapping[str, _Quantity] = {
    TIME: _Quantity(
        "time in s",
        frozenset({"t", "time", "times", "timestamp", "seconds", "elapsed"}),
        {"s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0, "h": 3600.0},
    ),
    VOLTAGE: _Quantity(
        "actuator voltage in V",
        frozenset({"u", "v", "voltage", "volt", "volts", "vin", "input", "drive"}),
        {"v": 1.0, "volt": 1.0, "volts": 1.0, "mv": 1e-3, "kv": 1e3},
    ),
    DISPLACEMENT: _Quantity(
        "tool displacement in µm",
        frozenset({"y", "z", "x", "displacement", "disp", "position", "pos", "stroke", "output", "sensor"}),
        {"um": 1.0, "micron": 1.0, "microns": 1.0, "mm": 1e3, "nm": 1e-3, "m": 1e6, "cm": 1e4},
    ),
}

LEVER: Mapping[str, _Quantity] = {
    STACK: _Quantity(
        "stack displacement in µm", frozenset({"x", "stack", "stacks"}), WANTED[DISPLACEMENT].factors
    ),
    TOOL: _Quantity(
        "tool displacement in µm", frozenset({"z", "y", "tool", "tip"}), WANTED[DISPLACEMENT].factors
    ),
}
_QUANTITIES: Mapping[str, _Quantity] = {**WANTED, **LEVER}


def find_columns(names: Sequence[str], needed: Sequence[str] = tuple(WANTED)) -> dict[str, int]:
    """Where each needed column stands among `names`; those that are not there are left out."""
    plain = [_plain(name) for name in names]
    return {wanted: plain.index(_plain(wanted)) for wanted in needed if _plain(wanted) in plain}


def repeated(names: Sequence[str]) -> str | None:
    """Return a wanted column that stands there twice, if there is one."""
    plain = [_plain(name) for name in names]
    return next((wanted for wanted in _QUANTITIES if plain.count(_plain(wanted)) > 1), None)


def advice(names: Sequence[str], needed: Sequence[str] = tuple(WANTED)) -> str:
    """Say for every needed column that is missing which of `names` it may be, and how to convert it."""
    found = find_columns(names, needed)
    missing = [wanted for wanted in needed if wanted not in found]
    free = [name for k, name in enumerate(names) if k not in found.values() and name.strip()]
    said = []
    for wanted in missing:
        near = _nearest(wanted, free)
        if near is None:
            said.append(f"Name the column of the {_QUANTITIES[wanted].meaning} {wanted}.")
        else:
            free.remove(near)
            said.append(_conversion(near, wanted))
    return " ".join(said)


def _plain(name: str) -> str:
    return name.strip().strip("\"'").replace("µ", "u").replace("μ", "u").lower()


def _parts(name: str) -> tuple[str, str]:
    """Quantity and unit of a name: `Displacement (mm)`, `u_mV`, `time[ms]`; the unit may be missing."""
    words = [word for word in re.split(r"[\s_()\[\]/,.-]+", _plain(name)) if word]
    if not words:
        return "", ""
    return words[0], words[-1] if len(words) > 1 else ""


def _nearest(wanted: str, names: Sequence[str]) -> str | None:
    quantity = _QUANTITIES[wanted]
    same = [name for name in names if _parts(name)[0] in quantity.also_called]
    if not same:
        same = [name for name in names if _parts(name)[1] in quantity.factors]
    return same[0] if same else None


def _conversion(name: str, wanted: str) -> str:
    factor = _QUANTITIES[wanted].factors.get(_parts(name)[1])
    if factor is None:
        return f"If {name} is the {_QUANTITIES[wanted].meaning}, rename it to {wanted}."
    if factor == 1.0:
        return f"Rename {name} to {wanted}."
    return f"Multiply {name} by {factor:.10g} and rename it to {wanted}."
