"""Declarations of result fields: unit, title, type and column are written once, where the field is defined.

The results table of run files, its page in the documentation, exported columns and JSON follow from them.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping
from enum import Enum
from functools import cache
from types import NoneType, UnionType
from typing import Any, Generic, TypeVar, get_args, get_origin, get_type_hints

from edmctl.dataclasses import dataclass, field, fields

PURE = "1"
"""Unit of a pure number."""
TEXT = ""
"""Unit of a text."""
_ENDINGS = {"%": "pct", "L/min": "lpm", "degC": "c", "mm3/min": "mm3_min", "um/s": "um_s"}
GROUPS = (
    "place",
    "readings",
    "lengths",
    "lengths by voltage",
    "machining",
    "error of the model",
    "measurement",
    "uncertainty",
    "further",
)
"""Columns of the results table are in this order, and within a group in that of their declaration."""
ONLY_JSON = ""
"""Group of fields that the results table does not have."""

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Quantity:
    """Unit, title, type and group of a field; `column` if the column's name does not follow from the field's."""

    units: str
    title: str
    group: str
    dtype: str
    column: str


@dataclass(frozen=True, slots=True)
class StoredColumn:
    """A column of the results table; `source` is the name of its value, with a dot where that is nested."""

    name: str
    source: str
    quantity: Quantity


def quantity(
    units: str, title: str, group: str = "further", *, dtype: str = "f8", column: str = "", **options: Any
) -> Any:
    """Declare a field; `options` are those of `dataclasses.field`."""
    return field(metadata={"quantity": Quantity(units, title, group, dtype, column)}, **options)


def um(title: str, group: str = "further", **options: Any) -> Any:
    """Declare a length in µm."""
    return quantity("um", title, group, **options)


class Derived(Generic[T]):
    """A property of a result that has a column of its own."""

    def __init__(self, compute: Callable[[Any], T], declared: Quantity) -> None:
        self._compute, self.quantity = compute, declared

    def __get__(self, instance: object, owner: type | None = None) -> T:
        return self if instance is None else self._compute(instance)  # type: ignore[return-value]


def derived(
    units: str, title: str, group: str, *, dtype: str = "f8"
) -> Callable[[Callable[[Any], T]], Derived[T]]:
    """Declare a property; in its group it comes before the fields."""
    return lambda compute: Derived(compute, Quantity(units, title, group, dtype, ""))


def quantities(kind: type) -> dict[str, Quantity]:
    """Return the declaration of each field of a result, by its name."""
    return {one.name: one.metadata["quantity"] for one in fields(kind) if "quantity" in one.metadata}


def stored_columns(kind: type) -> list[StoredColumn]:
    """Return the columns of the results table for a kind of result."""
    return sorted(_columns(kind), key=lambda one: GROUPS.index(one.quantity.group))


def _columns(kind: type) -> Iterator[StoredColumn]:
    declared = {name: one.quantity for name, one in vars(kind).items() if isinstance(one, Derived)}
    hints = _hints(kind)
    for name, one in (declared | quantities(kind)).items():
        if one.group == ONLY_JSON:
            continue
        if not dataclasses.is_dataclass(hints.get(name)):
            yield StoredColumn(one.column or _without_unit(name, one.units), name, one)
            continue
        for inner, part in quantities(hints[name]).items():
            nested = Quantity(part.units, part.title, one.group, part.dtype, "")
            yield StoredColumn(f"{one.column}{inner}", f"{name}.{inner}", nested)


def ending_of(units: str) -> str:
    """Return the end of a name that stands for a unit; empty for pure numbers and texts."""
    return "" if units in (PURE, TEXT) else f"_{_ENDINGS.get(units, units.lower())}"


def _without_unit(name: str, units: str) -> str:
    return name.removesuffix(ending_of(units))


@cache
def _hints(kind: Any) -> dict[str, Any]:
    return get_type_hints(kind)


def shared(kind: type, source: object) -> dict[str, Any]:
    """Return the values of `source` that have the names of fields of `kind`."""
    return {one.name: getattr(source, one.name) for one in fields(kind) if hasattr(source, one.name)}


def result_of(kind: type[T], values: Mapping[str, Any]) -> T:
    """Return the result whose fields are kept as plain values, as JSON has them: None for a float is NaN.

    Raises TypeError or ValueError if the values are not those of such a result.
    """
    hints = _hints(kind)  # type: ignore[arg-type]
    if unknown := values.keys() - hints.keys():
        raise TypeError(f"{kind.__name__} has no {', '.join(map(str, unknown))}")
    return kind(**{name: _typed(hints[name], value) for name, value in values.items()})


def _typed(kind: Any, value: Any) -> Any:
    if isinstance(kind, UnionType):
        one = next(one for one in get_args(kind) if one is not NoneType)
        return None if value is None else _typed(one, value)
    if get_origin(kind) is tuple:
        return tuple(_typed(get_args(kind)[0], one) for one in value)
    if kind is float and value is None:
        return math.nan
    if not isinstance(kind, type):
        return value
    if dataclasses.is_dataclass(kind):
        if not isinstance(value, Mapping):
            raise TypeError(f"{kind.__name__} has to be a mapping")
        return result_of(kind, value)
    return kind(value) if issubclass(kind, Enum) else value
