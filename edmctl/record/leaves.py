"""Flattens a profile into single values with the unit that each key names."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING

from edmctl.record.layout import PURE, TEXT
from edmctl.record.rows import Leaf

if TYPE_CHECKING:
    from collections.abc import Iterator

UNIT_SUFFIXES = {
    "um3_per_uj": "um3/uJ",
    "um_per_v": "um/V",
    "um_s2": "um/s2",
    "um_s": "um/s",
    "v_s": "V/s",
    "v_max": "V",
    "um": "um",
    "mm": "mm",
    "us": "us",
    "ns": "ns",
    "ms": "ms",
    "s": "s",
    "v": "V",
    "a": "A",
    "w": "W",
    "uj": "uJ",
    "hz": "Hz",
    "khz": "kHz",
    "deg": "deg",
    "mrad": "mrad",
    "lpm": "L/min",
    "c": "degC",
    "degc": "degC",
    "ohm": "ohm",
    "pf": "pF",
}
"""Endings of a key, longest first, and the unit they stand for."""


def profile_leaves(profile: Mapping[str, object]) -> tuple[Leaf, ...]:
    """Return every value of the nested `profile` by dotted key; lists become JSON, None is left out."""
    return tuple(_leaves(profile, ""))


def _leaves(table: Mapping[str, object], prefix: str) -> Iterator[Leaf]:
    for name, value in table.items():
        key = f"{prefix}{name}"
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{key}.")
        elif isinstance(value, str):
            yield Leaf(key, value, TEXT)
        elif isinstance(value, bool):
            yield Leaf(key, value, PURE)
        elif isinstance(value, int | float):
            yield Leaf(key, value, unit_of(name))
        elif value is not None:
            yield Leaf(key, json.dumps(value, default=str), TEXT)


def unit_of(name: str) -> str:
    """Return the unit that the ending of `name` stands for; `1` when it names none."""
    return next((unit for suffix, unit in UNIT_SUFFIXES.items() if name.endswith(f"_{suffix}")), PURE)
