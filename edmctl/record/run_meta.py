"""What is known of a run before it starts, the values of its profile among them, each with its unit."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence

from edmctl.dataclasses import dataclass
from edmctl.results.declared import PURE, TEXT

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


@dataclass(frozen=True, slots=True)
class Leaf:
    """One value of a profile by its dotted key, with the unit that its key names."""

    key: str
    value: float | int | str | bool
    units: str


@dataclass(frozen=True, slots=True)
class SourceText:
    """A file that went into a run: where it was found, and its text."""

    path: str
    text: str


@dataclass(frozen=True, slots=True)
class RunMeta:
    """Everything about a run that is known before it starts."""

    run_id: str
    title: str
    start_time: str
    """ISO 8601 with offset."""
    command: Sequence[str]
    host: str
    simulated: bool
    seed: int | None
    profile_text: str
    profile_sha256: str
    """Of the recipe in effect, after `extends`, overrides and defaults."""
    edmctl_version: str
    procedure: str = "machine"
    """What was done, by command or by program."""
    sim_sha256: str = ""
    """Of the `[sim]` table in effect."""
    parent_run: str = ""
    """The run that this one goes on with; empty without."""
    parent_time_s: float = 0.0
    """Time of the job in the runs before, pauses left out."""
    profile_path: str = ""
    profile_parents: Sequence[SourceText] = ()
    """The files that the profile extends, nearest first."""
    profile_leaves: Sequence[Leaf] = ()
    profile_overrides: Sequence[str] = ()
    setup_text: str = ""
    """The setup file verbatim; empty for the stock machine."""
    setup_toml: str = ""
    """Every value of the setup in effect."""
    setup_path: str = ""
    setup_sha256: str = ""
    protocol_version: str = ""
    firmware_version: str = ""
    controller_serial: str = ""
    calibration: str = ""
    """The actuator model of the run, in words."""
    calibration_text: str = ""
    """The calibration file verbatim; empty without."""
    drift_text: str = ""
    """The drift file verbatim; empty without."""
    user: str = ""
    work_material: str = ""
    work_thickness_um: float = math.nan
    tool_material: str = ""
    tool_diameter_um: float = math.nan


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
