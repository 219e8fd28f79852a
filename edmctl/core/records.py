"""Records that Python and C share: each name and type is declared once, the memory is laid out as in C.

A record is a class with annotations:

    @record
    class Tool(Record):
        length_um: float
        sites: int
        wear_um: Array = series(16)

Python reads and writes plain attributes. The headers in firmware/ are made from the declarations (tools/generate).
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from typing import Any, ClassVar, Self, TypeVar

import numpy as np

from edmctl.array_types import Array

_KINDS: dict[str, Any] = {"float": ctypes.c_double, "int": ctypes.c_int64}


def series(length: int) -> Any:
    """Declare a field of so many floats."""
    return ctypes.c_double * length


class _Address:
    def __init__(self, declared: str) -> None:
        self.declared = declared


address: Any = _Address
"""Declare a field that is an address: the pointer's type in C, such as `double *`."""


class Record(ctypes.Structure):
    """Named numbers; all are zero at first."""

    pointers: ClassVar[Mapping[str, str]] = {}
    """Types in C of the fields that are addresses."""

    @property
    def place(self) -> int:
        """The address of the record."""
        return ctypes.addressof(self)

    def array(self, name: str) -> Array:
        """A series as an array that shares its memory."""
        return np.ctypeslib.as_array(getattr(self, name))

    def numbers(self) -> dict[str, float]:
        """Every single number by its name, in order."""
        return {name: getattr(self, name) for name, kind, *_ in self._fields_ if kind in _KINDS.values()}

    def arrays(self) -> dict[str, Array]:
        """A copy of every series by its name."""
        return {
            name: self.array(name).copy() for name, kind, *_ in self._fields_ if kind not in _KINDS.values()
        }

    def __deepcopy__(self, _: object) -> Self:
        return type(self).from_buffer_copy(self)


RECORD_BYTES: dict[str, int] = {}
"""Sizes of the records that were declared, by the name of the class."""

_R = TypeVar("_R", bound=Record)


def record(cls: type[_R]) -> type[_R]:
    """Make the fields of a record of its annotations."""
    declared = vars(cls)
    cls.pointers = {name: one.declared for name, one in declared.items() if isinstance(one, _Address)}
    kinds = {name: None if name in cls.pointers else declared.get(name) for name in cls.__annotations__}
    cls._fields_ = [(name, kinds[name] or _KINDS[kind]) for name, kind in cls.__annotations__.items()]
    RECORD_BYTES[cls.__name__] = ctypes.sizeof(cls)
    return cls
