"""Records that Python and C share, as C lays them out: plant_records.h and host_records.h in firmware/."""

from __future__ import annotations

import ctypes
from typing import TYPE_CHECKING

from edmctl.core import library
from edmctl.simulator import plant_records

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from edmctl.core.library import Record

_RECORDS: dict[str, type[Record]] = {
    "unit": plant_records.Unit,
    "plant": plant_records.PlantState,
    "scope": plant_records.Scope,
    "drive": plant_records.Drive,
    "readings": plant_records.Readings,
    "machine": plant_records.Machine,
    "cells": plant_records.Cells,
}
_CONSTANTS = {
    "MOST_PULSES": plant_records.MOST_PULSES,
    "PATH_LINES": plant_records.PATH_LINES,
    **{
        name: getattr(plant_records, name)
        for name in (
            "TABLE",
            "PLAYS",
            "CREEP_TERMS",
            "BURNING",
            "SCOPE_PULSES",
            "STUCK_AT_GENERATOR",
            "STUCK_AT_CONTACT",
        )
    },
}
_HOST_RECORDS: dict[str, type[Record]] = {
    "inputs": library.Inputs,
    "seen": library.Seen,
    "merged": library.Merged,
    "kept": library.Kept,
}
_HEAD = """\
/* Made from {sources} by `python -m tools.generate`; edit those. */
#ifndef EDM_{name}_RECORDS_H
#define EDM_{name}_RECORDS_H

#include <stdint.h>

"""


def plant_header() -> str:
    """Return the records of the plant."""
    return _header("PLANT", "plant_records.py in edmctl/simulator", _CONSTANTS, _RECORDS)


def host_header() -> str:
    """Return the records of the controller in a process."""
    constants = {name: getattr(library, name) for name in ("BOX_TICKS", "PACK", "SAMPLES_BYTES")}
    return _header("HOST", "edmctl/core/library.py", constants, _HOST_RECORDS)


def _header(
    name: str, sources: str, constants: Mapping[str, int], records: Mapping[str, type[Record]]
) -> str:
    defines = "".join(f"#define {one} {value}\n" for one, value in constants.items())
    structs = "".join(_record(one, kind) for one, kind in records.items())
    sizes = " ".join(f"{kind.__name__} {ctypes.sizeof(kind)}" for kind in records.values())
    sizes = f'\n/* Of each class in Python the size. */\n#define {name}_RECORDS "{sizes}"\n'
    return f"{_HEAD.format(sources=sources, name=name)}{defines}{structs}{sizes}\n#endif\n"


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
