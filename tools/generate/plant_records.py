"""firmware/plant/plant_records.h: the records of the plant as C lays them out, from their declarations in Python."""

from __future__ import annotations

import ctypes
from typing import TYPE_CHECKING

from edmctl.simulator import discharge, plant_interface, plant_state

if TYPE_CHECKING:
    from collections.abc import Iterator

    from edmctl.simulator.records import Record

_RECORDS: dict[str, type[Record]] = {
    "unit": plant_state.Unit,
    "plant": plant_state.PlantState,
    "scope": plant_state.Scope,
    "drive": plant_interface.Drive,
    "readings": plant_interface.Readings,
    "machine": plant_state.Machine,
    "cells": plant_state.Cells,
}
_CONSTANTS = {
    "TABLE": discharge.TABLE,
    "MOST_PULSES": plant_interface.MOST_PULSES,
    "PATH_LINES": plant_interface.PATH_LINES,
    **{
        name: getattr(plant_state, name)
        for name in (
            "PLAYS",
            "CREEP_TERMS",
            "BURNING",
            "SCOPE_PULSES",
            "STUCK_AT_GENERATOR",
            "STUCK_AT_CONTACT",
        )
    },
}
_HEAD = """\
/* Made from plant_state.py and plant_interface.py in edmctl/simulator by `python -m tools.generate`; edit those. */
#ifndef EDM_PLANT_RECORDS_H
#define EDM_PLANT_RECORDS_H

#include <stdint.h>

"""


def header() -> str:
    """Return the source."""
    constants = "".join(f"#define {name} {value}\n" for name, value in _CONSTANTS.items())
    records = "".join(_record(name, kind) for name, kind in _RECORDS.items())
    return f"{_HEAD}{constants}{records}\n#endif\n"


def _record(name: str, kind: type[Record]) -> str:
    lines = "".join(f"    {line};\n" for line in _fields(kind))
    size = f'_Static_assert(sizeof(struct {name}) == {ctypes.sizeof(kind)}, "{name}");\n'
    return f"\nstruct {name} {{\n{lines}}};\n{size}"


def _fields(kind: type[Record]) -> Iterator[str]:
    for name, ctype, *_ in kind._fields_:
        if name in kind.pointers:
            yield f"{kind.pointers[name]}{name}"
        elif issubclass(ctype, ctypes.Array):
            yield f"double {name}[{ctype._length_}]"
        else:
            yield f"{'double' if ctype is ctypes.c_double else 'int64_t'} {name}"
