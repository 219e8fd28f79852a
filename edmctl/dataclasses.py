"""Dataclasses that are quick to make: only their constructor is compiled, their other methods are shared.

The standard library compiles up to six methods of each class: a quarter of a second for the 300 classes of a job.
Here `__eq__`, `__hash__` and `__repr__` are functions that all classes share; they return what those of the standard
library return. `frozen` is checked by mypy alone, so that instances are made three times as fast.
"""

from __future__ import annotations

import dataclasses
from dataclasses import asdict, astuple, field, fields, replace
from reprlib import recursive_repr
from typing import TYPE_CHECKING, Any

__all__ = ["asdict", "astuple", "dataclass", "field", "fields", "replace"]

if TYPE_CHECKING:
    from dataclasses import dataclass
else:

    def dataclass(cls=None, /, *, eq=True, frozen=False, repr=True, **options):
        """Return a class, or a decorator of one, as `dataclasses.dataclass` does."""

        def made(cls):
            cls.__doc__ = cls.__doc__ or cls.__name__  # spares a signature
            own = vars(cls)
            if eq and "__eq__" not in own:
                cls.__hash__ = own.get("__hash__") or (_hash if frozen else None)
                cls.__eq__ = _equals
            if repr and "__repr__" not in own:
                cls.__repr__ = _repr
            return dataclasses.dataclass(cls, eq=False, repr=False, **options)

        return made if cls is None else made(cls)


def _compared(instance: Any) -> tuple[Any, ...]:
    return tuple([getattr(instance, one.name) for one in fields(instance) if one.compare])


def _equals(self: Any, other: object) -> bool:
    if self.__class__ is not other.__class__:
        return NotImplemented  # type: ignore[no-any-return]
    return bool(_compared(self) == _compared(other))


def _hash(self: Any) -> int:
    return hash(_compared(self))


@recursive_repr()
def _repr(self: Any) -> str:
    shown = [f"{one.name}={getattr(self, one.name)!r}" for one in fields(self) if one.repr]
    return f"{self.__class__.__qualname__}({', '.join(shown)})"
